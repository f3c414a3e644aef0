"""A model's masses, springs and dampers alone, linearised at a state: its fastest modes."""

from __future__ import annotations

import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel, State


def linearised(model: FlexibleJointModel, x: State) -> np.ndarray:
    """d(v, dtheta, acc, ddtheta)/d(q, theta, v, dtheta) of masses, springs and dampers at a state."""
    nv, nf = model.nv, model.nf
    mass, stiffness, damping = (np.zeros((nv + nf, nv + nf)) for _ in range(3))
    mass[:nv, :nv] = model.body.mass_matrix(x.q)
    for i, flow in enumerate(model.flows):
        place, drive = flow.joint.idx_v, flow.drive
        k = place if flow.joint.rigid else nv + model.flexible.index(i)
        if i not in model.grouped:
            mass[k, k] += drive.B
            damping[k, k] += drive.D_m
        if flow.joint.rigid:
            continue
        for matrix, number in zip((stiffness, damping), flow.spring_at(x.t), strict=True):
            matrix[np.ix_([place, k], [place, k])] += number * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for group in model.groups:
        places = [
            p if group.rigid else nv + model.flexible.index(i)
            for i, p in zip(group.joints, model.places(group), strict=True)
        ]
        at = np.ix_(places, places)
        mass[at] += np.array(group.inertia, dtype=float)
        damping[at] += np.array(group.matrix([shaft.D_m for shaft in group.shafts]), dtype=float)
    return np.block(
        [
            [np.zeros((nv + nf, nv + nf)), np.eye(nv + nf)],
            [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
        ]
    )
