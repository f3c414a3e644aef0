"""What a dirty machine has beside its wrong numbers: effects, drawn and sized by shares of the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..catalogue import DRY_MOTOR, OUTSIDE, WITH_STATE, Planted
from ..drawn import in_logarithm
from ..machine.chain import Array
from ..machine.sensing import CURRENT
from ..robots import Robot
from ..shares import Torques
from ..simulate import Recorded
from .case import Dirty, tolerance
from .sizes import PRESUMED, Moved, allowed, least, scaled, unsized

SMALL_ERRORS = (4, 9)
SMALL_SHARES = (0.005, 0.03)  # of the torque's RMS
LARGE_SHARES = (0.15, 0.5)
COUNTS = (0.4, 0.35, 0.25)  # of one, two and three large causes
ADJUSTED = (0.3, 3.0)  # by which a size may change at the second look
SPARE = 3  # times as many effects are drawn as are needed: some cannot be had on a machine

LARGE_CAUSES = {
    "motor_coulomb_friction": 4,
    "motor_viscous_friction": 3,
    "asymmetric_friction": 2,
    "stribeck_friction": 2,
    "load_friction": 2,
    "payload": 3,
    "torque_offset": 2,
    "torque_gain": 2,
    "motor_inertia": 2,
    "backlash": 2,
    "spring_stiffness": 2,
    "cable_spring": 2,
    "sensor_delay": 1,
    "encoder_eccentricity": 1,
    "cogging": 1,
    "breakaway_friction": 1,
}
"""What real machines have, with weights."""

SMALL_CAUSES = (
    "cogging",
    "motor_viscous_friction",
    "motor_coulomb_friction",
    "load_friction",
    "stribeck_friction",
    "friction_drift",
    "dahl_friction",
    "drive_efficiency",
    "torque_gain",
    "torque_offset",
    "hardening_spring",
    "spring_hysteresis",
    "transmission_error",
    "cable_spring",
    "link_viscous_friction",
    "link_coulomb_friction",
    "quadratic_drag",
    "encoder_eccentricity",
    "encoder_ripple",
    "current_lag",
    "joint_coupling",
)
"""The half of the background that the catalogue knows."""

UNKNOWN = (
    "wobbling_mass",
    "dead_command",
    "neighbour_pull",
    "drive_dropouts",
    "pushes",
    "drag_at_speed",
)
"""Laws that are no close relative of a catalogue's: there is no name that would be half right."""
DRY = (*DRY_MOTOR, "link_coulomb_friction", "dahl_friction")
VISCOUS = ("motor_viscous_friction", "link_viscous_friction", "quadratic_drag")
ALIKE = (DRY, VISCOUS)
"""Of each, a joint has one: two would add up to a third."""

MOTOR_SIDE = (
    *(effect for effect in DRY if effect != "link_coulomb_friction"),
    "motor_viscous_friction",
    "payload",
    "torque_offset",
    "torque_gain",
    "motor_inertia",
    "cogging",
)
"""Large causes of a flexible joint that leave a mark in its motor's readings alone."""
WITH_LINK_ENCODER = ("encoder_eccentricity",)
IN_THE_CURRENT = ("current_lag", "drive_resonance", "joint_coupling")
"""What a measured current shows as it is: nothing is off then."""


def pick(shares: dict, rng: np.random.Generator):
    weights = np.array(list(shares.values()), dtype=float)
    return list(shares)[int(rng.choice(len(weights), p=weights / weights.sum()))]


def chosen_for(case: Dirty, healthy: Recorded, rng: np.random.Generator) -> tuple[Dirty, list[float]] | None:
    """The case with its effects and the shares that they are to have, unknown first, then causes, then the
    background; None where the machine has no place for what was drawn."""
    robot, known = healthy.run.sensors.robot, tolerance(case.robot)
    small = int(rng.integers(*SMALL_ERRORS))
    outside = small // 2
    large = 1 + int(rng.choice(3, p=COUNTS)) if case.kind == "causes" else 0
    large = min(large, 1 + len(robot.joints))
    wanted = (
        (large, LARGE_CAUSES, "large"),
        (int(case.kind == "unknown"), dict.fromkeys(UNKNOWN, 1), "unknown"),
        (outside, {e: 1 for e, own in OUTSIDE.items() if own.family == case.background_family}, "small"),
        (small - outside, dict.fromkeys(SMALL_CAUSES, 1), "small"),
    )
    drawn = [_several(SPARE * count, pool, case, healthy, role, rng) for count, pool, role in wanted]
    shares = iter(_unsized_shares([p for group in drawn for p in group], healthy))
    taken: list[Planted] = []
    groups: list[tuple[Planted, ...]] = []
    targets: list[float] = []
    for (count, _, role), group in zip(wanted, drawn, strict=True):
        kept: list[Planted] = []
        low, high = SMALL_SHARES if role == "small" else LARGE_SHARES
        for planted in group:
            share, target = next(shares), in_logarithm(rng, low, high)
            if len(kept) == count or not share > 0 or not _fits(planted, taken):
                continue
            factor = target / share
            if role == "large":
                factor = max(factor, least(planted, known))
            if factor > allowed(planted, robot):
                continue
            kept.append(scaled(planted, factor))
            taken.append(kept[-1])
            targets.append(max(target, factor * share))
        if len(kept) < count:
            return None
        groups.append(tuple(kept))
    causes, unknown, beyond, inside = groups
    return replace(case, effects=causes, unknown=unknown, background=(*beyond, *inside)), targets


def _unsized_shares(effects: Sequence[Planted], healthy: Recorded) -> list[float]:
    """Each one's largest share of a joint's torque on the healthy machine's motion."""
    shares = {k: PRESUMED[p.effect] for k, p in enumerate(effects) if p.effect in PRESUMED}
    left = [k for k in range(len(effects)) if k not in shares]
    while left:  # the same effect on the same joint in several sets of equations
        first = {(effects[k].effect, effects[k].joint): k for k in reversed(left)}
        now = sorted(first.values())
        robot = healthy.run.sensors.robot
        torques = Torques(robot, healthy.real, healthy.run, [], [effects[k] for k in now])
        shares |= {k: float(torques.share(i).max()) for i, k in enumerate(now)}
        left = [k for k in left if k not in now]
    return [shares[k] for k in range(len(effects))]


def _several(
    count: int, pool: dict[str, float], case: Dirty, healthy: Recorded, role: str, rng: np.random.Generator
) -> list[Planted]:
    """Effects of a pool that joints of the machine can have, not yet sized."""
    robot, motion = healthy.run.sensors.robot, _moved(healthy)
    found: list[Planted] = []
    for _ in range(20 * count):
        if len(found) == count:
            break
        effect, j = pick(pool, rng), int(rng.integers(len(robot.joints)))
        if not _visible(effect, j, robot, case.sensors.channels, role):
            continue
        if any((p.effect, p.joint) == (effect, robot.joints[j]) for p in found):
            continue
        channels, unknown = case.sensors.channels, role == "unknown"
        try:
            found.append(unsized(effect, robot, j, motion[j], channels, rng, case.seconds, unknown))
        except ValueError:
            continue
    return found


def _visible(effect: str, j: int, robot: Robot, channels: tuple[str, ...], role: str) -> bool:
    """Whether an effect of joint j leaves a mark of its own in the readings."""
    rigid, link = bool(np.isinf(robot.stiffness[j])), "q" in channels
    if effect in WITH_LINK_ENCODER and (rigid or not link):
        return False
    if effect in IN_THE_CURRENT and CURRENT in channels:
        return False
    if effect == "payload" and (j == 0 < len(robot.joints) - 1 or not _feels_weight(robot)):
        return False
    if role == "large" and not link and not rigid:
        return effect in MOTOR_SIDE
    return True


def _feels_weight(robot: Robot) -> bool:
    """Whether any axis is not upright: else a payload shows its inertia only, not its mass."""
    turned: list[Array] = []
    for body in robot.bodies:
        above = np.eye(3) if body.parent < 0 else turned[body.parent]
        turned.append(above @ body.rotation)
    across = [np.cross(t @ b.axis, robot.gravity) for t, b in zip(turned, robot.bodies, strict=True)]
    return bool(np.abs(across).max() > 1e-3)


def _moved(healthy: Recorded) -> list[Moved]:
    run, n = healthy.run, len(healthy.real.joints)
    first = run.told.first
    states = run.states[first:]
    q, theta, w = states[:, :n], states[:, 2 * n : 3 * n], states[:, 3 * n : 4 * n]

    def rms(values: Array) -> Array:
        return np.sqrt(np.mean(values**2, axis=0))

    rate = run.sensors.robot.control_rate
    found = (
        rms(run.torques[first:]),
        rms(w),
        rms(np.gradient(w, 1 / rate, axis=0)),
        rms(theta - q),
        (q.max(axis=0) + q.min(axis=0)) / 2,
        np.ptp(q, axis=0) / 2,
        np.minimum(np.mean(run.torques[first:] > 0, axis=0), np.mean(run.torques[first:] < 0, axis=0)),
    )
    return [Moved(*(float(values[j]) for values in found)) for j in range(n)]


def _fits(planted: Planted, taken: list[Planted]) -> bool:
    """Whether an effect adds something of its own to those of its joint."""
    own = [p.effect for p in taken if p.joint == planted.joint]
    groups = [group for group in (*ALIKE, WITH_STATE) if planted.effect in group]
    return planted.effect not in own and not any(set(own) & set(group) for group in groups)


def adjusted(case: Dirty, first: Recorded, targets: list[float]) -> Dirty:
    """Every effect sized once more, by its share on the motion that the machine makes with all of them."""
    effects, robot = list(case.everything), first.run.sensors.robot
    torques = Torques(robot, first.real, first.run, effects)
    known, causes = tolerance(case.robot), len(case.effects)
    sized = []
    for k, (planted, target) in enumerate(zip(effects, targets, strict=True)):
        share = float(torques.share(k).max())
        factor = float(np.clip(target / max(share, 1e-9), *ADJUSTED))
        if k < causes:
            factor = max(factor, least(planted, known))
        sized.append(scaled(planted, min(factor, allowed(planted, robot))))
    second = causes + len(case.unknown)
    return replace(
        case,
        effects=tuple(sized[:causes]),
        unknown=tuple(sized[causes:second]),
        background=tuple(sized[second:]),
    )
