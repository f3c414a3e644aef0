"""The clockwork: physics at f_s, controller at f_c by an integer tick counter, delays, onsets of effects.

Time t [s] counts from the start of the recording, as for laws of effects and their `since`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction

import numpy as np

from flexjoint.core.errors import FlexJointError, SimulationError
from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.robot.robot import Robot
from flexjoint.simulation.controllers import Law
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.schemes import make_step
from flexjoint.simulation.schemes.stability import check_stability
from flexjoint.simulation.sensors import earlier, reading
from flexjoint.simulation.trajectory import Past, Trajectory

WATCH = 64  # steps between two looks for numbers that are not finite
FINEST = 10**6  # denominator of a rate [Hz] as a fraction
REFERENCES = ("q_ref", "theta_ref", "dtheta_ref", "tau_ff")
Command = Callable[["Runner"], np.ndarray]


class Ticks:
    """When the controller acts (Kameduła et al. 2016, equation 7, by integers, not a remainder of time).

    Both rates are free. Tick j belongs to the time j/f_c; the controller runs at the first physics step that
    does not lie before it, and its torque is held until the next one. So with an f_s that is no multiple of
    f_c a command is up to 1/f_s late, and with an f_c above f_s ticks are left out.
    """

    def __init__(self, physics: float, control: float) -> None:
        if not (0.0 < physics < math.inf and 0.0 < control < math.inf):
            raise SimulationError(f"rates: expected numbers above 0 [Hz], got {physics} and {control}")
        ratio = Fraction(control).limit_denominator(FINEST) / Fraction(physics).limit_denominator(FINEST)
        self._ticks, self._steps = ratio.numerator, ratio.denominator

    @property
    def ratio(self) -> tuple[int, int]:
        """f_c / f_s as a number of ticks in a number of steps."""
        return self._ticks, self._steps

    def last(self, step: int) -> int:
        """The latest tick at or before a physics step."""
        return step * self._ticks // self._steps

    def acts(self, step: int) -> bool:
        """Whether the controller runs at a physics step."""
        return step == 0 or self.last(step) != self.last(step - 1)

    def steps(self, ticks: int) -> int:
        """Physics steps before the tick of that number."""
        return -(-ticks * self._steps // self._ticks)


def physics_rate(robot: Robot) -> float:
    """The robot's f_s raised to a whole multiple of f_c [Hz], for work that takes whole steps to a tick."""
    control = robot.rates.control
    return control * math.ceil(robot.rates.physics / control - 1e-9)


def check_torque(model: FlexibleJointModel, torque: np.ndarray) -> np.ndarray:
    """(N, n) motor torques as floats; raises SimulationError for another shape."""
    torque = np.asarray(torque, dtype=float)
    if torque.ndim != 2 or torque.shape[1] != len(model.joints):
        raise SimulationError(
            f"torque: expected (N, {len(model.joints)}), one column per joint, got {torque.shape}"
        )
    return torque


def check_references(references: Mapping[str, np.ndarray], n: int) -> int:
    """The number of ticks T of references, each (T, n); raises SimulationError where one is missing or
    does not fit."""
    missing = [name for name in REFERENCES if name not in references]
    if missing:
        raise SimulationError(f"references: expected {', '.join(REFERENCES)}; {missing[0]} is missing")
    shapes = {name: np.shape(references[name]) for name in REFERENCES}
    first = shapes["q_ref"]
    for name, shape in shapes.items():
        if len(shape) != 2 or shape[1] != n or shape[0] != first[0]:
            raise SimulationError(
                f"references: expected (T, {n}) for each, one row per tick and a column per joint; {name} is"
                f" {shape}, q_ref {first}"
            )
    return first[0]


class Runner:
    """A simulation that runs step by step: the state, the rows behind it, and the model in force.

    Args:
        steps: rows kept behind the present one, at least what delays look up; as many as will be run for
            `all`, which returns them. A longer run drops the oldest.
        past: as for `flexjoint.simulation.rollout.rollout`.
    """

    def __init__(
        self,
        model: FlexibleJointModel,
        start: State,
        steps: int,
        options: RunOptions = DEFAULTS,
        past: Past | None = None,
    ) -> None:
        self.options, self.rate = options, options.rate_for(model.robot)
        self.h = 1.0 / self.rate
        self._begin = start.t
        self.steps = steps
        self.tape = _tape(model, start, steps, self.h, past)
        self.row, self.done = self.tape.first, 0
        self.last_command = self.tape.tau_m[self.row - 1].copy()  # (n,) motor torque, kept beyond its row
        self.x = start
        self._no_past = past is None
        self.take(model)
        check_stability(self.model, start, self.h, options.scheme)

    def take(self, model: FlexibleJointModel) -> None:
        """Go on with this model, whose state must have the same form."""
        self._segments = iter(segments(model, self._begin, sys.maxsize, self.h))
        self._sensing = model.robot.file.sensing_delay * self.rate
        self._enter()

    def _enter(self) -> None:
        """Take the model in force from the present step on."""
        until = -1
        while until <= self.done:
            self.model, until = next(self._segments)
        self._until = until
        self._step = make_step(self.model, self.h, self.options.scheme, self.options.width)
        self._late = _late_commands(self.model, self.rate)

    def readings(self, law: Law) -> dict[str, np.ndarray]:
        """What a law reads now, by channel."""
        tape, sensing, rate = self.tape, self._sensing, self.rate
        return {name: reading(self.model, tape, self.row, name, sensing, rate) for name in law.reads}

    def step(self, command: Command) -> None:
        """One physics step under the torque that the command gives."""
        if self.done >= self._until:
            self._enter()
        tape = self.tape
        if self.row + 1 == len(tape.time):
            self._drop()
        row = self.row
        tau = command(self)
        tape.tau_m[row] = self.last_command = tau
        if self.done == 0 and self._no_past:
            tape.tau_m[:row] = tau
        if self._late:
            tau = np.array(tau)
            for i, delay in self._late:
                tau[i] = earlier(tape.tau_m[:, i].__getitem__, row, delay)
        x = self._step(self.x, tau)
        tape.q[row + 1], tape.v[row + 1] = x.q, x.v
        tape.theta[row + 1], tape.dtheta[row + 1] = x.theta, x.dtheta
        tape.z[row + 1], tape.tau_rigid[row + 1] = x.z, x.tau_rigid
        self.x, self.row, self.done = x, row + 1, self.done + 1
        if self.done % WATCH == 0:
            self._look()

    def all(self, command: Command) -> Trajectory:
        """Every step of the tape, as a trajectory."""
        with self.watched():
            for _ in range(self.steps):
                self.step(command)
        if self.steps:
            self.tape.tau_m[-1] = self.tape.tau_m[-2]
        return self.tape

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Steps within raise SimulationError as soon as numbers are no longer finite."""
        try:
            with np.errstate(over="raise", invalid="raise"):
                yield
                self._look()
        except FlexJointError:
            raise
        except (ArithmeticError, ValueError):  # overflow, or a function of infinity
            raise _diverged(self) from None

    def _look(self) -> None:
        if not (np.isfinite(self.x.v).all() and np.isfinite(self.x.dtheta).all()):
            raise FloatingPointError

    def _drop(self) -> None:
        """Make room: keep the rows that delays look up, and the present one."""
        tape, kept = self.tape, slice(self.row - self.tape.first, self.row + 1)
        for name in ("q", "v", "theta", "dtheta", "z", "tau_rigid", "tau_m"):
            rows = getattr(tape, name)
            rows[: tape.first + 1] = rows[kept].copy()
        self.row = tape.first
        tape.time[:] = self._begin + self.h * (np.arange(len(tape.time)) - tape.first + self.done)


def _late_commands(model: FlexibleJointModel, rate: float) -> list[tuple[int, float]]:
    """Joints whose command arrives late, with the delay in steps."""
    flows = enumerate(model.flows)
    return [(i, flow.command_delay() * rate) for i, flow in flows if flow.max_command_delay > 0.0]


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
    tape = Trajectory(
        time=time, q=q, v=v, theta=theta, dtheta=dtheta, z=z, tau_rigid=tau_rigid, tau_m=tau_m, first=first
    )
    for name in ("q", "v", "theta", "dtheta", "z", "tau_rigid"):
        getattr(tape, name)[: first + 1] = getattr(start, name)
    if past is not None:
        for name in ("q", "v", "theta", "dtheta", "tau_m"):
            getattr(tape, name)[:first] = getattr(past, name)
    return tape


def segments(
    model: FlexibleJointModel, t: float, steps: int, h: float
) -> list[tuple[FlexibleJointModel, int]]:
    """The models in force one after the other, each with the step at which the next takes over."""
    found = []
    phases = model.phases
    for k, (_, phase) in enumerate(phases):
        last = k + 1 == len(phases)
        until = steps if last else min(steps, max(0, math.ceil((phases[k + 1][0] - t) / h - 1e-9)))
        found.append((phase, until))
    return found


def _diverged(run: Runner) -> SimulationError:
    return diverged(run.model, run.x.v, float(run.tape.time[run.row]), run.options.scheme, run.rate)


def diverged(model: FlexibleJointModel, v: np.ndarray, t: float, scheme: str, rate: float) -> SimulationError:
    """The error of a simulation that had these link velocities (nv,) at time t [s]."""
    speed = np.abs(v)
    speed[~np.isfinite(speed)] = np.inf
    worst = int(np.argmax(speed))
    names = [joint.name for joint in model.joints if joint.idx_v == worst] or [f"v[{worst}]"]
    return SimulationError(
        f"the simulation left the finite numbers at joint {names[0]}, t = {t:.4g} s ({scheme}, {rate:g} Hz):"
        " check the effects' parameters and the gains, or raise the physics rate"
    )
