"""Is a scheme stable on the springs of a robot at a step? Estimated before a simulation starts.

The model is linearised about a state without gravity, velocity terms, effects and kinks: masses, springs
and dampers. Its eigenvalues lambda give max |lambda| h; the eigenvalues of the scheme's step on it show
whether a mode grows.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import StabilityWarning
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.simulation.schemes.base import DEFAULT, Scheme
from flexjoint.simulation.schemes.catalogue import find
from flexjoint.simulation.schemes.conservation import Conservation
from flexjoint.simulation.schemes.modes import linearised

UNDAMPED = 1e-3  # share of critical damping below which a mode rings on
STILL = 1e-6  # of the fastest mode: a slower one is a free drift and rounding
ROUNDING = 1e-6  # a free drift is a double eigenvalue of 1: rounding moves it by about the root of 1e-16
SHORTEST = 1e-7  # [s] of the steps that are tried


@dataclass(frozen=True)
class Stability:
    """How a scheme's step h meets the fastest mode of a robot.

    lambda_h: max |lambda| h. growth: largest factor by which a step lets a mode grow (above 1: it diverges).
    joint: whose spring takes most of the energy of the mode that grows most. rate: physics rate from which
    on the scheme is stable [Hz], None where it is at no step.
    """

    lambda_h: float
    growth: float
    joint: str
    rate: float | None

    @property
    def stable(self) -> bool:
        return self.growth <= 1.0 + ROUNDING


def stability(model: FlexibleJointModel, x: State, h: float, scheme: str) -> Stability:
    """The estimate at a state for a step h [s]; the scheme by its name.

    Raises UnknownNameError.
    """
    return _stability(model, x, h, find(scheme))


def _stability(model: FlexibleJointModel, x: State, h: float, scheme: Scheme) -> Stability:
    A = linearised(model, x)
    lambda_h = h * float(np.max(np.abs(np.linalg.eigvals(A))))
    if scheme.any_stiffness:
        values, vectors = np.linalg.eig(A)
        return Stability(lambda_h, 1.0, _joint(model, x, vectors[:, np.argmax(np.abs(values))]), 1.0 / h)
    values, vectors = np.linalg.eig(scheme.step_matrix(A, h, model.nv))
    worst = int(np.argmax(np.abs(values)))
    shorter = h
    while _growth(scheme.step_matrix(A, shorter, model.nv)) > 1.0 + ROUNDING and shorter > SHORTEST:
        shorter *= 0.8
    rate = 1.0 / shorter if shorter > SHORTEST else None
    return Stability(lambda_h, float(np.abs(values[worst])), _joint(model, x, vectors[:, worst]), rate)


def check_stability(
    model: FlexibleJointModel, x: State, h: float, scheme: str, *, ringing: bool = True
) -> None:
    """Warn (StabilityWarning) when the scheme's step is too long for a spring of the model at a state; with
    `ringing`, also where it is stable and makes energy or momentum of a spring that next to nothing damps.

    The simulation runs all the same, for a mode that grows slowly may not matter to a short run; once the
    numbers cease to be finite it ends with a SimulationError.
    """
    used = find(scheme)
    _check_contacts(model, x, h, used)
    if used.any_stiffness:
        if ringing:
            _check_ringing(model, x, h, used)
        return
    found = _stability(model, x, h, used)
    if found.stable:
        if ringing:
            _check_ringing(model, x, h, used)
        return
    advice = f"a physics rate of {found.rate:.3g} Hz or more, or " if found.rate is not None else ""
    warnings.warn(
        f"{scheme} is unstable on the spring of joint {found.joint} at a physics rate of {1.0 / h:g} Hz"
        f" (max|lambda| h = {found.lambda_h:.3g}, it grows by {found.growth:.3g} a step); use {advice}"
        f"{DEFAULT}, which is stable for any stiffness",
        StabilityWarning,
        stacklevel=2,
    )


def _check_ringing(model: FlexibleJointModel, x: State, h: float, scheme: Scheme) -> None:
    """Warn (StabilityWarning) when a spring that next to nothing damps rings too fast for a stable scheme to
    keep the energy, or the momentum of what flies freely."""
    free = Conservation(model, h).free
    most = min(scheme.keeps_energy, scheme.keeps_momentum if free else math.inf)
    if math.isinf(most):
        return
    values, vectors = np.linalg.eig(linearised(model, x))
    speeds = np.abs(values)
    rings = (speeds > 0.0) & (-values.real < UNDAMPED * speeds) & (speeds > STILL * np.max(speeds))
    fastest = int(np.argmax(np.where(rings, speeds, 0.0)))
    if not rings[fastest] or speeds[fastest] * h <= most:
        return
    what = "energy, or momentum" if free else "energy"
    advice = f"a physics rate of {speeds[fastest] / most:.3g} Hz or more, or " if most > 0.0 else ""
    warnings.warn(
        f"{scheme.name} makes {what} where the spring of joint {_joint(model, x, vectors[:, fastest])} rings,"
        f" which next to nothing damps, at a physics rate of {1.0 / h:g} Hz (omega h ="
        f" {speeds[fastest] * h:.3g}); use {advice}{DEFAULT}, which does not",
        StabilityWarning,
        stacklevel=4,
    )


def _check_contacts(model: FlexibleJointModel, x: State, h: float, scheme: Scheme) -> None:
    """Warn (StabilityWarning) when a contact is too stiff or too damped for the mass that it moves: beyond
    k = 4 m/h^2, and c = 2 m/h, or m/h where the damper sees a predicted velocity, steps alternate and grow.
    """
    if model.ground is None or not model.ground.springy or scheme.contact_damping is None:
        return
    mass = model.body.mass_matrix(x.q)
    for i in model.rigid:
        if i not in model.grouped:
            mass[model.joints[i].idx_v, model.joints[i].idx_v] += model.flows[i].drive.B
    for group in model.groups:
        if group.rigid:
            at = np.ix_(model.places(group), model.places(group))
            mass[at] += np.array(group.inertia, dtype=float)
    _, jacobians = model.ground.places(model.body, x.q)
    for item, jacobian in zip(model.ground.contacts, jacobians, strict=True):
        inverse = jacobian @ np.linalg.solve(mass, jacobian.T)
        along, normal = 1.0 / np.max(np.linalg.eigvalsh(inverse[:2, :2])), 1.0 / inverse[2, 2]
        for name, limit in (
            ("stiffness", 4.0 * normal / h**2),
            ("tangential_stiffness", 4.0 * along / h**2),
            ("tangential_damping", scheme.contact_damping * along / h),
        ):
            if getattr(item, name) > limit:
                warnings.warn(
                    f"{scheme.name} is unstable on the contact of {item.frame} at a physics rate of"
                    f" {1.0 / h:g} Hz: {name} is {getattr(item, name):g}, and {limit:.3g} is the most for the"
                    " mass that moves there; lower it, or raise the rate",
                    StabilityWarning,
                    stacklevel=3,
                )
                return


def _growth(step: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(step))))


def _joint(model: FlexibleJointModel, x: State, mode: np.ndarray) -> str:
    """The joint whose spring has most of a mode's energy; of rigid ones, which has none, the fastest."""
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
