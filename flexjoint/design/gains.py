"""Gains by design: LQR and pole placement on the full state, and the motor PD of Tomei for a wanted link
bandwidth.

python-control solves the standard problems. Every design is stepped in the nonlinear simulation before it is
handed out, and carries the verdict (`verification`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq

from flexjoint.core.errors import ModelError, unknown
from flexjoint.design.feedback import PAST, READS, Gains, close_loop
from flexjoint.design.linear_model import LinearModel, python_control
from flexjoint.design.linearise import linearise
from flexjoint.design.margins import Margins, margins, smallest_damping
from flexjoint.design.quasilinear import Nonsmooth, kinked
from flexjoint.design.tomei import TomeiCheck, position_limits, tomei
from flexjoint.design.verification import StepTest, Verification, verify
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.joint import JointFlow
from flexjoint.model.statics.equilibrium import equilibrium

POSES = 20  # sampled for a PD design where the caller gives none
SCAN = 200  # bandwidths tried to tell which are reachable
STIFFEST = 1e3  # times what a rigid joint would need: the largest kp tried
Weights = np.ndarray | Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Design:
    """Gains with the linear model they were designed on (sampled where they are for a rate), the closed
    loop's poles, its margins there, and what the nonlinear simulation showed."""

    gains: Gains
    linear: LinearModel = field(repr=False)
    poles: np.ndarray = field(repr=False)
    margins: Margins
    verification: Verification

    @property
    def verified(self) -> bool:
        return self.verification.verified


@dataclass(frozen=True, kw_only=True)
class PDDesign(Design):
    """A design of motor PD gains: kp (n,) [N m/rad], kd (n,) [N m s/rad].

    Over `poses` (N, nq): bandwidth (N, n) [Hz] and damping (N, n) of each joint's slowest pair, the others
    held; mimo_damping (N,), smallest damping ratio of the whole robot's closed loop, negative where it is
    unstable. `margins` and `verification` are at the worst pose, that of the smallest mimo_damping.
    """

    kp: np.ndarray
    kd: np.ndarray
    poses: np.ndarray = field(repr=False)
    bandwidth: np.ndarray = field(repr=False)
    damping: np.ndarray = field(repr=False)
    mimo_damping: np.ndarray = field(repr=False)
    tomei: TomeiCheck | None


def lqr(
    model: FlexibleJointModel,
    at: np.ndarray | None = None,
    *,
    Q: Weights,
    R: np.ndarray | float,
    rate: float | None = None,
    delay: float = 0.0,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
    test: StepTest | None = None,
) -> Design:
    """Linear-quadratic gains on the full state at the rest `at` (nq,), by `control.lqr` or, with a rate,
    `control.dlqr`.

    Args:
        Q: (nx, nx) or (nx,) weights of the state, or weights by channel (q, dq, theta, dtheta) or
            channel.joint; absent ones are 0.
        R: weight of the torques: (n, n), (n,) or a number.
        rate: of the ticks [Hz] for a discrete design; the law then knows its commands on the way, so that
            dead times of the command and `delay` [s], the time to compute, are designed for. Q and R then
            weigh the sum over ticks.
        nonsmooth, amplitude: see `linearise`.
        test: the step that verifies the gains.

    Raises:
        ModelError: states that no joint's sensors show (a floating base, internal states of effects).
    """
    linear, plant = _plants(model, at, rate, delay, nonsmooth, amplitude)
    Qm, Rm = _state_weights(Q, plant), _input_weights(R, len(plant.inputs))
    ct = python_control()
    solve = ct.lqr if plant.dt is None else ct.dlqr
    K = np.asarray(solve(plant.A, plant.B, Qm, Rm)[0])
    return _designed(model, at, Gains(K, plant.states, plant.inputs, rate), linear, test, delay)


def place(
    model: FlexibleJointModel,
    at: np.ndarray | None = None,
    *,
    poles: Sequence[complex],
    rate: float | None = None,
    delay: float = 0.0,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
    test: StepTest | None = None,
) -> Design:
    """Gains on the full state that put the closed loop's poles where they are wanted, by `control.place`.

    Args:
        poles: (nx,) continuous poles [1/s], conjugate pairs; none may come more often than there are motors.
            With a rate they are mapped to exp(pole / rate), and further poles of dead times go to 0.

    The rest is as for `lqr`. Raises ModelError for another number of poles, and for more than one tick of
    dead time.
    """
    linear, plant = _plants(model, at, rate, delay, nonsmooth, amplitude)
    wanted = np.asarray(poles, dtype=complex)
    n = len(linear.states) if linear.dt is None else sum(PAST not in name for name in plant.states)
    if wanted.shape != (n,):
        raise ModelError(
            f"poles: expected {n}, one per state ({', '.join(plant.states[:n])}), got {wanted.size}"
        )
    if plant.dt is not None:
        wanted = np.concatenate([np.exp(wanted * plant.dt), np.zeros(len(plant.states) - n)])
        if len(plant.states) - n > len(plant.inputs):
            raise ModelError(
                "more than one tick of dead time: pole placement cannot repeat that many poles; use lqr"
            )
    K = np.asarray(python_control().place(plant.A, plant.B, wanted))
    return _designed(model, at, Gains(K, plant.states, plant.inputs, rate), linear, test, delay)


def motor_pd(
    model: FlexibleJointModel,
    bandwidth: np.ndarray | float,
    damping: np.ndarray | float = 0.7,
    *,
    poses: np.ndarray | int = POSES,
    seed: int = 0,
    delay: float = 0.0,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
    test: StepTest | None = None,
) -> PDDesign:
    """Gains of tau = g(q_d) + K_P (theta_d - theta) - K_D dtheta for a wanted link bandwidth and damping per
    joint.

    For each joint, the others held at the pose where its link is heaviest, motor and link make an equation of
    order four; two gains put one pole pair exactly at bandwidth and damping, which is refused unless the
    other pair is faster. A joint that its motor damps more than wanted gets K_D = 0. Lighter poses are
    quicker, gravity aside. The whole robot, sampled at its control rate with `delay` [s] and its dead times,
    is then checked at every pose.

    Args:
        bandwidth: natural frequency of each joint's slowest pair [Hz], (n,) or one for all.
        damping: its damping ratio at least, in (0, 1).
        poses: (N, nq), or how many to sample within the joint limits with `seed`.
        nonsmooth, amplitude: see `linearise`.
        test: the step that verifies the gains.

    Raises:
        ModelError: a bandwidth that the spring does not let through; the message has the reachable ones.

    Source: Kameduła et al. 2016, equation 4; the pole pair from De Luca and Book 2016, section 11.2 (one
    elastic joint).
    """
    n = len(model.joints)
    wanted = 2.0 * np.pi * np.broadcast_to(np.asarray(bandwidth, dtype=float), n)
    ratio = np.broadcast_to(np.asarray(damping, dtype=float), n)
    if np.any(wanted <= 0.0) or np.any(ratio <= 0.0) or np.any(ratio >= 1.0):
        raise ModelError(
            f"expected a bandwidth > 0 Hz and a damping in (0, 1), got {bandwidth} and {damping}"
        )
    if isinstance(poses, int):
        if model.nq != model.nv:
            raise ModelError("poses of a floating base cannot be sampled; give them, (N, nq)")
        low, high = position_limits(model)
        poses = low + (high - low) * np.random.default_rng(seed).random((poses, model.nq))
    poses = np.atleast_2d(np.asarray(poses, dtype=float))
    rough = kinked(model.effects)
    smooth = FlexibleJointModel(model.robot, [e for e in model.effects if e not in rough])
    joints = [[_Joint.of(smooth, i, q) for i in range(n)] for q in poses]
    kp, kd = np.zeros(n), np.zeros(n)
    for i in range(n):
        heaviest = max((row[i] for row in joints), key=lambda joint: joint.M)
        kp[i], kd[i] = heaviest.gains(wanted[i], ratio[i])
    pairs = np.array([[row[i].slowest(kp[i], kd[i]) for i in range(n)] for row in joints])
    gains = Gains.motor_pd(model.robot, kp, kd)
    control = model.robot.rates.control
    sampled = [
        linearise(model, q, nonsmooth=nonsmooth, amplitude=amplitude).sampled(control, delay) for q in poses
    ]
    mimo = np.array([smallest_damping(close_loop(linear, gains)) for linear in sampled])
    worst = int(np.argmin(mimo))
    design = _designed(model, poses[worst], gains, sampled[worst], test, delay)
    check = tomei(model, kp) if model.nv == n else None
    return PDDesign(
        gains=gains,
        linear=design.linear,
        poles=design.poles,
        margins=design.margins,
        verification=design.verification,
        kp=kp,
        kd=kd,
        poses=poses,
        bandwidth=np.abs(pairs) / (2.0 * np.pi),
        damping=-pairs.real / np.abs(pairs),
        mimo_damping=mimo,
        tomei=check,
    )


# --- one joint, the others held ---------------------------------------------------------------------------
@dataclass(frozen=True)
class _Joint:
    """M, G of the link (inertia, gravity's slope) with its viscous friction, the spring, and the motor, at a
    pose."""

    name: str
    M: float
    G: float
    friction: float
    K: float
    D: float
    B: float
    D_m: float

    @staticmethod
    def of(model: FlexibleJointModel, i: int, q: np.ndarray) -> _Joint:
        joint, flow, zero = model.joints[i], model.flows[i], np.zeros(model.nv)
        place = joint.idx_v
        mass = float(model.body.mass_matrix(q)[place, place])
        gravity = float(model.body.rnea_derivatives(q, zero, zero)[0][place, place])
        on_motor, on_link = _resistances(flow, float(q[joint.idx_q]))
        K, D = flow.drive.K, flow.drive.D
        if not joint.rigid and flow.nonlinear_spring:
            theta = float(equilibrium(model, q).theta[0, i])
            s = Signals(q=float(q[joint.idx_q]), theta=theta, phi=theta - float(q[joint.idx_q]))
            _, K, D = flow.linear_spring(s, [0.0] * max(model.nz, 1), 0.0)
        B, D_m = flow.drive.B, flow.drive.D_m + on_motor
        for group in model.groups:  # of shafts that turn with it, the other joints held
            if i in group.joints:
                r = group.joints.index(i)
                B, D_m = (group.matrix([getattr(x, key) for x in group.shafts])[r][r] for key in ("B", "D_m"))
                D_m = D_m + on_motor
        return _Joint(joint.name, mass, gravity, on_link, float(K), float(D), float(B), float(D_m))

    def polynomial(self, kp: float, kd: float) -> np.ndarray:
        """Characteristic polynomial under the PD, highest power first."""
        if np.isinf(self.K):
            return np.array([self.M + self.B, self.friction + self.D_m + kd, self.G + kp])
        spring = np.array([self.D, self.K])
        link = np.polyadd([self.M, self.friction, self.G], spring)
        motor = np.polyadd([self.B, self.D_m + kd, kp], spring)
        return np.polysub(np.polymul(link, motor), np.polymul(spring, spring))

    def slowest(self, kp: float, kd: float) -> complex:
        """The root nearest to the origin."""
        roots = np.roots(self.polynomial(kp, kd))
        return complex(roots[np.argmin(np.abs(roots))])

    def pair(self, frequency: float, ratio: float) -> tuple[float, float, bool]:
        """kp and kd that make s = frequency (-ratio + j sqrt(1 - ratio^2)) the slowest root, and whether they
        do. Where that takes kd < 0, the motor's own damping is more than was asked for: kd = 0, and kp alone
        sets the distance of the slowest root from the origin."""
        s = frequency * complex(-ratio, np.sqrt(1.0 - ratio * ratio))
        if np.isinf(self.K):
            value = -((self.M + self.B) * s * s + (self.friction + self.D_m) * s + self.G)
        else:
            spring = self.D * s + self.K
            link = self.M * s * s + self.friction * s + self.G + spring
            value = spring * spring / link - (self.B * s * s + self.D_m * s + spring)
        kd = value.imag / s.imag
        kp = value.real - kd * s.real
        if kd < 0.0:
            kp, kd = self._undamped(frequency), 0.0
        roots = np.roots(self.polynomial(kp, kd))
        least = roots[np.argmin(np.abs(roots))]
        exact = abs(abs(least) - frequency) < 1e-6 * frequency and -least.real > ratio * abs(least) * (
            1.0 - 1e-6
        )
        return kp, kd, kp > 0.0 and exact and bool(np.all(roots.real < 0.0))

    def _undamped(self, frequency: float) -> float:
        """kp that puts the slowest root at that distance from the origin with kd = 0; 0 where none does."""

        def beyond(kp: float) -> float:
            return abs(self.slowest(kp, 0.0)) - frequency

        low, high = max(-self.G, 0.0), STIFFEST * (self.M + self.B) * frequency**2
        return float(brentq(beyond, low, high)) if beyond(low) < 0.0 < beyond(high) else 0.0

    def gains(self, frequency: float, ratio: float) -> tuple[float, float]:
        kp, kd, fit = self.pair(frequency, ratio)
        if fit:
            return kp, kd
        speeds = [w for w in np.geomspace(1e-2 * frequency, 1e2 * frequency, SCAN) if self.pair(w, ratio)[2]]
        ratios = [x for x in np.linspace(0.01, 0.99, 99) if self.pair(frequency, x)[2]]
        hints = []
        if speeds:
            low, high = speeds[0] / (2 * np.pi), speeds[-1] / (2 * np.pi)
            hints.append(f"with this damping, {low:.3g} to {high:.3g} Hz can be reached")
        if ratios:
            hints.append(f"at this bandwidth, a damping of {ratios[0]:.2f} to {ratios[-1]:.2f}")
        hint = "; ".join(hints) or "ask for less of both"
        locked = np.sqrt((self.K + self.G) / self.M) / (2.0 * np.pi)
        raise ModelError(
            f"joint {self.name}: motor PD gains cannot give {frequency / (2 * np.pi):.3g} Hz at a damping of"
            f" {ratio:g} (with"
            f" its motor locked, the link swings at {locked:.3g} Hz; link inertia {self.M:.3g} kg m^2):"
            f" {hint}"
        )


def _resistances(flow: JointFlow, q: float) -> tuple[float, float]:
    """Viscous friction that effects put on motor and link at rest [N m s/rad]."""
    s, z = Signals(q=q, theta=q), [0.0] * (1 + max((part.slot for part in flow.stateful), default=0))
    return float(flow.motor(s, z, 0.0)[1]), float(flow.link(s, z, 0.0)[1])


# --- shared -----------------------------------------------------------------------------------------------
def _plants(
    model: FlexibleJointModel,
    at: np.ndarray | None,
    rate: float | None,
    delay: float,
    nonsmooth: Nonsmooth | None,
    amplitude: Mapping[str, float] | None,
) -> tuple[LinearModel, LinearModel]:
    """The linear model, and the one to design on, whose states are all known to the law."""
    linear = linearise(model, at, nonsmooth=nonsmooth, amplitude=amplitude)
    seen = [f"{channel}.{joint}" for channel in READS for joint in model.robot.joint_names]
    blind = [name for name in linear.states if name not in seen]
    if blind:
        raise ModelError(
            f"no sensor shows {', '.join(blind)}: state feedback needs a fixed base, every joint actuated"
            f" and no internal"
            " states of effects (nonsmooth='null' leaves out those of effects with kinks)"
        )
    at_once = replace(linear, output_delay=np.zeros(len(linear.outputs)))
    if rate is None:
        if linear.delayed or delay > 0.0:
            raise ModelError("dead times: give the rate of the ticks, so that they are designed for")
        return linear, at_once
    return linear.sampled(rate, delay), at_once.sampled(rate, delay)


def _designed(
    model: FlexibleJointModel,
    at: np.ndarray | None,
    gains: Gains,
    linear: LinearModel,
    test: StepTest | None,
    delay: float,
) -> Design:
    poles = close_loop(linear, gains).poles
    return Design(
        gains=gains,
        linear=linear,
        poles=poles,
        margins=margins(linear, gains),
        verification=verify(model, gains, at, test, delay),
    )


def _state_weights(Q: Weights, plant: LinearModel) -> np.ndarray:
    n = len(plant.states)
    if isinstance(Q, Mapping):
        weights = np.zeros(n)
        for name, value in Q.items():
            found = [
                k
                for k, state in enumerate(plant.states)
                if PAST not in state and name in (state, state.split(".")[0])
            ]
            if not found:
                raise unknown("weight of Q", name, [*READS, *plant.states])
            weights[found] = value
        return np.diag(weights)
    given = np.asarray(Q, dtype=float)
    given = np.diag(given) if given.ndim == 1 else given
    own = sum(PAST not in state for state in plant.states)
    if given.shape == (own, own):
        given = np.pad(given, (0, n - own))  # past commands carry no weight
    if given.shape != (n, n):
        raise ModelError(
            f"Q: expected weights of {own} states ({', '.join(plant.states[:own])}), got shape {np.shape(Q)}"
        )
    return given


def _input_weights(R: np.ndarray | float, n: int) -> np.ndarray:
    given = np.asarray(R, dtype=float)
    if given.ndim < 2:
        given = np.diag(np.broadcast_to(given, n)) if given.size in (1, n) else given
    if given.shape != (n, n):
        raise ModelError(
            f"R: expected a number, ({n},) or ({n}, {n}) weights of the torques, got shape {np.shape(R)}"
        )
    return given
