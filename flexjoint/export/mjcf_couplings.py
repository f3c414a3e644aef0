"""Motors that several joints share, in MuJoCo: a fixed tendon whose length is the motor's position.

With m = N theta, the tendon of a motor has its row of N as coefficients, and carries the motor's inertia,
damping and friction: B n n', D_m n n' and n f(n' dtheta) at the joints, as the model has them
(`flexjoint.model.shafts`). MuJoCo keeps inertia between joints of one branch of bodies only (its mass matrix
is sparse by branches): so rotors of coupled joints are hinges of one branch, and coupled rigid joints have to
be on one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.couplings import Coupling
from flexjoint.robot.robot import Robot

VERSION = "MuJoCo 3.3.1 or newer"


@dataclass(frozen=True)
class SharedMotors:
    """The couplings of a robot that an MJCF carries."""

    robot: Robot

    @property
    def couplings(self) -> tuple[Coupling, ...]:
        return tuple(coupling for coupling in self.robot.couplings if self._carried(coupling))

    def _carried(self, coupling: Coupling) -> bool:
        joints = [self.robot.joints[i] for i in coupling.joints]
        return not joints[0].rigid or _on_one_branch(self.robot.model, [joint.pin_id for joint in joints])

    @property
    def all_carried(self) -> bool:
        return len(self.couplings) == len(self.robot.couplings)

    def of(self, joint: str) -> Coupling | None:
        """The coupling that a joint's motor belongs to."""
        place = self.robot.joint_names.index(joint)
        return next((coupling for coupling in self.couplings if place in coupling.joints), None)

    def names(self, coupling: Coupling) -> list[str]:
        return [self.robot.joint_names[i] for i in coupling.joints]

    def turns(self, joint: str) -> dict[str, float]:
        """By how much the motor of a joint turns for a turn of each joint, where that is not 0."""
        coupling = self.of(joint)
        if coupling is None:
            return {joint: 1.0}
        names = self.names(coupling)
        row = coupling.matrix[names.index(joint)]
        return {name: share for name, share in zip(names, row, strict=True) if share != 0.0}

    def pulls(self, joint: str, gains: dict[str, float]) -> dict[str, float]:
        """Torques at the joints under a command of 1 at one of them: N' G N'^-1, with gains G of motors."""
        coupling = self.of(joint)
        if coupling is None:
            return {joint: gains[joint]}
        names = self.names(coupling)
        N = np.array(coupling.matrix)
        column = (N.T @ np.diag([gains[name] for name in names]) @ coupling.inverse.T)[:, names.index(joint)]
        # the product of a matrix and its inverse leaves rounding where there is nothing
        return {name: float(share) for name, share in zip(names, column, strict=True) if abs(share) > 1e-12}


def _on_one_branch(model: pin.Model, joints: list[int]) -> bool:
    """Whether the bodies on some joints lie above one another, each below the next."""
    deepest = max(joints, key=lambda k: len(model.supports[k]))
    return set(joints) <= set(model.supports[deepest].tolist())


def mobility(model: FlexibleJointModel, joint: int) -> float:
    """Acceleration of a rotor under a torque of 1 at its joint, links aside [1/(kg m^2)]."""
    for group in model.groups:
        if joint in group.joints:
            place = group.joints.index(joint)
            return float(np.linalg.inv(np.array(group.inertia, dtype=float))[place, place])
    return 1.0 / float(model.flows[joint].drive.B)
