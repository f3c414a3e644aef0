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
        if flow.joint.rigid:
            mass[place, place] += drive.B
            damping[place, place] += drive.D_m
            continue
        k = nv + model.flexible.index(i)
        mass[k, k] = drive.B
        damping[k, k] += drive.D_m
        for matrix, number in zip((stiffness, damping), flow.spring_at(x.t), strict=True):
            matrix[np.ix_([place, k], [place, k])] += number * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.block(
        [
            [np.zeros((nv + nf, nv + nf)), np.eye(nv + nf)],
            [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)],
        ]
    )
