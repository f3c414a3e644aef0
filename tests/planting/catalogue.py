"""The catalogue of effects, and what is planted of them.

CATALOGUE and BEYOND give an effect's site, its parameters and their defaults; laws.py says what it does.
OUTSIDE does so for laws that the catalogue of the product does not have; outside.py says what they do.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .robots import Robot


@dataclass(frozen=True)
class Law:
    site: str
    required: tuple[str, ...]
    defaults: dict[str, float | str | None] = field(default_factory=dict)
    common: bool = False  # may have joint None: all joints, or the robot as a whole
    words: dict[str, tuple[str, ...]] = field(default_factory=dict)  # what a parameter that is a word may be
    family: str = ""  # of OUTSIDE: laws of one origin, which are held out together


CATALOGUE: dict[str, Law] = {
    "torque_gain": Law("command", ("gain",)),
    "torque_offset": Law("command", ("offset",)),
    "torque_delay": Law("command", ("delay",), common=True),
    "torque_saturation": Law("command", ("limit",)),
    "cogging": Law("command", ("amplitude", "cycles"), {"phase": 0.0}),
    "motor_inertia": Law("motor", ("scale",)),
    "motor_viscous_friction": Law("motor", ("coefficient",)),
    "motor_coulomb_friction": Law("motor", ("level",)),
    "asymmetric_friction": Law("motor", ("level_positive", "level_negative")),
    "stribeck_friction": Law("motor", ("level", "static_extra", "velocity")),
    "load_friction": Law("motor", ("coefficient",)),
    "friction_drift": Law("motor", ("level", "time_constant")),
    "spring_stiffness": Law("transmission", ("scale",)),
    "spring_damping": Law("transmission", ("scale",)),
    "hardening_spring": Law("transmission", ("cubic",)),
    "backlash": Law("transmission", ("gap",)),
    "spring_hysteresis": Law("transmission", ("level", "scale")),
    "transmission_error": Law("transmission", ("amplitude", "cycles"), {"phase": 0.0}),
    "spring_preload": Law("transmission", ("torque",)),
    "payload": Law("link", ("mass", "position")),
    "base_tilt": Law("link", ("roll", "pitch"), common=True),
    "link_coulomb_friction": Law("link", ("level",)),
    "link_viscous_friction": Law("link", ("coefficient",)),
    "cable_spring": Law("link", ("stiffness", "rest")),
    "end_stop": Law("link", ("position", "stiffness")),
    "link_encoder_offset": Law("sensor", ("offset",)),
    "motor_encoder_offset": Law("sensor", ("offset",)),
    "encoder_eccentricity": Law("sensor", ("amplitude", "channel"), {"phase": 0.0}),
    "torque_sensor_offset": Law("sensor", ("offset",)),
    "torque_sensor_gain": Law("sensor", ("gain",)),
    "sensor_delay": Law("sensor", ("delay",), {"channel": None}, common=True),
}

BEYOND: dict[str, Law] = {
    "breakaway_friction": Law("motor", ("level", "distance")),
    "dahl_friction": Law("motor", ("level", "scale")),
    "drive_efficiency": Law("motor", ("loss_driving", "loss_backdriving")),
    "encoder_ripple": Law(
        "sensor",
        ("amplitude", "cycles"),
        {"phase": 0.0, "channel": "q"},
        words={"channel": ("q", "theta")},
    ),
    "quadratic_drag": Law("link", ("coefficient",)),
    "rough_spot": Law("motor", ("level", "position", "width")),
    "spring_creep": Law("transmission", ("stiffness", "time_constant")),
    "torque_speed_limit": Law("command", ("stall", "drop")),
    "current_lag": Law("command", ("time_constant",)),
    "joint_coupling": Law("command", ("share",), {"side": "before"}, words={"side": ("before", "after")}),
    "periodic_disturbance": Law("link", ("amplitude", "frequency"), {"phase": 0.0}),
}
"""Effects that came later: apart, since the numbers of the study's cases follow the order of CATALOGUE."""

LATER: dict[str, Law] = {
    "coupled_friction": Law(
        "motor", ("level", "coefficient"), {"speed": "sum"}, words={"speed": ("sum", "difference")}
    ),
}
"""Effects that came later still: robots drawn at random draw from CATALOGUE and BEYOND."""

UNDRAWN: dict[str, Law] = {
    "differential_friction": Law(
        "motor", ("level_sum", "coefficient_sum", "level_difference", "coefficient_difference")
    ),
}
"""Effects that no machine of the study draws: what it draws is kept as it was."""

SHARED = ("coupled_friction", "differential_friction")
"""Frictions of shafts that a joint shares with the one before it."""
TWO_JOINTS = ("joint_coupling", *SHARED)
"""Effects that take a joint and one beside it."""

_SIDE = {"side": ("before", "after")}
_POSITION = {"channel": ("q", "theta")}
_TORQUE = {"channel": ("tau_t", "tau_motor")}

OUTSIDE: dict[str, Law] = {
    "torque_droop": Law("motor", ("loss", "reference"), family="drive"),
    "load_cogging": Law("motor", ("share", "cycles"), {"phase": 0.0}, family="drive"),
    "cogging_series": Law("motor", ("amplitude", "cycles"), {"phase": 0.0}, family="drive"),
    "heated_drive": Law("motor", ("loss", "time_constant"), family="drive"),
    "dead_command": Law("motor", ("width",), family="drive"),
    "drive_resonance": Law("command", ("period", "damping"), family="drive"),
    "path_friction": Law("motor", ("level", "cycles"), {"phase": 0.0}, family="friction"),
    "wandering_friction": Law("motor", ("level", "period"), {"phase": 0.0}, family="friction"),
    "thinning_drag": Law("motor", ("torque", "velocity"), family="friction"),
    "one_way_drag": Law("motor", ("coefficient",), family="friction"),
    "root_drag": Law("motor", ("coefficient", "velocity"), family="friction"),
    "gear_ripple": Law("motor", ("share", "cycles"), {"phase": 0.0}, family="gear"),
    "loaded_drag": Law("motor", ("coefficient",), family="gear"),
    "mesh_error": Law("transmission", ("amplitude", "cycles"), {"phase": 0.0}, family="gear"),
    "one_sided_spring": Law("transmission", ("share",), family="gear"),
    "soft_centre": Law("transmission", ("stiffness", "width"), family="gear"),
    "wobbling_mass": Law("link", ("inertia", "frequency", "damping"), family="structure"),
    "bent_hose": Law("link", ("stiffness", "rest"), family="structure"),
    "kinked_hose": Law("link", ("torque", "angle", "width"), family="structure"),
    "neighbour_pull": Law("link", ("torque", "angle", "side"), words=_SIDE, family="structure"),
    "neighbour_drag": Law("link", ("coefficient", "side"), words=_SIDE, family="structure"),
    "encoder_series": Law(
        "sensor", ("amplitude", "channel"), {"phase": 0.0}, words=_POSITION, family="sensing"
    ),
    "position_filter": Law("sensor", ("time_constant", "channel"), words=_POSITION, family="sensing"),
    "torque_wander": Law(
        "sensor", ("amplitude", "period", "channel"), {"phase": 0.0}, words=_TORQUE, family="sensing"
    ),
    "torque_bow": Law("sensor", ("share", "reference", "channel"), words=_TORQUE, family="sensing"),
    "torque_steps": Law("sensor", ("step", "channel"), words=_TORQUE, family="sensing"),
    "drive_dropouts": Law("motor", ("share", "times", "length"), family="fault"),
    "pushes": Law("link", ("torque", "times", "length"), family="fault"),
    "drag_at_speed": Law("motor", ("torque", "velocity", "width"), family="fault"),
}
"""Laws that no effect of the product is, by where they come from; equations in outside.py."""

DRY_MOTOR = (
    "motor_coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "load_friction",
    "friction_drift",
    "breakaway_friction",
    "drive_efficiency",
    "rough_spot",
)
"""Effects that make a motor stick."""

DRY_OUTSIDE = ("path_friction", "wandering_friction")
"""Laws of OUTSIDE that do."""

WITH_STATE = ("spring_hysteresis", "dahl_friction", "breakaway_friction", "spring_creep")
"""Effects with a state of their own; a joint has room for one."""


def law(effect: str) -> Law:
    """The law of an effect; raises ValueError when there is none."""
    every = {**CATALOGUE, **BEYOND, **LATER, **UNDRAWN, **OUTSIDE}
    found = every.get(effect)
    if found is None:
        known = ", ".join(every)
        raise ValueError(f"unknown effect {effect!r}; there are {known}")
    return found


@dataclass(frozen=True)
class Planted:
    """One effect put into the real machine; `since` [s] switches it on during the recording. A payload may be
    put down, picked again and so on at `switches` [s]."""

    effect: str
    joint: str | None
    parameters: dict[str, object]
    since: float | None = None
    switches: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.switches and self.effect != "payload":
            raise ValueError(f"{self.effect} cannot be switched off during a recording; payload can")
        own = law(self.effect)
        given, valid = set(self.parameters), {*own.required, *own.defaults}
        if not set(own.required) <= given or not given <= valid:
            raise ValueError(
                f"{self.effect} takes {sorted(valid)} (needs {own.required}), got {sorted(given)}"
            )
        if self.joint is None and not own.common:
            raise ValueError(f"{self.effect} belongs to a joint; name it")
        for name, words in own.words.items():
            if self.word(name) not in words:
                raise ValueError(
                    f"{self.effect}: {name} is one of {', '.join(words)}, got {self.word(name)!r}"
                )

    @property
    def start(self) -> float:
        """`since`, or before all time."""
        return -np.inf if self.since is None else self.since

    def acts(self, times: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
        """Whether it is switched on at times [s]."""
        changes = np.array([self.start, *self.switches])
        return np.sum(times[..., None] >= changes - 1e-9, axis=-1) % 2 == 1

    def value(self, name: str) -> float:
        return float({**law(self.effect).defaults, **self.parameters}[name])  # type: ignore[arg-type]

    def several(self, name: str) -> tuple[float, ...]:
        """A parameter that is a list of numbers."""
        return tuple(float(x) for x in self.parameters[name])  # type: ignore[attr-defined]

    def word(self, name: str) -> str | None:
        return {**law(self.effect).defaults, **self.parameters}[name]  # type: ignore[return-value]


def check(robot: Robot, effects: list[Planted]) -> None:
    """Raises ValueError for a joint that the robot lacks, an effect planted twice on a joint, two of
    WITH_STATE on one, a coupling to a joint that is not there, or a spring's effect on a rigid joint."""
    seen = set()
    for planted in effects:
        if planted.joint is not None:
            rigid = np.isinf(robot.stiffness[robot.index(planted.joint)])
            if rigid and law(planted.effect).site == "transmission":
                raise ValueError(f"{planted.effect} needs a spring, and {planted.joint} is rigid")
        if (planted.effect, planted.joint) in seen:
            raise ValueError(f"{planted.effect} is planted twice on {planted.joint}")
        seen.add((planted.effect, planted.joint))
        if "side" in law(planted.effect).words or planted.effect in SHARED:
            neighbour(robot, planted)
    for joint in robot.joints:
        several = [p.effect for p in effects if p.effect in WITH_STATE and p.joint == joint]
        if len(several) > 1:
            raise ValueError(f"{joint} has room for one state, not for {' and '.join(several)}")


def neighbour(robot: Robot, coupling: Planted) -> int:
    """Index of the joint on the `side` of an effect's own, of a shared friction the one before; raises
    ValueError where there is none."""
    side = "before" if coupling.effect in SHARED else coupling.word("side")
    index = robot.index(coupling.joint) + (-1 if side == "before" else 1)
    if not 0 <= index < len(robot.joints):
        raise ValueError(f"{coupling.effect}: {robot.name} has no joint {side} {coupling.joint}")
    return index
