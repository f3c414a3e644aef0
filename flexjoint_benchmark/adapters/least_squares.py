"""Least squares on the numbers of every drive, dry friction and offset, each number held by its tolerance.

What it names: a number that moves by more than twice its tolerance, friction and offset above a twentieth of
the torque, all of them above three standard errors. That is how a refit is usually read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from flexjoint_benchmark.adapters.joints import USUAL_TOLERANCE, Joint, Machine, answered, finding

MOVED = 2.0  # tolerances
SURE = 3.0  # standard errors
SHARE = 0.05  # of the torque's RMS
SOFT = 0.02  # of the largest speed, over which the sign of a speed is smoothed


def find(machine: Machine, _folder: Path) -> list[dict[str, Any]]:
    out = []
    for joint in machine.joints:
        out += _of_motor(joint, machine)
        if joint.phi is not None and joint.load_from == "torque sensor":
            out += _of_spring(joint, machine)
    return out


def _of_motor(joint: Joint, machine: Machine) -> list[dict[str, Any]]:
    told = {**USUAL_TOLERANCE, **machine.tolerance}
    sign = np.tanh(joint.dtheta / (SOFT * np.abs(joint.dtheta).max()))
    columns = [
        ("motor_inertia", "scale", joint.inertia * joint.ddtheta, told["inertial"]),
        ("motor_viscous_friction", "coefficient", joint.dtheta, told["damping"] * joint.damping),
        ("motor_coulomb_friction", "level", sign, np.inf),
        ("torque_offset", "offset", -np.ones_like(sign), np.inf),
    ]
    if joint.load_from == "spring":
        assert joint.phi is not None and joint.dphi is not None
        columns += [
            ("spring_stiffness", "scale", joint.stiffness * joint.phi, told["stiffness"]),
            ("spring_damping", "scale", joint.spring_damping * joint.dphi, told["damping"]),
        ]
    return _named(joint.name, columns, joint.short, joint.tau_m, machine)


def _of_spring(joint: Joint, machine: Machine) -> list[dict[str, Any]]:
    assert joint.phi is not None and joint.dphi is not None
    told = {**USUAL_TOLERANCE, **machine.tolerance}
    left = joint.load - joint.stiffness * joint.phi - joint.spring_damping * joint.dphi
    columns = [
        ("spring_stiffness", "scale", joint.stiffness * joint.phi, told["stiffness"]),
        ("spring_damping", "scale", joint.spring_damping * joint.dphi, told["damping"]),
        ("torque_sensor_offset", "offset", np.ones_like(left), np.inf),
    ]
    return _named(joint.name, columns, left, joint.load, machine)


def _named(
    joint: str,
    columns: list[tuple[str, str, np.ndarray, float]],
    left: np.ndarray,
    torque: np.ndarray,
    machine: Machine,
) -> list[dict[str, Any]]:
    step = machine.independent()
    A = np.stack([column for _, _, column, _ in columns], axis=1)[::step]
    y = left[::step]
    held = np.array([prior for *_, prior in columns])
    weight = np.where(np.isfinite(held) & (held > 0), 1.0 / np.where(held > 0, held, 1.0), 0.0)
    plain = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    noise = max(float(plain @ plain) / max(y.size - len(columns), 1), 1e-30)
    normal = A.T @ A / noise + np.diag(weight**2)
    covariance = np.linalg.pinv(normal)
    numbers, errors = covariance @ (A.T @ y) / noise, np.sqrt(np.diag(covariance))
    level = SHARE * float(np.sqrt(np.mean(torque**2)))
    out = []
    for (effect, name, _, prior), value, error in zip(columns, numbers, errors, strict=True):
        least = MOVED * prior if np.isfinite(prior) else level
        if abs(value) > max(least, SURE * error):
            out.append(finding(effect, joint, float(value), float(error), name))
    return out


if __name__ == "__main__":
    answered("least squares on the nominal numbers", find)
