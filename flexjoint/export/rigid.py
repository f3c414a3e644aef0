"""What descriptions with rigid joints have in common: which effects they have no word for, and why."""

from __future__ import annotations

from collections.abc import Mapping

from flexjoint.effects import Planned
from flexjoint.export.base import Target, Way, absent
from flexjoint.robot.robot import Robot

UNVERIFIED = "not verified in that simulator"
STALL = "of its stall torque, which does not fall with speed"


def _all(names: str, why: str) -> dict[str, Way]:
    return dict.fromkeys(names.split(), absent(why))


SPRINGS: Mapping[str, Way] = _all(
    "backlash hardening_spring learned_deflection learned_link_torque spring_creep spring_damping"
    " spring_hysteresis spring_preload spring_stiffness"
    " transmission_error",
    "joints are rigid there",
)
SENSORS: Mapping[str, Way] = _all(
    "encoder_eccentricity encoder_ripple link_encoder_offset motor_encoder_offset sensor_delay"
    " torque_sensor_gain torque_sensor_offset",
    "sensors are not in that file; add it to what you read",
)
COMMANDS: Mapping[str, Way] = _all(
    "cogging current_lag joint_coupling magnetic_saturation torque_delay torque_gain torque_offset",
    "how a command becomes a torque is not in that file; add it to your command",
)
LIMITS: Mapping[str, Way] = _all("torque_saturation torque_speed_limit", "limits are not in that file")
FRICTION: Mapping[str, Way] = _all(
    "asymmetric_friction breakaway_friction coupled_friction dahl_friction differential_friction"
    " drive_efficiency friction_drift link_coulomb_friction link_viscous_friction load_friction"
    " motor_coulomb_friction motor_viscous_friction rough_spot stribeck_friction",
    "no such friction there",
)
FORCES: Mapping[str, Way] = _all(
    "cable_spring end_stop learned_surface learned_torque periodic_disturbance quadratic_drag",
    "no such force there",
)
BODIES: Mapping[str, Way] = _all(
    "base_tilt motor_inertia payload rotor_inertia", "bodies and gravity are not in that file"
)

NOTHING: Mapping[str, Way] = {  # one that carries no effect at all
    **SPRINGS, **SENSORS, **COMMANDS, **LIMITS, **FRICTION, **FORCES, **BODIES
}  # fmt: skip


class Mounted(Target):
    """A target whose gravity is the world's, in which the base is mounted."""

    def judge(self, robot: Robot, planned: Planned) -> Way:
        if robot.floating and planned.effect.name == "base_tilt":
            return absent("the base floats; turn the world's gravity")
        return super().judge(robot, planned)
