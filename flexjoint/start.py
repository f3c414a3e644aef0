"""Where a simulation begins when nothing else is said: at rest, springs carrying the load."""

from __future__ import annotations

import numpy as np

from flexjoint.equilibrium import equilibrium
from flexjoint.model import FlexibleJointModel, State
from flexjoint.standing import standing


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
    held = equilibrium(model, q)
    state.theta, state.z = held.theta[0, list(model.flexible)], held.z[0]
    return state
