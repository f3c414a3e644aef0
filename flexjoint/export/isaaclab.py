"""Isaac Lab: the actuators of an articulation, as a Python file; bodies come from a URDF or USD."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import ClassVar

from flexjoint.export.base import Row, Target, Way, absent, near
from flexjoint.export.rigid import NOTHING, STALL, UNVERIFIED
from flexjoint.export.subject import Subject
from flexjoint.export.urdf import heading

BODIES = absent("bodies are not in that file; export them to urdf")
VISCOUS = near(f"viscous_friction, from Isaac Sim 5 on; {UNVERIFIED}")
DRY = near(f"friction and dynamic_friction, efforts from Isaac Sim 5 on; {UNVERIFIED}")


class IsaacLab(Target):
    name = "isaaclab"
    title = "Isaac Lab"
    suffixes = (".py",)
    numbers: ClassVar[Mapping[str, Way]] = {
        "motor_inertia": near(f"armature; {UNVERIFIED}"),
        "motor_damping": VISCOUS,
        "torque_limit": near(f"effort_limit and effort_limit_sim; {UNVERIFIED}"),
        "controller": near(f"stiffness and damping of the actuator: kp and kd; {UNVERIFIED}"),
        "sensing_delay": absent("commands alone are delayed there"),
        "gravity": absent("it belongs to the scene"),
        "contacts": BODIES,
        "couplings": absent("each motor turns one joint there"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        **NOTHING,
        "asymmetric_friction": near(f"friction of the mean level; {UNVERIFIED}"),
        "base_tilt": absent("it belongs to the scene: turn the robot's init_state"),
        "link_coulomb_friction": DRY,
        "link_viscous_friction": VISCOUS,
        "motor_coulomb_friction": DRY,
        "motor_inertia": near(f"armature; {UNVERIFIED}"),
        "motor_viscous_friction": VISCOUS,
        "payload": BODIES,
        "rotor_inertia": near(f"armature; {UNVERIFIED}"),
        "stribeck_friction": near(f"friction at rest, dynamic_friction its level; {UNVERIFIED}"),
        "torque_delay": near(f"min_delay, max_delay of a DelayedPDActuatorCfg, whole steps; {UNVERIFIED}"),
        "torque_saturation": near(f"effort_limit; {UNVERIFIED}"),
        "torque_speed_limit": near(f"effort_limit {STALL}; {UNVERIFIED}"),
    }

    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        lines = heading(subject.robot, self.title, account)
        return "\n".join([*(f"# {line}" for line in lines), *_config(subject)]) + "\n"


def _config(subject: Subject) -> Iterator[str]:
    robot = subject.robot
    late = {joint.name: round(subject.number("torque_delay", joint.name, "delay") * robot.rates.physics)
            for joint in robot.joints}  # fmt: skip
    yield "from isaaclab.actuators import DelayedPDActuatorCfg, ImplicitActuatorCfg"
    yield ""
    yield "# names of Isaac Lab 2, which 3 takes as well; friction is in N m from Isaac Sim 5 on"
    rate = robot.rates.physics
    yield f"# delays count steps of 1/{rate:g} s: set SimulationCfg(dt=1.0 / {rate:g})"
    yield "ACTUATORS = {"
    for joint in robot.joints:
        name, delay = joint.name, late[joint.name]
        level = subject.dry(name)
        static = level + subject.number("stribeck_friction", name, "static_extra")
        most = subject.most_torque(name)
        yield f"    {name!r}: {'DelayedPDActuatorCfg' if delay else 'ImplicitActuatorCfg'}("
        yield f"        joint_names_expr=[{re.escape(name)!r}],"
        yield f"        stiffness={joint.kp!r},  # kp of the robot file"
        yield f"        damping={joint.kd!r},  # kd of the robot file"
        if most < math.inf:
            yield f"        effort_limit={most!r},"
            yield f"        effort_limit_sim={most!r},"
        yield f"        armature={float(subject.drive(name).B)!r},"
        yield f"        friction={static!r},"
        yield f"        dynamic_friction={level!r},"
        yield f"        viscous_friction={max(subject.viscous(name), 0.0)!r},"
        if delay:
            yield f"        min_delay={delay},"
            yield f"        max_delay={delay},"
        yield "    ),"
    yield "}"
