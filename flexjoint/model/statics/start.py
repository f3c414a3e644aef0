"""Where a simulation begins by default: at rest, springs carrying the load."""

from __future__ import annotations

import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.model.statics.standing import standing


def initial_positions(model: FlexibleJointModel) -> np.ndarray:
    """(nq,) neutral, with the positions that the robot file gives under `initial`."""
    q = model.body.neutral.copy()
    body = model.robot.model
    for name, value in model.robot.file.initial.items():
        if body.existJointName(name):
            q[body.joints[body.getJointId(name)].idx_q] = value
    return q


def at_rest(model: FlexibleJointModel, q: np.ndarray) -> State:
    """The state at rest at link positions q (nq,), springs carrying the load; a robot with contacts stands on
    them, its base moved there.

    Raises ModelError when a spring or the contacts cannot carry it.
    """
    if model.ground is not None:
        return standing(model, q).state
    state = model.rest(q)
    rest = equilibrium(model, q)
    state.theta, state.z = rest.theta[0, list(model.flexible)], rest.z[0]
    return state
