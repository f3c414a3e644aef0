"""Springs that a robot file does not give: those of rigid joints that bend, and commanded ones.

Commanded stiffness and damping are those of variable-impedance actuators. The transmission torque is
K(t) phi + D(t) dphi. Turning K up while the spring is deflected does work on it: its energy K phi^2 / 2
changes by K'(t) phi^2 / 2 per second on top of what its ends do (Vanderborght et al. 2013, section 2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from flexjoint.core.errors import ModelError
from flexjoint.core.ops import Value
from flexjoint.effects import Planned
from flexjoint.robot.robot import Robot

Signal = Callable[[Value], Value]


@dataclass(frozen=True)
class VariableSpring:
    """Stiffness [N m/rad] and damping [N m s/rad] as functions of the time t [s]; without `damping` it stays
    the joint's. On CasADi models t is an expression: write the functions with `flexjoint.core.ops`. What is
    worked out ahead of a motion takes one value: the static law that at t = 0, the estimate of stability that
    at the start."""

    stiffness: Signal
    damping: Signal | None = None


def sprung(robot: Robot, effects: Sequence[Planned]) -> tuple[Robot, tuple[Planned, ...]]:
    """The robot whose rigid joints that bend (`joint_compliance`) have their springs, and the other effects.

    Raises ModelError where such an effect is on a joint that has a stiffness, or sets in later."""
    bent: dict[str, Planned] = {}
    for planned in effects:
        if not planned.effect.for_rigid or planned.joint not in robot.joint_names:
            continue
        if not robot.joint(planned.joint).rigid:
            raise ModelError(f"{planned}: the joint has a stiffness; spring_stiffness makes it softer")
        if planned.since is not None:
            raise ModelError(f"{planned}: a joint bends from the start; leave `since` out")
        if planned.joint in bent:
            raise ModelError(f"{planned} is given twice; keep one entry")
        bent[planned.joint] = planned
    if not bent:
        return robot, tuple(effects)
    joints = tuple(
        replace(joint, drive=bent[joint.name].effect.edit_drive(joint.drive, bent[joint.name].p))
        if joint.name in bent
        else joint
        for joint in robot.joints
    )
    return replace(robot, joints=joints), tuple(e for e in effects if not e.effect.for_rigid)
