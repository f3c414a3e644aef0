"""What the adapters share: a case's signals, filtered alike, and the torque that each motor is short of."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import yaml
from scipy.signal import butter, filtfilt

from flexjoint_benchmark import SCHEMA
from flexjoint_benchmark.folder import cases
from flexjoint_benchmark.planting.robots import Robot, read_robot
from flexjoint_benchmark.planting.simulate import nominal_dynamics

CUTOFF = 20.0  # Hz, of the low-pass that all signals go through, unless an adapter asks for another
EDGE = 0.5  # s at both ends, where the filter has not settled

Array = np.ndarray


@dataclass(frozen=True)
class Joint:
    """One joint's filtered signals (N,), and what its motor needs beyond what its nominal numbers explain.

    `short` is tau_m - B ddtheta - D_m dtheta - load. `load` is measured, of the spring (K phi + D dphi) or of
    the rigid body, as `load_from` says.
    """

    name: str
    theta: Array
    dtheta: Array
    ddtheta: Array
    phi: Array | None
    dphi: Array | None
    tau_m: Array
    load: Array
    load_from: str  # torque sensor | spring | rigid body
    short: Array
    inertia: float
    damping: float
    stiffness: float
    spring_damping: float


@dataclass(frozen=True)
class Machine:
    robot: Robot
    tolerance: dict[str, float]
    rate: float  # Hz
    joints: tuple[Joint, ...]

    def independent(self) -> int:
        """Every so many samples are independent after the filter."""
        return max(1, round(self.rate / (2 * CUTOFF)))


def read(folder: Path, entry: dict[str, Any], cutoff: float = CUTOFF) -> Machine:
    """A case's joints; those without a motor torque or a position are left out."""
    path = folder / entry["robot"]
    data = yaml.safe_load(path.read_text())
    robot = read_robot(path)
    table = pyarrow.parquet.read_table(folder / entry["recording"])
    told = {
        name: np.asarray(table[name].to_numpy(zero_copy_only=False), float) for name in table.column_names
    }
    period = float(np.median(np.diff(told["time"])))
    clock = np.arange(told["time"][0], told["time"][-1], period)
    low = butter(4, min(0.9, 2 * cutoff * period))

    def smooth(channel: str, joint: str, held: float = 0.0) -> Array | None:
        values = told.get(f"{channel}.{joint}")
        if values is None or np.isfinite(values).sum() < 100:
            return None
        there = np.isfinite(values)
        return filtfilt(*low, np.interp(clock, told["time"][there] + 0.5 * held, values[there]))

    q, theta, torque, motor = (dict[str, Array | None]() for _ in range(4))
    for name in robot.joints:
        q[name], theta[name] = smooth("q", name), smooth("theta", name)
        torque[name] = smooth("tau_t", name)
        # a command is held from its sample to the controller's next: it acts half of that later in the mean
        command = smooth("tau_m", name, held=1.0 / robot.control_rate)
        motor[name] = command if command is not None else smooth("tau_motor", name)
    seen = [q[n] if q[n] is not None else theta[n] for n in robot.joints]
    body = None
    if all(s is not None for s in seen):
        position = np.stack([np.asarray(s) for s in seen], axis=1)
        velocity = np.gradient(position, period, axis=0)
        body = nominal_dynamics(robot)(position, velocity, np.gradient(velocity, period, axis=0))
    loads = [None] * len(robot.joints) if body is None else list(body.T)
    joints = [
        _joint(robot, j, (q[name], theta[name], torque[name], motor[name], loads[j]), period)
        for j, name in enumerate(robot.joints)
    ]
    known = tuple(joint for joint in joints if joint is not None)
    return Machine(robot, data.get("tolerance", {}), 1.0 / period, known)


def _joint(robot: Robot, j: int, seen: tuple[Array | None, ...], period: float) -> Joint | None:
    """One joint of q, theta, tau_t, the motor's torque and the body's load; None where they do not do."""
    q, theta, measured, drive, body = seen
    K, D = float(robot.stiffness[j]), float(robot.damping[j])
    angle = theta if theta is not None else (q if np.isinf(K) else None)
    if angle is None or drive is None:
        return None
    phi = angle - q if np.isfinite(K) and q is not None and theta is not None else None
    dphi = np.gradient(phi, period) if phi is not None else None
    if measured is not None:
        load, load_from = measured, "torque sensor"
    elif phi is not None and dphi is not None:
        load, load_from = K * phi + D * dphi, "spring"
    elif body is not None:
        load, load_from = body, "rigid body"
    else:
        return None
    speed = np.gradient(angle, period)
    acceleration = np.gradient(speed, period)
    B, Dm = float(robot.motor_inertia[j]), float(robot.motor_damping[j])
    short = drive - B * acceleration - Dm * speed - load
    inner = slice(round(EDGE / period), -round(EDGE / period))
    angle, speed, acceleration, drive, load, short = (
        values[inner] for values in (angle, speed, acceleration, drive, load, short)
    )
    if phi is not None and dphi is not None:
        phi, dphi = phi[inner], dphi[inner]
    return Joint(
        robot.joints[j], angle, speed, acceleration, phi, dphi, drive, load, load_from, short, B, Dm, K, D
    )


USUAL_TOLERANCE = {"inertial": 0.02, "stiffness": 0.02, "damping": 0.1}  # where a robot file states none


def finding(effect: str, joint: str, value: float, std: float, name: str) -> dict[str, Any]:
    parameters = {name: {"value": value, "std": std}}
    return {"effect": effect, "joint": joint, "probability": 1.0, "parameters": parameters}


def answered(
    tool: str, find: Callable[[Machine, Path], list[dict[str, Any]]], cutoff: float = CUTOFF
) -> None:
    """Read a folder, find, and write answers, by the command line; `find` gets a case and its folder."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("answers", type=Path)
    given = parser.parse_args()
    answers: dict[str, Any] = {}
    if given.answers.exists():  # it goes on where it was stopped
        answers = json.loads(given.answers.read_text())["answers"]
    for name, entry in cases(given.folder)["cases"].items():
        if name in answers or "_" in name:  # real machines: their files say what this reader does not know
            continue
        started = time.perf_counter()
        found = find(read(given.folder, entry, cutoff), (given.folder / entry["robot"]).parent)
        answers[name] = {"findings": found, "seconds": round(time.perf_counter() - started, 2)}
        given.answers.write_text(json.dumps({"schema": SCHEMA, "tool": tool, "answers": answers}, indent=1))
