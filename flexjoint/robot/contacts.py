"""Where a robot touches the ground: part of its description."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin


@dataclass(frozen=True, kw_only=True)
class GroundContact:
    """One place where a robot touches the ground.

    A sphere of `radius` [m] about the origin of `frame`, a point with radius 0; with `rolls`, a wheel of that
    radius on the named joint, whose axis and origin count instead of the frame's.
    stiffness [N/m] and dissipation [s/m] along the normal, friction coefficient, tangential_stiffness [N/m]
    and tangential_damping [N s/m].
    """

    frame: str
    radius: float = 0.0
    rolls: str | None = None
    stiffness: float = 2e5
    dissipation: float = 2.0
    friction: float = 0.8
    tangential_stiffness: float = 2e5
    tangential_damping: float = 1e3


def joint_axis(model: pin.Model, joint: str) -> np.ndarray | None:
    """(3,) the axis of a revolute joint in its own frame; None of any other joint."""
    index = model.getJointId(joint)
    if model.joints[index].nv != 1:
        return None
    jacobian = pin.computeJointJacobian(model, model.createData(), pin.neutral(model), index)
    axis = np.array(jacobian.reshape(6, model.nv)[3:, model.joints[index].idx_v])
    return None if np.linalg.norm(axis) < 0.5 else np.asarray(np.round(axis, 15))
