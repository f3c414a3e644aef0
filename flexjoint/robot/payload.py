"""A payload that is known: part of the nominal model of one recording, and no cause.

A known load in one of several recordings separates causes that look alike in one recording: it adds torques
of a known size, which a gain of the motor's torque scales and an error of a link's mass does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError, unknown
from flexjoint.core.limits import DESCRIPTION
from flexjoint.rigidbody.numeric import inertial_of
from flexjoint.robot.robot import Robot

FORM = "REC:JOINT=MASS,X,Y,Z[,IXX,IXY,IYY,IXZ,IYZ,IZZ]"


@dataclass(frozen=True)
class KnownPayload:
    """A body fixed to a joint's link.

    Args:
        joint: an actuated joint of the robot.
        mass: > 0 [kg].
        position: (3,) of its centre of mass in the joint's link frame [m].
        inertia: (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about its centre of mass, axes of the link frame [kg m^2]; a
            point mass as the default.

    Raises:
        RobotError: a mass that is not positive, numbers that are not finite, an inertia that no body has.
    """

    joint: str
    mass: float
    position: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float] = (0.0,) * 6

    def __post_init__(self) -> None:
        where = f"known payload on {self.joint}"
        if len(self.position) != 3 or len(self.inertia) != 6:
            raise RobotError(
                f"{where}: expected a position of 3 and an inertia of 6 numbers, got {len(self.position)}"
                f" and {len(self.inertia)}"
            )
        if not all(map(math.isfinite, (self.mass, *self.position, *self.inertia))):
            raise RobotError(f"{where}: expected finite numbers, got {self}")
        if max(map(abs, (self.mass, *self.position, *self.inertia))) > DESCRIPTION.number:
            raise RobotError(f"{where}: expected numbers up to {DESCRIPTION.number:g}, got {self}")
        if self.mass <= 0.0:
            raise RobotError(f"{where}: expected a mass above 0 kg, got {self.mass:g}; give what was added")
        if np.min(np.linalg.eigvalsh(self._rotational())) < -1e-12:
            raise RobotError(
                f"{where}: inertia {self.inertia} has a negative principal moment; give it about the centre"
                " of mass as Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg m^2]"
            )

    def _rotational(self) -> np.ndarray:
        xx, xy, yy, xz, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def on(self, robot: Robot) -> Robot:
        """The robot as it carries the payload. The tolerances stay those of its own links.

        Raises UnknownNameError for a joint that the robot does not actuate.
        """
        if self.joint not in robot.joint_names:
            raise unknown("joint of a known payload", self.joint, robot.joint_names)
        model = robot.model.copy()
        body = pin.Inertia(self.mass, np.array(self.position), self._rotational())
        model.appendBodyToJoint(robot.joint(self.joint).pin_id, body, pin.SE3.Identity())
        own = inertial_of(robot.model) if robot.own_inertial is None else robot.own_inertial
        return replace(robot, model=model, own_inertial=own)

    def __str__(self) -> str:
        return f"{self.mass:g} kg on {self.joint}"


def parse(entries: Sequence[str], recordings: Sequence[str]) -> list[KnownPayload | None]:
    """The payload of each recording (None: none) from texts `REC:JOINT=MASS,X,Y,Z[,inertia]`, where REC is
    one of `recordings`.

    Raises RobotError for a text of another form, UnknownNameError for another recording.
    """
    out: list[KnownPayload | None] = [None] * len(recordings)
    for entry in entries:
        place, equals, numbers = entry.rpartition("=")
        recording, colon, joint = place.rpartition(":")
        if not (equals and colon and joint):
            raise RobotError(f"known payload {entry!r}: expected {FORM}")
        if recording not in recordings:
            raise unknown("recording of a known payload", recording, recordings)
        try:
            mass, x, y, z, *inertia = (float(number) for number in numbers.split(","))
        except ValueError:
            raise RobotError(f"known payload {entry!r}: expected numbers as {FORM}") from None
        if len(inertia) not in (0, 6):
            raise RobotError(f"known payload {entry!r}: expected 4 or 10 numbers as {FORM}")
        xx, xy, yy, xz, yz, zz = inertia or [0.0] * 6
        k = recordings.index(recording)
        if out[k] is not None:
            raise RobotError(f"known payload {entry!r}: {recording} has one already; give their sum")
        out[k] = KnownPayload(joint, mass, (x, y, z), (xx, xy, yy, xz, yz, zz))
    return out
