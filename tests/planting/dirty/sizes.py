"""Effects of dirty machines before they are sized: each makes about a tenth of a joint's torque.

Every effect is linear in the parameters that SCALED names, so that a share of the torque is reached by
scaling them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..catalogue import OUTSIDE, Planted, law
from ..machine.outside import WOBBLING
from ..machine.sensing import CURRENT
from ..robots import Robot
from ..sizes import rounded

TENTH = 0.1

SCALED = {
    "asymmetric_friction": ("level_positive", "level_negative"),
    "stribeck_friction": ("level", "static_extra"),
    "drive_efficiency": ("loss_driving", "loss_backdriving"),
}
"""Parameters that make an effect large, where that is not the first one alone."""

PRESUMED = {
    "spring_hysteresis": TENTH,
    "dahl_friction": TENTH,
    "breakaway_friction": TENTH,
    WOBBLING: TENTH,
}
"""Shares of effects with a state of their own, until a motion with them has been made."""

CAPS = {
    "torque_gain": 0.35,
    "load_friction": 0.5,
    "drive_efficiency": 0.5,
    "motor_inertia": 3.0,
    "spring_stiffness": 1.5,
    "joint_coupling": 0.4,
    "backlash": 0.03,  # rad
    "transmission_error": 0.03,
    "mesh_error": 0.02,
    "encoder_eccentricity": 0.03,
    "encoder_ripple": 0.005,
    "encoder_series": 0.005,
    "sensor_delay": 0.02,  # s; less where the controller is fast
    "position_filter": 0.02,
    "current_lag": 0.02,
    "drive_resonance": 0.05,
    "torque_droop": 0.2,
    "load_cogging": 0.4,
    "heated_drive": 0.5,
    "gear_ripple": 0.4,
    "one_sided_spring": 0.6,
    "drive_dropouts": 1.0,
}
"""Largest sizes that a machine may have and still move; of the first parameter."""
SOFTEST = -0.6  # of a stiffness
HEAVIEST = 3.0  # a payload, in masses of its link
LATE = 0.12  # of the time in which a controller answers, that its readings may be late
KNOWN_BY = {"motor_inertia": "inertial", "spring_stiffness": "stiffness", "torque_gain": "inertial"}
"""The tolerance in which an effect would be lost."""
REVERSING = 0.1
"""Share of the time in which a torque must have its rarer sign, for a dead command that is to be unknown:
where it never turns, what is taken away of it is a constant torque, which the catalogue has."""
BEYOND_TOLERANCE = 4.0  # standard deviations that a large one of these is off, at least
AS_SENSED = (10, 40)  # cycles a turn of cogging and of gears
GEAR_CYCLES, PATH_CYCLES = (2, 16), (1, 6)


@dataclass(frozen=True)
class Moved:
    """How a joint moves and works, RMS values over a healthy machine's recording."""

    torque: float  # N m
    speed: float  # rad/s
    acceleration: float  # rad/s^2
    deflection: float  # rad
    middle: float  # rad
    reach: float  # rad, from the middle to the ends
    reversing: float  # share of the time in which the torque has its rarer sign


def unsized(
    effect: str, robot: Robot, j: int, moved: Moved, channels: tuple[str, ...], rng: np.random.Generator,
    seconds: float, unknown: bool = False,
) -> Planted:  # fmt: skip
    """An effect on joint j; raises ValueError where the joint cannot have it. `unknown` says that it is to be
    large and seen as such."""
    t, w, k = moved.torque, moved.speed, robot.stiffness[j]
    joint, tenth = robot.joints[j], TENTH * moved.torque
    sign, phase = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-3, 3))
    rigid = bool(np.isinf(k))
    turns = float(rng.integers(*AS_SENSED))
    gear = float(rng.integers(*GEAR_CYCLES))
    path = float(rng.integers(*PATH_CYCLES))
    angle = moved.middle + moved.reach * float(rng.uniform(-0.6, 0.6))
    twist = 1e-3 if rigid else tenth / k  # rad
    period = float(rng.uniform(2, 10))
    times = tuple(
        round(float(x), 3) for x in np.sort(rng.uniform(0.5, seconds - 0.3, int(rng.integers(4, 9))))
    )
    length = float(rng.uniform(0.04, 0.15))
    ripple = {"cycles": turns, "phase": phase}
    uneven = rng.permutation([1.3, 0.7])
    made: dict[str, dict[str, object]] = {
        "motor_coulomb_friction": {"level": tenth},
        "motor_viscous_friction": {"coefficient": tenth / w},
        "asymmetric_friction": {"level_positive": uneven[0] * tenth, "level_negative": uneven[1] * tenth},
        "stribeck_friction": {
            "level": 0.8 * tenth, "static_extra": 0.8 * tenth, "velocity": float(rng.uniform(0.03, 0.1)),
        },
        "load_friction": {"coefficient": TENTH},
        "breakaway_friction": {"level": 3 * tenth, "distance": float(rng.uniform(0.3, 1.0))},
        "friction_drift": {"level": 2 * tenth, "time_constant": float(rng.uniform(3, 9))},
        "dahl_friction": {"level": tenth, "scale": 0.004},
        "drive_efficiency": {"loss_driving": 0.07, "loss_backdriving": 0.14},
        "link_coulomb_friction": {"level": tenth},
        "link_viscous_friction": {"coefficient": tenth / w},
        "quadratic_drag": {"coefficient": tenth / w**2},
        "payload": {
            "mass": TENTH * robot.bodies[j].mass, "position": [rounded(1.3 * c) for c in robot.bodies[j].com],
        },
        "torque_offset": {"offset": sign * tenth},
        "torque_gain": {"gain": sign * TENTH},
        "motor_inertia": {"scale": TENTH},
        "cogging": {"amplitude": tenth, **ripple},
        "cable_spring": {"stiffness": tenth / moved.reach, "rest": angle},
        "sensor_delay": {"delay": 0.003},
        "current_lag": {"time_constant": 0.003},
        "joint_coupling": {"share": sign * TENTH},
        "backlash": {"gap": 2 * twist},
        "spring_stiffness": {"scale": sign * TENTH},
        "hardening_spring": {"cubic": 0.0 if rigid else tenth / moved.deflection**3},
        "spring_hysteresis": {"level": tenth, "scale": max(0.5 * moved.deflection, 1e-4)},
        "transmission_error": {"amplitude": twist, **ripple},
        "encoder_eccentricity": {"amplitude": twist, "phase": phase, "channel": "theta"},
        "encoder_ripple": {"amplitude": twist, **ripple, "channel": "theta"},
        # outside the catalogue
        "torque_droop": {"loss": TENTH, "reference": t},
        "load_cogging": {"share": TENTH, **ripple},
        "cogging_series": {"amplitude": tenth, "cycles": gear, "phase": phase},
        "heated_drive": {"loss": TENTH, "time_constant": period},
        "dead_command": {"width": tenth},
        "drive_resonance": {"period": 0.015, "damping": float(rng.uniform(0.3, 0.7))},
        "path_friction": {"level": tenth, "cycles": path, "phase": phase},
        "wandering_friction": {"level": tenth, "period": period, "phase": phase},
        "thinning_drag": {"torque": tenth, "velocity": 0.3 * w},
        "one_way_drag": {"coefficient": tenth / w},
        "root_drag": {"coefficient": tenth / np.sqrt(w), "velocity": 0.1 * w},
        "gear_ripple": {"share": TENTH, "cycles": gear, "phase": phase},
        "loaded_drag": {"coefficient": TENTH / w},
        "mesh_error": {"amplitude": twist, "cycles": gear, "phase": phase},
        "one_sided_spring": {"share": TENTH},
        "soft_centre": {"stiffness": 0.0 if rigid else TENTH * k, "width": max(moved.deflection, 1e-5)},
        WOBBLING: {
            "inertia": tenth / moved.acceleration, "damping": 0.05,
            "frequency": float(rng.uniform(1.2, 3.0) if unknown else rng.uniform(4, 15)),
        },
        "bent_hose": {"stiffness": tenth / moved.reach**3, "rest": angle},
        "kinked_hose": {"torque": tenth, "angle": angle, "width": 0.15 * moved.reach},
        "neighbour_pull": {"torque": tenth, "angle": phase},
        "neighbour_drag": {"coefficient": tenth / w},
        "encoder_series": {"amplitude": twist, "phase": phase, "channel": "theta"},
        "position_filter": {"time_constant": 0.002, "channel": "theta"},
        "torque_wander": {"amplitude": tenth, "period": period, "phase": phase},
        "torque_bow": {"share": sign * TENTH, "reference": t},
        "torque_steps": {"step": 3 * tenth},
        "drive_dropouts": {"share": 0.5, "times": times, "length": length},
        "pushes": {"torque": 3 * tenth, "times": times, "length": length},
        "drag_at_speed": {"torque": 3 * tenth, "velocity": 1.2 * w, "width": 0.35 * w},
    }  # fmt: skip
    values = made[effect]
    own = law(effect)
    if own.site == "transmission" and rigid:
        raise ValueError(f"{effect} needs a spring")
    if effect == "dead_command" and unknown and moved.reversing < REVERSING:
        raise ValueError(f"{effect} needs a torque that changes its sign")
    if "side" in own.words:
        n = len(robot.joints)
        if n == 1:
            raise ValueError(f"{effect} takes two joints")
        values["side"] = str(rng.choice(["before"] * (j > 0) + ["after"] * (j < n - 1)))
    if effect in OUTSIDE and own.words.get("channel", ("",))[0] == "tau_t":
        readable = [CURRENT] * (CURRENT in channels) + ["tau_t"] * ("tau_t" in channels and not rigid)
        if not readable:
            raise ValueError(f"{effect} needs a torque that is measured")
        values["channel"] = str(rng.choice(readable))
    return Planted(effect, joint, {n: rounded(v) if isinstance(v, float) else v for n, v in values.items()})


def scaled(planted: Planted, factor: float) -> Planted:
    """The effect, larger by a factor."""
    names = SCALED.get(planted.effect, law(planted.effect).required[:1])
    changed = {name: rounded(factor * planted.value(name)) for name in names}
    return replace(planted, parameters={**planted.parameters, **changed})


def allowed(planted: Planted, robot: Robot) -> float:
    """By how much an effect may grow, at least 0; infinite where nothing holds it."""
    j = robot.index(planted.joint)
    size = abs(planted.value(law(planted.effect).required[0]))
    cap = CAPS.get(planted.effect, np.inf)
    if planted.effect == "payload":
        cap = HEAVIEST * robot.bodies[j].mass
    if planted.effect == "spring_stiffness" and planted.value("scale") < 0:
        cap = -SOFTEST
    if planted.effect in ("sensor_delay", "position_filter"):
        cap = min(cap, LATE * np.sqrt(robot.motor_inertia[j] / robot.kp[j]) * 2 * np.pi)
    return float(cap / size)


def least(planted: Planted, tolerance: dict[str, float]) -> float:
    """By how much an effect has to grow so that no tolerance hides it."""
    if planted.effect not in KNOWN_BY:
        return 0.0
    size = abs(planted.value(law(planted.effect).required[0]))
    return BEYOND_TOLERANCE * tolerance[KNOWN_BY[planted.effect]] / size
