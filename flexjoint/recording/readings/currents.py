"""Motor torques from motor currents: tau_motor = current * torque_constant * gear_ratio, at the link.

The constant is that of the motor [N m/A]; the gear makes it a torque at the link
(docs/explained/conventions.md), and a coupling those of several motors torques at their joints.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.recording.messages import refusal
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint, Robot

TORQUES = ("tau_m", "tau_motor")
OTHERWISE = ("theta", "theta_ref", "tau_ff")  # of which a controller's torque is computed


def with_torques(robot: Robot, recording: Recording) -> Recording:
    """The recording with `tau_motor` of every actuated joint that has a current and no torque, and a note;
    the recording itself where there is none.

    Raises RecordingError where the robot file does not say what a current is worth and nothing else tells the
    motor's torque.
    """
    columns, made = dict(recording.columns), []
    for joint in robot.joints:
        if not recording.has("current", joint.name) or any(recording.has(c, joint.name) for c in TORQUES):
            continue
        factor = _factor(robot, recording, joint)
        if factor is not None:
            columns["tau_motor", joint.name] = factor * recording.get("current", joint.name)
            made.append(f"{joint.name} ({factor:.6g} N m/A)")
    if not made:
        return recording
    _join(robot, recording, columns)
    note = f"tau_motor is current times torque_constant times gear_ratio at {', '.join(made)}"
    return replace(recording, columns=columns, notes=(*recording.notes, note))


def _join(robot: Robot, recording: Recording, columns: dict[tuple[str, str], np.ndarray]) -> None:
    """Torques at the joints from those of motors that several joints share, in place."""
    for coupling in robot.couplings:
        names = [robot.joints[i].name for i in coupling.joints]
        made = [n for n in names if not recording.has("tau_motor", n) and ("tau_motor", n) in columns]
        if made and len(made) < len(names):
            other = next(name for name in names if name not in made)
            raise refusal(
                recording.name,
                f"the motors of {', '.join(names)} are coupled, and {other} has no current beside that of"
                f" {made[0]};"
                " record all of them, or tau_motor at the joints",
            )
        if made:
            motors = np.array([columns["tau_motor", name] for name in names])
            for name, torque in zip(names, np.array(coupling.matrix).T @ motors, strict=True):
                columns["tau_motor", name] = torque


def _factor(robot: Robot, recording: Recording, joint: Joint) -> float | None:
    """N m at the link per ampere; None where the current is not needed."""
    if joint.torque_constant is not None and joint.gear_ratio is not None:
        return joint.torque_constant * joint.gear_ratio
    missing = {
        "torque_constant [N m/A at the motor]": joint.torque_constant,
        "gear_ratio [turns of the motor per turn of the joint]": joint.gear_ratio,
    }
    absent = [key for key, value in missing.items() if value is None]
    measured = recording.has("tau_t", joint.name)
    controlled = joint.kp > 0.0 and all(recording.has(channel, joint.name) for channel in OTHERWISE)
    if len(absent) == len(missing) and (measured or controlled):
        return None
    raise refusal(
        recording.name,
        f"current.{joint.name} is the only motor torque of {joint.name}, and {robot.name} has no"
        f" {' and no '.join(absent)} for it; add it under joints.{joint.name}, or record tau_motor [N m]",
    )
