"""Sizes of effects as a robot may have them, and the motion that shows them."""

from __future__ import annotations

from functools import cache

import numpy as np

from .catalogue import BEYOND, LATER, Planted
from .robots import Robot, read_robot, robot_file

SLOW_EFFECTS = (
    "stribeck_friction",
    "torque_offset",
    "cogging",
    "transmission_error",
    "cable_spring",
    "breakaway_friction",
    "encoder_ripple",
)
STEP_EFFECTS = ("torque_saturation", "end_stop")
MET_EFFECTS = (*STEP_EFFECTS, "torque_speed_limit", "rough_spot")
"""Effects that depend on the trajectory: planted by cases.met_by."""


@cache
def nominal(robot: str) -> Robot:
    return read_robot(robot_file(robot))


def rounded(value: float) -> float:
    return float(f"{value:.3g}")


def usual_excitation(effect: str) -> str:
    return "steps" if effect in STEP_EFFECTS else "slow" if effect in SLOW_EFFECTS else "rich"


def usual_effect(
    effect: str,
    robot: str,
    joint: str,
    rng: np.random.Generator,
    size: float = 1.0,
    since: float | None = None,
) -> Planted:
    """An effect of the usual size for a joint, varied by 20 % and times `size`; signs are drawn where both
    exist.

    MET_EFFECTS depend on the trajectory and are sized by `single_case`. Raises ValueError for them and for
    unknown names.
    """
    r = nominal(robot)
    j = r.index(joint)
    limit, stiffness, viscous = r.torque_limit[j], r.stiffness[j], r.motor_damping[j]
    s = size * rng.uniform(0.8, 1.2)
    sign = rng.choice([-1.0, 1.0])
    load = 0.25 * limit  # a usual spring torque
    reach = r.bodies[j].com
    phase = rng.uniform(-3, 3)
    parameters: dict[str, dict[str, float]] = {
        "torque_gain": {"gain": 0.1 * s * sign},
        "torque_offset": {"offset": 0.03 * limit * s * sign},
        "torque_delay": {"delay": 0.0045 * s},
        "cogging": {"amplitude": 0.018 * limit * s, "cycles": float(rng.integers(10, 24)), "phase": phase},
        "motor_inertia": {"scale": 0.3 * s},
        "motor_viscous_friction": {"coefficient": 0.45 * viscous * s},
        "motor_coulomb_friction": {"level": 0.035 * limit * s},
        "asymmetric_friction": {"level_positive": 0.05 * limit * s, "level_negative": 0.025 * limit * s},
        "stribeck_friction": {"level": 0.03 * limit * s, "static_extra": 0.03 * limit * s, "velocity": 0.06},
        "load_friction": {"coefficient": 0.13 * s},
        "friction_drift": {"level": 0.06 * limit * s, "time_constant": rng.uniform(5, 9)},
        "spring_stiffness": {"scale": 0.25 * s * sign},
        "spring_damping": {"scale": 1.5 * s},
        "hardening_spring": {"cubic": 0.5 * s * stiffness**3 / load**2},
        "backlash": {"gap": 0.009 * s},
        "spring_hysteresis": {"level": 0.025 * limit * s, "scale": 0.0035},
        "transmission_error": {"amplitude": 0.002 * s, "cycles": float(rng.integers(12, 24)), "phase": phase},
        "spring_preload": {"torque": 0.03 * limit * s * sign},
        "base_tilt": {"roll": 0.06 * s * sign, "pitch": 0.05 * s},
        "link_coulomb_friction": {"level": 0.018 * limit * s},
        "link_viscous_friction": {"coefficient": 0.25 * viscous * s},
        "cable_spring": {"stiffness": 0.012 * stiffness * s, "rest": rng.uniform(-0.3, 0.3)},
        "link_encoder_offset": {"offset": 0.015 * s * sign},
        "motor_encoder_offset": {"offset": 0.015 * s * sign},
        "torque_sensor_offset": {"offset": 0.03 * limit * s * sign},
        "torque_sensor_gain": {"gain": 0.1 * s * sign},
        "sensor_delay": {"delay": 0.005 * s},
        "encoder_eccentricity": {"amplitude": 0.008 * s, "phase": phase},
    }
    if effect == "payload":
        place = [rounded(1.3 * c) for c in reach]
        return Planted(effect, joint, {"mass": rounded(0.3 * r.bodies[j].mass * s), "position": place}, since)
    if effect in (*BEYOND, *LATER) and effect not in MET_EFFECTS:
        return _beyond(effect, r, joint, s, sign, phase, rng, since)
    if effect not in parameters:
        known = (*parameters, "payload", *(name for name in (*BEYOND, *LATER) if name not in MET_EFFECTS))
        raise ValueError(f"no usual size for {effect!r}; there is one for {', '.join(known)}")
    values: dict[str, object] = {name: rounded(value) for name, value in parameters[effect].items()}
    if effect == "encoder_eccentricity":
        values["channel"] = str(rng.choice(["q", "theta"]))
    if effect == "sensor_delay" and (
        channel := rng.choice(["", "q", "theta"])
    ):  # none: all sensors of the joint
        values["channel"] = str(channel)
    if effect == "base_tilt":  # only a tilt about horizontal directions across the joint axes can be seen
        hidden = {"lever": "roll", "crane": "pitch"}.get(robot.removesuffix("_exact"))
        if robot.startswith("drawn_") and all(body.axis[1] for body in r.bodies):
            hidden = "roll"
        values = {name: 0.0 if name == hidden else value for name, value in values.items()}
        return Planted(effect, None, values, since)
    return Planted(effect, joint, values, since)


def _beyond(
    effect: str,
    robot: Robot,
    joint: str,
    s: float,
    sign: float,
    phase: float,
    rng: np.random.Generator,
    since: float | None,
) -> Planted:
    """The same for BEYOND; `s` is the size varied. What it draws, no other effect does."""
    j = robot.index(joint)
    limit = robot.torque_limit[j]
    words: dict[str, str] = {}
    parameters: dict[str, float]
    if effect == "breakaway_friction":
        parameters = {"level": 0.06 * limit * s, "distance": 0.3}
    elif effect == "dahl_friction":
        parameters = {"level": 0.035 * limit * s, "scale": 0.004}
    elif effect == "drive_efficiency":
        parameters = {"loss_driving": 0.1 * s, "loss_backdriving": 0.2 * s}
    elif effect == "encoder_ripple":
        parameters = {"amplitude": 0.002 * s, "cycles": float(rng.integers(12, 30)), "phase": phase}
        words = {"channel": str(rng.choice(["q", "theta"]))}
    elif effect == "quadratic_drag":
        parameters = {"coefficient": 0.02 * limit * s}  # N m at 1 rad/s
    elif effect == "spring_creep":
        parameters = {"stiffness": 0.15 * robot.stiffness[j] * s, "time_constant": rng.uniform(0.5, 3)}
    elif effect == "current_lag":
        parameters = {"time_constant": 0.008 * s}
    elif effect == "joint_coupling":
        parameters = {"share": 0.08 * s * sign}
        words = {"side": str(rng.choice(_sides(robot, joint)))}
    elif effect == "coupled_friction":
        _sides(robot, joint)
        parameters = {"level": 0.035 * limit * s, "coefficient": 0.2 * robot.motor_damping[j] * s}
        words = {"speed": str(rng.choice(["sum", "difference"]))}
    else:
        assert effect == "periodic_disturbance", effect
        parameters = {"amplitude": 0.025 * limit * s, "frequency": rng.uniform(2, 12), "phase": phase}
    return Planted(effect, joint, {**{k: rounded(v) for k, v in parameters.items()}, **words}, since)


def _sides(robot: Robot, joint: str) -> list[str]:
    """Sides on which a joint has a neighbour; raises ValueError where it has none."""
    if len(robot.joints) == 1:
        raise ValueError(f"{robot.name} has one joint, and no other to couple it with")
    return ["before"] * (joint != robot.joints[0]) + ["after"] * (joint != robot.joints[-1])
