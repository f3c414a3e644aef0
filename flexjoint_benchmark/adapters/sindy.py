"""PySINDy on the torque that every motor is short of: a sparse sum of a library of terms, by STLSQ.

Each term that is kept and that is one law's is named; terms that are no law of the catalogue are not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pysindy as ps

from flexjoint_benchmark.adapters.joints import Joint, Machine, answered, finding

THRESHOLD = 0.05  # of the torque's RMS: a term that contributes less is left out
SOFT = 0.02  # of the largest speed, over which the sign of a speed is smoothed

Term = tuple[str, str, np.ndarray]  # effect, its parameter, column; without an effect it names nothing


def find(machine: Machine, _folder: Path) -> list[dict[str, Any]]:
    out = []
    for joint in machine.joints:
        out += _sparse(joint.name, _of_motor(joint), joint.short, joint.tau_m, machine)
        if joint.load_from == "torque sensor" and joint.phi is not None and joint.dphi is not None:
            left = joint.load - joint.stiffness * joint.phi - joint.spring_damping * joint.dphi
            terms = [*_of_spring(joint), ("torque_sensor_offset", "offset", np.ones_like(left))]
            out += _sparse(joint.name, terms, left, joint.load, machine)
    return out


def _sparse(
    joint: str, terms: list[Term], left: np.ndarray, torque: np.ndarray, machine: Machine
) -> list[dict[str, Any]]:
    step = machine.independent()
    A = np.stack([term for _, _, term in terms], axis=1)[::step]
    size = np.sqrt(np.mean(A**2, axis=0))
    kept = size > 0
    # columns of size 1, so that the threshold is on what a term contributes
    optimiser = ps.STLSQ(threshold=THRESHOLD * float(np.sqrt(np.mean(torque**2))), alpha=1e-6)
    optimiser.fit(A[:, kept] / size[kept], left[::step, None])
    numbers = np.zeros(len(terms))
    numbers[kept] = np.ravel(optimiser.coef_) / size[kept]
    return [
        finding(effect, joint, float(value), 0.0, name)
        for (effect, name, _), value in zip(terms, numbers, strict=True)
        if value != 0.0 and effect
    ]


def _of_spring(joint: Joint) -> list[Term]:
    assert joint.phi is not None and joint.dphi is not None
    return [
        ("spring_stiffness", "scale", joint.stiffness * joint.phi),
        ("spring_damping", "scale", joint.spring_damping * joint.dphi),
        ("hardening_spring", "cubic", joint.phi**3),
    ]


def _of_motor(joint: Joint) -> list[Term]:
    speed = joint.dtheta
    sign = np.tanh(speed / (SOFT * np.abs(speed).max()))
    terms = [
        ("torque_offset", "offset", -np.ones_like(speed)),
        ("motor_coulomb_friction", "level", sign),
        ("motor_viscous_friction", "coefficient", speed),
        ("motor_inertia", "scale", joint.inertia * joint.ddtheta),
        ("torque_gain", "gain", -joint.tau_m),
        ("load_friction", "coefficient", np.abs(joint.load) * sign),
        ("", "", speed * np.abs(speed)),
        ("", "", np.sin(joint.theta)),
        ("", "", np.cos(joint.theta)),
    ]
    if joint.load_from == "spring":
        terms += _of_spring(joint)
    return terms


if __name__ == "__main__":
    answered("PySINDy (STLSQ)", find)
