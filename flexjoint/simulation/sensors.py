"""Sensor readings of a simulated motion, and the true signals behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.trajectory import Trajectory


def reading(
    model: FlexibleJointModel, tape: Trajectory, row: int, channel: str, sensing: float, rate: float
) -> np.ndarray:
    """(n,) what the controller reads at a row; `sensing` is the robot's sensing delay in rows."""
    out = np.empty(len(model.joints))
    for i, flow in enumerate(model.flows):
        delay = flow.reading_delay(channel) * rate + sensing
        value = earlier(true_at(model, tape, channel, i), row, delay)
        out[i] = flow.read(channel, Signals(t=tape.time[row]), value)
    return out


def earlier(value: Callable[[int], float], row: int, delay: float) -> float:
    """A value by row, `delay` rows before a row, by linear interpolation; before it the first row counts."""
    if delay >= row:
        return value(0)
    whole = math.ceil(delay)
    share, low = whole - delay, row - whole  # no rounding that depends on the row
    return value(low) if share == 0.0 else (1.0 - share) * value(low) + share * value(low + 1)


def true_at(model: FlexibleJointModel, tape: Trajectory, channel: str, i: int) -> Callable[[int], float]:
    """A true signal of the actuated joint i by row."""
    if channel != "tau_t":
        return _column(model, tape, channel, i).__getitem__
    joint = model.joints[i]
    if joint.rigid:
        return tape.tau_rigid[:, model.rigid.index(i)].__getitem__
    columns = [_column(model, tape, name, i) for name in ("q", "dq", "theta", "dtheta")]

    def torque(row: int) -> float:
        q, dq, theta, dtheta = (float(column[row]) for column in columns)
        tau_m = float(tape.tau_m[row, i])
        s = Signals(float(tape.time[row]), q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, tau_m)
        return float(model.flows[i].transmission(s, tape.z[row]))

    return torque


def _column(model: FlexibleJointModel, tape: Trajectory, channel: str, i: int) -> np.ndarray:
    """(R,) a true position or velocity of the actuated joint i."""
    joint = model.joints[i]
    if channel == "q" or (channel == "theta" and joint.rigid):
        return tape.q[:, joint.idx_q]
    if channel == "dq" or (channel == "dtheta" and joint.rigid):
        return tape.v[:, joint.idx_v]
    return (tape.theta if channel == "theta" else tape.dtheta)[:, model.flexible.index(i)]


def true_signals(model: FlexibleJointModel, tape: Trajectory) -> dict[tuple[str, str], np.ndarray]:
    """(R,) q, dq, theta, dtheta and tau_t of every actuated joint, by (channel, joint), past included."""
    out: dict[tuple[str, str], np.ndarray] = {}
    for i, joint in enumerate(model.joints):
        for channel in ("q", "dq", "theta", "dtheta"):
            out[channel, joint.name] = _column(model, tape, channel, i).copy()
        if joint.rigid:
            out["tau_t", joint.name] = tape.tau_rigid[:, model.rigid.index(i)].copy()
            continue
        tau_t = np.empty(len(tape.time))
        for phase, rows in spans(model, tape.time):
            q, dq, theta, dtheta = (out[c, joint.name][rows] for c in ("q", "dq", "theta", "dtheta"))
            s = Signals(
                tape.time[rows], q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, tape.tau_m[rows, i]
            )
            tau_t[rows] = phase.flows[i].transmission(s, tape.z[rows].T)
        out["tau_t", joint.name] = tau_t
    return out


def readings(
    model: FlexibleJointModel, tape: Trajectory, true: Mapping[tuple[str, str], np.ndarray] | None = None
) -> dict[tuple[str, str], np.ndarray]:
    """(R - first,) readings of the sensors of every actuated joint from the start on, by (channel, joint);
    `true` is what `true_signals` gives, if it is at hand."""
    true = true_signals(model, tape) if true is None else true
    out: dict[tuple[str, str], np.ndarray] = {}
    for (channel, name), values in true.items():
        i = model.robot.joint_names.index(name)
        seen = values.copy()
        for phase, rows in spans(model, tape.time):
            flow = phase.flows[i]
            if flow.reads_true(channel):
                continue
            t = tape.time[rows]
            x = np.interp(t - flow.reading_delay(channel), tape.time, values)
            seen[rows] = flow.read(channel, Signals(t=t), x)
        out[channel, name] = seen[tape.first :]
    return out


def spans(model: FlexibleJointModel, time: np.ndarray) -> list[tuple[FlexibleJointModel, slice]]:
    """The model in force over each span of rows."""
    begins = [int(np.searchsorted(time, t - 1e-9)) for t, _ in model.phases] + [len(time)]
    return [(phase, slice(begins[k], begins[k + 1])) for k, (_, phase) in enumerate(model.phases)]
