"""How far, how fast and how hard a planned motion may go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.limits import PLANNING
from flexjoint.core.units import of_joint
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

UNLIMITED = 1e6  # a limit of the URDF from which there is none


@dataclass(frozen=True)
class Limits:
    """Of every actuated joint (n,): position [rad] and where its motion is centred, speed [rad/s], motor
    torque [N m] (infinite: none is known); and the duration [s]."""

    low: np.ndarray
    high: np.ndarray
    centre: np.ndarray
    speed: np.ndarray
    torque: np.ndarray
    seconds: float

    def slower(self, joints: np.ndarray, factor: float) -> Limits:
        """The same with less room, speed and torque for some joints (n,) bool, for a reference that keeps to
        the old ones in simulation."""
        room = np.where(joints, factor, 1.0)
        return replace(
            self,
            low=self.centre - room * (self.centre - self.low),
            high=self.centre + room * (self.high - self.centre),
            speed=room * self.speed,
            torque=room * self.torque,
        )


def limits_of(
    robot: Robot,
    seconds: float = USUAL.plan.seconds,
    reach: float = USUAL.plan.reach,
    speed: float | None = None,
) -> Limits:
    """Limits of the robot's URDF and YAML, narrowed to `reach` [rad] about the centre and to `speed` [rad/s].

    The centre is the robot file's `initial` position, else 0, else the middle of the joint's range.

    Raises FlexJointError: a duration below 4 s, a reach or speed that is not positive, a centre outside the
    joint's range.
    """
    if not 4.0 <= seconds <= 600.0:
        raise FlexJointError(f"seconds must be from 4 to 600, got {seconds:g}")
    for name, value in (("reach", reach), ("speed", speed)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise FlexJointError(f"{name} must be a positive number, got {value:g}")
        if value is not None and not PLANNING.least <= value <= PLANNING.most:
            raise FlexJointError(
                f"{name} must be from {PLANNING.least:g} to {PLANNING.most:g}, got {value:g}; give rad, rad/s"
            )
    rows = []
    for joint in robot.joints:
        low, high = (float(limit[joint.idx_q]) for limit in _positions(robot))
        named = robot.file.initial.get(joint.name)
        centre = named if named is not None else 0.0 if low < 0.0 < high else 0.5 * (low + high)
        if not low <= centre <= high:
            unit = of_joint("rad", joint.name in robot.prismatic)
            raise FlexJointError(
                f"initial position {centre:g} {unit} of joint {joint.name} lies outside its range {low:g} to"
                f" {high:g}; change one of them"
            )
        fastest = float(robot.model.velocityLimit[joint.idx_v])
        fastest = fastest if 0.0 < fastest < UNLIMITED else USUAL.plan.speed
        rows.append(
            (
                max(low, centre - reach),
                min(high, centre + reach),
                centre,
                fastest if speed is None else min(fastest, speed),
                joint.torque_limit,
            )
        )
    low, high, centre, speeds, torque = np.array(rows).T
    return Limits(low, high, centre, speeds, torque, seconds)


def _positions(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """The URDF's range of every position, infinite where it has none."""
    low, high = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    given = np.isfinite(low) & np.isfinite(high) & (low < high) & (np.abs(high) < UNLIMITED)
    return np.where(given, low, -np.inf), np.where(given, high, np.inf)


def exceeded(robot: Robot, limits: Limits, true: Recording) -> dict[str, str]:
    """What a simulated motion exceeds, by joint; empty when it keeps to the limits. The command has to stay
    below the torque limit, where it is clipped."""
    found: dict[str, str] = {}
    sliding = robot.prismatic
    for i, joint in enumerate(robot.joints):
        q, dq = true.get("q", joint.name), true.get("dq", joint.name)
        unit = partial(of_joint, prismatic=joint.name in sliding)
        torque = float(np.max(np.abs(true.get("tau_m", joint.name))))
        if q.min() < limits.low[i] or q.max() > limits.high[i]:
            found[joint.name] = f"position {q.min():.3g} to {q.max():.3g} {unit('rad')}"
        elif np.max(np.abs(dq)) > limits.speed[i]:
            found[joint.name] = f"speed {np.max(np.abs(dq)):.3g} {unit('rad/s')}"
        elif torque >= limits.torque[i]:
            found[joint.name] = f"torque {torque:.3g} {unit('N m')}"
    return found
