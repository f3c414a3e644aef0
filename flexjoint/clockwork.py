"""The clockwork: physics at f_s, controller at f_c by an integer tick counter, and what the sensors say.

Time t [s] counts from the start of the recording, as for laws of effects and their `since`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from flexjoint.control import Law
from flexjoint.effect import SENSOR_CHANNELS, Signals
from flexjoint.errors import FlexJointError, SimulationError
from flexjoint.integrate import DEFAULT, check_stability, make_step
from flexjoint.model import FlexibleJointModel, State
from flexjoint.robot import Robot

WATCH = 64  # steps between two looks for numbers that are not finite
Command = Callable[["Trajectory", int, FlexibleJointModel], np.ndarray]


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion on a uniform time grid of R rows, the first `first` of which lie before the start.

    time (R,) [s]; q (R, nq), v (R, nv); theta, dtheta (R, nf) of the flexible joints; z (R, nz);
    tau_rigid (R, nr); tau_m (R, n) motor torque commanded at a row and held to the next, before the
    effects on the command.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    z: np.ndarray
    tau_rigid: np.ndarray
    tau_m: np.ndarray
    first: int = 0

    def state(self, row: int) -> State:
        """The state at a row, with nothing remembered of the step before."""
        nv, nf = self.v.shape[1], self.theta.shape[1]
        return State(
            float(self.time[row]),
            self.q[row].copy(),
            self.v[row].copy(),
            self.theta[row].copy(),
            self.dtheta[row].copy(),
            self.z[row].copy(),
            np.zeros(nv),
            np.zeros(nf),
            self.tau_rigid[row].copy(),
        )


@dataclass(frozen=True)
class Past:
    """What went before a start, oldest first, on the grid of the simulation: motor torques tau_m (H, n) and
    q (H, nq), v (H, nv), theta, dtheta (H, nf). Delayed commands and readings look it up."""

    tau_m: np.ndarray
    q: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray


def physics_rate(robot: Robot) -> float:
    """f_s of the clockwork [Hz]: the robot's, raised to a whole multiple of f_c."""
    control = robot.rates.control
    return control * math.ceil(robot.rates.physics / control - 1e-9)


def rollout(
    model: FlexibleJointModel,
    start: State,
    torque: np.ndarray,
    rate: float,
    past: Past | None = None,
    scheme: str = DEFAULT,
    width: float | None = None,
) -> Trajectory:
    """Simulate under given motor torques.

    Args:
        torque: (N, n) commanded motor torque of each step [N m], before the effects on the command.
        rate: steps per second.
        past: what delays look up before the start; default: the start state and the first torque, held.
        scheme, width: see `flexjoint.integrate`.

    Raises:
        SimulationError: wrong shapes, an explicit scheme that diverges, numbers that are not finite.
    """
    torque = np.asarray(torque, dtype=float)
    if torque.ndim != 2 or torque.shape[1] != len(model.joints):
        raise SimulationError(
            f"torque: expected (N, {len(model.joints)}), one column per joint, got {torque.shape}"
        )

    def command(_tape: Trajectory, k: int, _model: FlexibleJointModel) -> np.ndarray:
        return torque[k]

    return _run(model, start, len(torque), rate, command, past, scheme, width)


def closed_loop(
    model: FlexibleJointModel,
    start: State,
    law: Law,
    references: Mapping[str, np.ndarray],
    rate: float,
    past: Past | None = None,
    scheme: str = DEFAULT,
    width: float | None = None,
) -> Trajectory:
    """Simulate under a control law sampled at f_c.

    Args:
        references: q_ref, theta_ref, dtheta_ref, tau_ff, each (T, n): one row per control tick, T ticks.
        rate: steps per second, a whole multiple of the robot's control rate.
        past, scheme, width: as for `rollout`.

    Raises:
        SimulationError: as `rollout`, or a rate that is no multiple of the control rate.
    """
    control = model.robot.rates.control
    steps_per_tick = round(rate / control)
    if steps_per_tick < 1 or abs(steps_per_tick * control - rate) > 1e-9 * rate:
        raise SimulationError(
            f"the physics rate must be a whole multiple of the control rate {control:g} Hz, got {rate:g}"
        )
    ticks = len(next(iter(references.values())))
    sensing = model.robot.file.sensing_delay * rate

    def command(tape: Trajectory, k: int, now: FlexibleJointModel) -> np.ndarray:
        tick, since_tick = divmod(k, steps_per_tick)
        row = tape.first + k
        if since_tick:
            return tape.tau_m[row - 1]
        reading = {name: _reading(now, tape, row, name, sensing, rate) for name in law.reads}
        return law.torque({name: values[tick] for name, values in references.items()}, reading)

    return _run(model, start, ticks * steps_per_tick, rate, command, past, scheme, width)


def _run(
    model: FlexibleJointModel,
    start: State,
    steps: int,
    rate: float,
    command: Command,
    past: Past | None,
    scheme: str,
    width: float | None,
) -> Trajectory:
    h = 1.0 / rate
    check_stability(model, start, h, scheme)
    tape = _tape(model, start, steps, h, past)
    x, done = start, 0
    try:
        with np.errstate(over="raise", invalid="raise"):
            for phase, until in _segments(model, start.t, steps, h):
                step = make_step(phase, h, scheme, width)
                late = _late_commands(phase, rate)
                for k in range(done, until):
                    row = tape.first + k
                    tau = command(tape, k, phase)
                    tape.tau_m[row] = tau
                    if k == 0 and past is None:
                        tape.tau_m[:row] = tau
                    if late:
                        tau = np.array(tau)
                        for i, delay in late:
                            tau[i] = _earlier(tape.tau_m[:, i], row, delay)
                    x = step(x, tau)
                    _record(tape, row + 1, x)
                    done = k + 1
                    if done % WATCH == 0 and not np.isfinite(x.v).all():
                        raise FloatingPointError
    except FlexJointError:
        raise
    except (ArithmeticError, ValueError):  # overflow, or a function of infinity
        raise _diverged(model, tape, tape.first + done, scheme, rate) from None
    if not np.isfinite(tape.v[-1]).all():
        raise _diverged(model, tape, tape.first + done, scheme, rate)
    if steps:
        tape.tau_m[-1] = tape.tau_m[-2]
    return tape


def _late_commands(model: FlexibleJointModel, rate: float) -> list[tuple[int, float]]:
    """Joints whose command arrives late, with the delay in steps."""
    flows = enumerate(model.flows)
    return [(i, flow.command_delay() * rate) for i, flow in flows if flow.max_command_delay > 0.0]


def _record(tape: Trajectory, row: int, x: State) -> None:
    tape.q[row], tape.v[row] = x.q, x.v
    tape.theta[row], tape.dtheta[row] = x.theta, x.dtheta
    tape.z[row], tape.tau_rigid[row] = x.z, x.tau_rigid


def _tape(model: FlexibleJointModel, start: State, steps: int, h: float, past: Past | None) -> Trajectory:
    """Empty rows with those before the start filled in."""
    if past is None:
        longest = longest_delay(model)
        first = math.ceil(longest / h - 1e-9) + 1 if longest > 0.0 else 0
    else:
        first = len(past.tau_m)
    rows = first + steps + 1
    time = start.t + h * (np.arange(rows) - first)
    sizes = (model.nq, model.nv, model.nf, model.nf, model.nz, len(model.rigid), len(model.joints))
    q, v, theta, dtheta, z, tau_rigid, tau_m = (np.zeros((rows, size)) for size in sizes)
    tape = Trajectory(time, q, v, theta, dtheta, z, tau_rigid, tau_m, first)
    for name in ("q", "v", "theta", "dtheta", "z", "tau_rigid"):
        getattr(tape, name)[: first + 1] = getattr(start, name)
    if past is not None:
        for name in ("q", "v", "theta", "dtheta", "tau_m"):
            getattr(tape, name)[:first] = getattr(past, name)
    return tape


def longest_delay(model: FlexibleJointModel) -> float:
    """How far back delays of commands and readings may look, in any phase [s]."""
    flows = [flow for _, phase in model.phases for flow in phase.flows]
    command = max(flow.max_command_delay for flow in flows)
    reading = max(flow.max_reading_delay(channel) for flow in flows for channel in SENSOR_CHANNELS)
    return max(command, reading + model.robot.file.sensing_delay)


def _segments(
    model: FlexibleJointModel, t: float, steps: int, h: float
) -> list[tuple[FlexibleJointModel, int]]:
    """The models that hold in turn, each with the step at which the next takes over."""
    segments = []
    phases = model.phases
    for k, (_, phase) in enumerate(phases):
        last = k + 1 == len(phases)
        until = steps if last else min(steps, max(0, math.ceil((phases[k + 1][0] - t) / h - 1e-9)))
        segments.append((phase, until))
    return segments


def _earlier(column: np.ndarray, row: int, delay: float) -> float:
    """A column `delay` rows before a row, by linear interpolation; the first row holds before it."""
    place = max(row - delay, 0.0)
    low = int(place)
    share = place - low
    return column[low] if share == 0.0 else (1.0 - share) * column[low] + share * column[low + 1]


def _diverged(
    model: FlexibleJointModel, tape: Trajectory, row: int, scheme: str, rate: float
) -> SimulationError:
    speed = np.abs(tape.v[row])
    speed[~np.isfinite(speed)] = np.inf
    worst = int(np.argmax(speed))
    names = [joint.name for joint in model.joints if joint.idx_v == worst] or [f"v[{worst}]"]
    return SimulationError(
        f"the simulation left the finite numbers at joint {names[0]}, t = {tape.time[row]:.4g} s ({scheme},"
        f" {rate:g} Hz): check the effects' parameters and the gains, or raise the physics rate"
    )


# --- what sensors say -----------------------------------------------------------------------------------
def _column(model: FlexibleJointModel, tape: Trajectory, channel: str, i: int) -> np.ndarray:
    """(R,) a true position or velocity of the actuated joint i."""
    joint = model.joints[i]
    if channel == "q" or (channel == "theta" and joint.rigid):
        return tape.q[:, joint.idx_q]
    if channel == "dq" or (channel == "dtheta" and joint.rigid):
        return tape.v[:, joint.idx_v]
    return (tape.theta if channel == "theta" else tape.dtheta)[:, model.flexible.index(i)]


def _reading(
    model: FlexibleJointModel, tape: Trajectory, row: int, channel: str, sensing: float, rate: float
) -> np.ndarray:
    """(n,) what the controller reads at a row; `sensing` is the robot's sensing delay in rows."""
    out = np.empty(len(model.joints))
    for i, flow in enumerate(model.flows):
        delay = flow.reading_delay(channel) * rate + sensing
        value = _earlier(_column(model, tape, channel, i), row, delay)
        out[i] = flow.read(channel, Signals(t=tape.time[row]), value)
    return out


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
    """(R - first,) what the sensors of every actuated joint say from the start on, by (channel, joint);
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
    """The model that holds over each span of rows."""
    begins = [int(np.searchsorted(time, t - 1e-9)) for t, _ in model.phases] + [len(time)]
    return [(phase, slice(begins[k], begins[k + 1])) for k, (_, phase) in enumerate(model.phases)]
