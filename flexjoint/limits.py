"""Where stability ends: the longest sampling period, the stiffest spring of a scheme, and poles over
stiffness."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from flexjoint.errors import ModelError, SimulationError
from flexjoint.feedback import Gains, close_loop
from flexjoint.integrate import DEFAULT, SCHEMES, check_stability
from flexjoint.linear_model import LinearModel, python_control
from flexjoint.linearise import linearise
from flexjoint.margins import is_stable
from flexjoint.model import FlexibleJointModel
from flexjoint.quasilinear import Nonsmooth
from flexjoint.robot import Robot

if TYPE_CHECKING:
    import control

LONGEST_MEMORY = 40  # ticks of dead time up to which shorter periods are tried
SHORTEST = 1e-5  # s, the shortest period and step tried
STEP = 1.03  # between two periods tried: a band of instability narrower than that may be missed
HALVINGS = 40
STIFFEST = 1e12  # times the robot's own: beyond it a scheme counts as stable for any stiffness


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
    model: FlexibleJointModel, at: np.ndarray | None = None, rate: float | None = None
) -> Mapping[str, SchemeLimits]:
    """How long a step and how stiff a spring each integration scheme bears on this robot at `at` (nq,), by
    scheme.

    As `integrate.check_stability` sees it: masses, springs and dampers, without a controller. `rate` [Hz] is
    the physics rate at which the stiffness is varied (default: the robot's).
    """
    h = 1.0 / (rate or model.robot.rates.physics)
    state = model.rest(None if at is None else np.asarray(at, dtype=float))
    out = {}
    for scheme in SCHEMES:

        def stable(factor: float, step: float, scheme: str = scheme) -> bool:
            scaled = FlexibleJointModel(with_stiffness(model.robot, factor), model.effects)
            try:
                check_stability(scaled, state, step, scheme)
            except SimulationError:
                return False
            return True

        if scheme == DEFAULT:
            out[scheme] = SchemeLimits(np.inf, np.inf)
            continue
        period = _largest(lambda step: stable(1.0, step), SHORTEST, 1.0)
        out[scheme] = SchemeLimits(period, _largest(lambda factor: stable(factor, h), 1e-6, STIFFEST))
    return out


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
    data of a root
    locus: `loci` (N, nx) over `gains` (N,), and `.plot()`.

    Args:
        stiffness: (N,) values of K [N m/rad], or factors, increasing.
        gains: closes the loop, continuously (default: open).
        nonsmooth, amplitude: see `linearise`.
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
    """The last good value, to a relative 1e-9 or what HALVINGS give, by bisection in the logarithm."""
    for _ in range(HALVINGS):
        middle = float(np.sqrt(good * bad))
        good, bad = (middle, bad) if stable(middle) else (good, middle)
        if bad < good * (1.0 + 1e-9):
            break
    return good
