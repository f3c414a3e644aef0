"""Nominal numbers that a robot's tolerances leave open, as parameters of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.nuisance import NominalNumber, inertial_directions, tolerance_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned
from flexjoint.model.parameters import labels, model_parameters
from flexjoint.robot.robot import Robot


def open_numbers(robot: Robot, problem: Problem, offsets: Sequence[Planned]) -> list[NominalNumber]:
    """The nominal numbers with a tolerance, as `nuisance.Columns` has them, by the names of the simulation's
    parameters; links' inertial parameters as directions."""
    drives = model_parameters(robot, (), free=("drives",)).values()
    out = [NominalNumber(p.name, std=p.std) for p in drives if p.std is not None and 0.0 < p.std < np.inf]
    out += _inertial_numbers(robot, problem)
    for e in robot.effects:
        spread = tolerance_of(e, robot)
        for param in e.effect.nulls:
            value = e.values.get(param.name)
            if param.size == 1 and value and np.isfinite(value) and spread > 0.0:
                out.append(NominalNumber(labels(e, param.name, 1)[0], std=abs(value) * spread))
    free = problem.settings.regression.offset_deviation
    return out + [NominalNumber(labels(e, "offset", 1)[0], std=free) for e in offsets]


def _inertial_numbers(robot: Robot, problem: Problem) -> list[NominalNumber]:
    """The links' inertial parameters within their tolerance: as many directions as the recording shows at
    all. Their prior is the same in all directions, so that any rotation of them will do."""
    tolerance, other = robot.tolerance.inertial, problem.settings.regression.other_component
    places = [k for k, number in enumerate(problem.nuisance) if number.name == "inertial"]
    if not places:
        return []
    joints = [i for i, row in enumerate(problem.motion.rigid.inertial) if row[0] > 0.0]
    change = np.zeros((len(places), 10 * len(robot.joints)))
    for at, i in enumerate(joints):
        directions = inertial_directions(problem.motion.rigid.inertial[i], tolerance, other)
        change[10 * at : 10 * at + 10, 10 * i : 10 * i + 10] = directions
    energy, axes = np.linalg.eigh(problem.bare_gram[np.ix_(places, places)])
    seen = np.flatnonzero(energy > problem.settings.refinement.visible)
    return [NominalNumber("inertial", direction=tuple(axes[:, k] @ change)) for k in seen[::-1]]
