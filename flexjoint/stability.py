"""Can a scheme hold the springs of a robot at a step? Estimated before a simulation starts.

The model is linearised about a state without gravity, velocity terms, effects and kinks: masses, springs
and dampers. Its eigenvalues lambda give max |lambda| h; the eigenvalues of the scheme's step on it tell
whether a mode grows.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from flexjoint.errors import StabilityWarning, unknown
from flexjoint.model import FlexibleJointModel, State

# Implicit, or with a step of its own: no spring is too stiff for them.
A_STABLE = frozenset({"linearly_implicit_midpoint", "implicit_midpoint", "reference"})
# c h/m that a scheme bears of a contact's damper; others are implicit or have limits of their own
CONTACT_DAMPING = {
    "linearly_implicit_midpoint": 1.0,
    "semi_implicit_euler": 2.0,
    "kashiri2017": 2.0,
    "kashiri2017_new": 2.0,
}
ROUNDING = 1e-6  # a free drift is a double eigenvalue of 1: rounding moves it by about the root of 1e-16
SHORTEST = 1e-7  # [s] of the steps that are tried
DEFAULT_ADVICE = "linearly_implicit_midpoint, which is stable for any stiffness"


@dataclass(frozen=True)
class Stability:
    """How a scheme's step h meets the fastest mode of a robot.

    lambda_h: max |lambda| h. growth: largest factor by which a step lets a mode grow (above 1: it diverges).
    joint: whose spring takes most of the energy of the mode that grows most. rate: physics rate from which
    on the scheme holds [Hz], None where no step does.
    """

    lambda_h: float
    growth: float
    joint: str
    rate: float | None

    @property
    def holds(self) -> bool:
        return self.growth <= 1.0 + ROUNDING


def stability(model: FlexibleJointModel, x: State, h: float, scheme: str) -> Stability:
    """The estimate at a state for a step h [s]; the scheme by its name in `flexjoint.integrate`.

    Raises UnknownNameError.
    """
    from flexjoint.integrate import SCHEMES  # which imports this module

    if scheme not in SCHEMES:
        raise unknown("scheme", scheme, SCHEMES)
    A = linearised(model, x)
    lambda_h = h * float(np.max(np.abs(np.linalg.eigvals(A))))
    if scheme in A_STABLE:
        values, vectors = np.linalg.eig(A)
        return Stability(lambda_h, 1.0, _joint(model, x, vectors[:, np.argmax(np.abs(values))]), 1.0 / h)
    values, vectors = np.linalg.eig(_step(model, A, h, scheme))
    worst = int(np.argmax(np.abs(values)))
    shorter = h
    while _growth(model, A, shorter, scheme) > 1.0 + ROUNDING and shorter > SHORTEST:
        shorter *= 0.8
    rate = 1.0 / shorter if shorter > SHORTEST else None
    return Stability(lambda_h, float(np.abs(values[worst])), _joint(model, x, vectors[:, worst]), rate)


def check_stability(model: FlexibleJointModel, x: State, h: float, scheme: str) -> None:
    """Warn (StabilityWarning) when the scheme's step is too long for a spring of the model at a state.

    The simulation runs all the same, for a mode that grows slowly may not matter to a short run; once the
    numbers cease to be finite it ends with a SimulationError.
    """
    _check_contacts(model, x, h, scheme)
    if scheme in A_STABLE:
        return
    found = stability(model, x, h, scheme)
    if found.holds:
        return
    advice = f"a physics rate of {found.rate:.3g} Hz or more, or " if found.rate is not None else ""
    warnings.warn(
        f"{scheme} cannot hold the spring of joint {found.joint} at a physics rate of {1.0 / h:g} Hz"
        f" (max|lambda| h = {found.lambda_h:.3g}, it grows by {found.growth:.3g} a step); use {advice}"
        f"{DEFAULT_ADVICE}",
        StabilityWarning,
        stacklevel=2,
    )


def _check_contacts(model: FlexibleJointModel, x: State, h: float, scheme: str) -> None:
    """Warn (StabilityWarning) when a contact is too stiff or too damped for the mass that it moves: beyond
    k = 4 m/h^2, and c = 2 m/h, or m/h where the damper sees a predicted velocity, steps alternate and grow.
    """
    if not (model.ground is not None and model.ground.springy and scheme in CONTACT_DAMPING):
        return
    mass = model.body.mass_matrix(x.q)
    for i in model.rigid:
        mass[model.joints[i].idx_v, model.joints[i].idx_v] += model.flows[i].drive.B
    _, jacobians = model.ground.places(model, x.q)
    for item, jacobian in zip(model.ground.contacts, jacobians, strict=True):
        inverse = jacobian @ np.linalg.solve(mass, jacobian.T)
        along, normal = 1.0 / np.max(np.linalg.eigvalsh(inverse[:2, :2])), 1.0 / inverse[2, 2]
        for name, limit in (
            ("stiffness", 4.0 * normal / h**2),
            ("tangential_stiffness", 4.0 * along / h**2),
            ("tangential_damping", CONTACT_DAMPING[scheme] * along / h),
        ):
            if getattr(item, name) > limit:
                warnings.warn(
                    f"{scheme} cannot hold the contact of {item.frame} at a physics rate of {1.0 / h:g} Hz:"
                    f" {name} is {getattr(item, name):g}, and {limit:.3g} is the most for the mass that moves"
                    " there; lower it, or raise the rate",
                    StabilityWarning,
                    stacklevel=3,
                )
                return


def _growth(model: FlexibleJointModel, A: np.ndarray, h: float, scheme: str) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(_step(model, A, h, scheme)))))


def _step(model: FlexibleJointModel, A: np.ndarray, h: float, scheme: str) -> np.ndarray:
    """What one step of an explicit scheme does to (q, theta, v, dtheta)."""
    n = model.nv + model.nf
    eye = np.eye(n)
    position, velocity = A[n:, :n], A[n:, n:]
    if scheme == "rk4":
        hA, one = h * A, np.eye(2 * n)
        return one + hA @ (one + hA / 2 @ (one + hA / 3 @ (one + hA / 4)))
    lower = np.hstack([h * position, eye + h * velocity])
    new = np.zeros(n) if scheme == "explicit_euler" else np.ones(n)
    if scheme == "kashiri2017":
        new[model.nv :] = 0.0
    old = np.hstack([eye, h * np.diag(1.0 - new)])
    return np.vstack([old + h * np.diag(new) @ lower, lower])


def _joint(model: FlexibleJointModel, x: State, mode: np.ndarray) -> str:
    """The joint whose spring holds most of a mode's energy; of rigid ones, which has none, the fastest."""
    n = model.nv + model.nf
    energy = np.zeros(len(model.joints))
    for i, flow in enumerate(model.flows):
        place = flow.joint.idx_v
        if flow.joint.rigid:
            energy[i] = 1e-9 * abs(mode[n + place]) ** 2
            continue
        k = model.nv + model.flexible.index(i)
        energy[i] = flow.spring_at(x.t)[0] * abs(mode[k] - mode[place]) ** 2
    return model.joints[int(np.argmax(energy))].name


def linearised(model: FlexibleJointModel, x: State) -> np.ndarray:
    """d(v, dtheta, acc, ddtheta)/d(q, theta, v, dtheta) of masses, springs and dampers at a state."""
    nv, nf = model.nv, model.nf
    mass, stiffness, damping = (np.zeros((nv + nf, nv + nf)) for _ in range(3))
    mass[:nv, :nv] = model.body.mass_matrix(x.q)
    for i, flow in enumerate(model.flows):
        place, drive = flow.joint.idx_v, flow.drive
        if flow.joint.rigid:
            mass[place, place] += drive.B
            damping[place, place] += drive.D_m
            continue
        k = nv + model.flexible.index(i)
        mass[k, k] = drive.B
        damping[k, k] += drive.D_m
        for matrix, number in zip((stiffness, damping), flow.spring_at(x.t), strict=True):
            matrix[np.ix_([place, k], [place, k])] += number * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.block(
        [
            [np.zeros((nv + nf, nv + nf)), np.eye(nv + nf)],
            [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
        ]
    )
