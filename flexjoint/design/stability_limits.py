"""Where stability ends: the longest sampling period, the stiffest spring of a scheme, and poles over
stiffness."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from flexjoint.core.errors import ModelError, SimulationError
from flexjoint.design.feedback import Gains, close_loop
from flexjoint.design.linear_model import LinearModel, python_control
from flexjoint.design.linearise import linearise
from flexjoint.design.margins import is_stable
from flexjoint.design.quasilinear import Nonsmooth, kinked
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.robot.robot import Robot
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.schemes import DEFAULT, find, make_step
from flexjoint.simulation.schemes.stability import check_stability

if TYPE_CHECKING:
    import control

FIXED_STEP = (DEFAULT, "semi_implicit_euler", "explicit_euler", "kamedula2016", "rk4")
LONGEST_MEMORY = 40  # ticks of dead time up to which shorter periods are tried
SHORTEST = 1e-5  # s, the shortest period and step tried
STEP = 1.03  # between two periods tried: a band of instability narrower than that may be missed
HALVINGS, TIGHT = 40, 1e-6
SOFTEST, STIFFEST = 1e-3, 1e8  # times the robot's own; beyond it a scheme counts as stable for any stiffness
DIFFERENCE = 1e-5  # of the central differences: rad, rad/s, N m
ROUNDING = 1e-6  # by which they may move a pole that lies on the unit circle


@dataclass(frozen=True)
class SchemeLimits:
    """period [s]: longest step at the robot's stiffness; stiffness: largest factor on all springs at the rate
    asked for. Infinite for a scheme that is stable for any."""

    period: float
    stiffness: float


def longest_period(linear: LinearModel, gains: Gains, delay: float = 0.0, longest: float = 0.2) -> float:
    """The longest sampling period [s] up to which the feedback is stable on a continuous model, its command
    held and `delay` [s] late; `longest` if it is stable throughout, 0 if it is not at the shortest period
    tried: 10 us, or 1/40 of the dead time."""

    def stable(period: float) -> bool:
        return is_stable(close_loop(linear.sampled(1.0 / period, delay), gains))

    dead = float(np.max(linear.input_delay, initial=0.0) + np.max(linear.output_delay, initial=0.0)) + delay
    good = max(SHORTEST, dead / LONGEST_MEMORY)
    if not stable(good):
        return 0.0
    while good < longest:
        bad = min(good * STEP, longest)
        if not stable(bad):
            return _boundary(stable, good, bad)
        good = bad
    return longest


def scheme_limits(
    model: FlexibleJointModel,
    at: np.ndarray | None = None,
    rate: float | None = None,
    gains: Gains | None = None,
    schemes: Sequence[str] = FIXED_STEP,
) -> Mapping[str, SchemeLimits]:
    """How long a step and how stiff a spring each integration scheme bears on this robot at `at` (nq,), by
    scheme.

    The period is that of masses, springs and dampers alone, as `integrate.check_stability` has it. The
    stiffness, at the physics rate `rate` [Hz] (default: the robot's), counts the controller too where `gains`
    are given (see `simulated`): then 0 is a loop that is unstable with the robot's own springs already, and
    softer ones are not looked at. Raises UnknownNameError.
    """
    for scheme in schemes:
        find(scheme)
    rate = rate or model.robot.rates.physics
    state = model.rest(None if at is None else np.asarray(at, dtype=float))

    def stiff(factor: float) -> FlexibleJointModel:
        return FlexibleJointModel(with_stiffness(model.robot, factor), model.effects)

    def alone(scheme: str, factor: float, step: float) -> bool:
        with warnings.catch_warnings():  # a refusal or a warning, it says that the scheme diverges
            warnings.simplefilter("error")
            try:
                check_stability(stiff(factor), state, step, scheme, ringing=False)
            except (SimulationError, Warning):
                return False
        return True

    def closed(scheme: str, factor: float, gains: Gains) -> bool:
        if not alone(scheme, factor, 1.0 / rate):
            return False
        loop = close_loop(simulated(stiff(factor), at, scheme, rate), gains)
        return bool(np.max(np.abs(loop.poles)) <= 1.0 + ROUNDING)

    out = {}
    for scheme in schemes:
        period = _largest(partial(alone, scheme, 1.0), SHORTEST, 1.0)
        if gains is None:
            stiffness = _largest(partial(alone, scheme, step=1.0 / rate), SOFTEST, STIFFEST)
        else:
            stiffness = _largest(partial(closed, scheme, gains=gains), 1.0, STIFFEST)
        out[scheme] = SchemeLimits(period, stiffness)
    return out


def simulated(
    model: FlexibleJointModel,
    at: np.ndarray | None = None,
    scheme: str = DEFAULT,
    rate: float | None = None,
) -> LinearModel:
    """What an integration scheme makes of the robot at rest at `at` (nq,), linear and sampled at the robot's
    control rate: its poles are those of a simulation, where `LinearModel.sampled` has the true ones.

    The scheme's own step at `rate` [Hz] (default: the robot's physics rate, a whole multiple of the control
    rate) is differentiated by central differences. What the scheme remembers of its last step are states,
    too. Effects with kinks and dead times are left out.
    """
    control = model.robot.rates.control
    substeps = round((rate or physics_rate(model.robot)) / control)
    if substeps < 1 or abs(substeps * control - (rate or substeps * control)) > 1e-9 * control:
        raise ModelError(f"rate: expected a whole multiple of the control rate {control:g} Hz, got {rate} Hz")
    linear = linearise(model, at, nonsmooth="null")
    rough = kinked(model.effects)
    own = FlexibleJointModel(model.robot, [e for e in model.effects if e not in rough])
    q = own.body.neutral if at is None else np.asarray(at, dtype=float)
    rest = equilibrium(own, q)
    step = make_step(own, 1.0 / (substeps * control), scheme)
    nv, nf, n = own.nv, own.nf, len(own.joints)
    edges = np.cumsum([nv, nv, nf, nf, own.nz, nv, nf])
    names = ("q", "v", "theta", "dtheta", "z", "acc", "ddtheta")

    def stepped(deviation: np.ndarray) -> np.ndarray:
        parts = dict(zip(names, np.split(deviation[:-n], edges[:-1]), strict=True))
        state = own.rest(own.body.integrate(q, parts["q"]))
        state.v, state.theta = parts["v"], rest.theta[0, list(own.flexible)] + parts["theta"]
        state.dtheta, state.z = parts["dtheta"], state.z + parts["z"]
        state.acc, state.ddtheta = parts["acc"], parts["ddtheta"]
        after = step(state, rest.tau[0] + deviation[-n:])
        moved = own.body.difference(q, after.q)
        theta = after.theta - rest.theta[0, list(own.flexible)]
        return np.concatenate([moved, after.v, theta, after.dtheta, after.z, after.acc, after.ddtheta])

    size = int(edges[-1])
    columns = [
        (stepped(DIFFERENCE * e) - stepped(-DIFFERENCE * e)) / (2.0 * DIFFERENCE) for e in np.eye(size + n)
    ]
    one = np.array(columns).T
    A, B = np.eye(size), np.zeros((size, n))
    for _ in range(substeps):
        A, B = one[:, :size] @ A, one[:, :size] @ B + one[:, size:]
    C = np.hstack([linear.C, np.zeros((len(linear.outputs), nv + nf))])
    memory = tuple(f"memory[{k}]" for k in range(nv + nf))
    return replace(
        linear, A=A, B=B, C=C, states=(*linear.states, *memory), drift=np.zeros(size), dt=1.0 / control,
        input_delay=np.zeros(n), output_delay=np.zeros(len(linear.outputs)),
    )  # fmt: skip


def stiffness_locus(
    model: FlexibleJointModel,
    stiffness: Sequence[float],
    joint: str | None = None,
    at: np.ndarray | None = None,
    gains: Gains | None = None,
    *,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
) -> control.PoleZeroData:
    """Poles while the stiffness of a joint varies (or, without a joint, a factor on all), as python-control's
    data of a root locus: `loci` (N, nx) over `gains` (N,), and `.plot()`.

    Args:
        stiffness: (N,) values of K [N m/rad], or factors, increasing.
        gains: closes the loop, continuously (default: open).
        nonsmooth, amplitude: see `linearise`.

    Raises ModelError for stiffnesses that do not increase from above 0, and what `linearise` raises.
    """
    python_control()
    from control.pzmap import PoleZeroData

    values = np.asarray(stiffness, dtype=float)
    if values.ndim != 1 or len(values) < 2 or np.any(np.diff(values) <= 0.0) or values[0] <= 0.0:
        raise ModelError("stiffness: expected at least two increasing values > 0")
    loci = []
    for value in values:
        varied = with_stiffness(model.robot, value, joint)
        linear = linearise(
            FlexibleJointModel(varied, model.effects), at, nonsmooth=nonsmooth, amplitude=amplitude
        )
        loci.append((close_loop(linear, gains) if gains else linear).poles)
    return PoleZeroData(
        loci[0], np.zeros(0), gains=values, loci=np.array(loci), sysname=joint or model.robot.name
    )


def with_stiffness(robot: Robot, value: float, joint: str | None = None) -> Robot:
    """The robot with K of a joint set [N m/rad] or, without a joint, of all joints times a factor."""
    if joint is not None:
        robot.joint(joint)
    joints = []
    for item in robot.joints:
        K = value if item.name == joint else item.drive.K * value if joint is None else item.drive.K
        joints.append(replace(item, drive=replace(item.drive, K=K)))
    return replace(robot, joints=tuple(joints))


def _largest(stable: Callable[[float], bool], low: float, high: float) -> float:
    """Where stability ends between low and high, taken to end once; 0 or infinity where it does not in
    between."""
    if not stable(low):
        return 0.0
    if stable(high):
        return np.inf
    return _boundary(stable, low, high)


def _boundary(stable: Callable[[float], bool], good: float, bad: float) -> float:
    """The last good value, to a relative TIGHT, by bisection in the logarithm."""
    for _ in range(HALVINGS):
        middle = float(np.sqrt(good * bad))
        good, bad = (middle, bad) if stable(middle) else (good, middle)
        if bad < good * (1.0 + TIGHT):
            break
    return good
