"""Many rollouts in one call, on all cores: other parameters, start states, gains or inputs in each.

Compiled rollouts run in threads (the C code holds no lock), in each as many side by side as the processor's
registers hold (8 with AVX-512, 4 with AVX, else 2); the pin loop runs in processes. A rollout's result
depends neither on how many there are of these, nor on what the others are.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexjoint.core.errors import SimulationError, unknown
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.parameters import model_parameters, renumbered
from flexjoint.model.springs import VariableSpring
from flexjoint.robot.robot import Robot
from flexjoint.simulation.compiled import CompiledModel, Job
from flexjoint.simulation.compiled.engine import LONG, adaptive, choose
from flexjoint.simulation.compiled.model import row_of
from flexjoint.simulation.compiled.program import numbers_of, with_numbers
from flexjoint.simulation.controllers import Law
from flexjoint.simulation.loop import REFERENCES, Ticks, check_references
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.schemes import DEFAULT, find
from flexjoint.simulation.schemes.midpoint import warn_of_order_one
from flexjoint.simulation.schemes.stability import check_stability
from flexjoint.simulation.sensors import true_signals
from flexjoint.simulation.trajectory import Trajectory

Progress = Callable[[float, str], None]
SIGNALS = ("q", "dq", "theta", "dtheta", "tau_t", "tau_m", "error")


@dataclass(frozen=True)
class Summary:
    """Of one signal over the steps of each of B rollouts, (B, n) each: least, largest, mean and root mean
    square."""

    least: np.ndarray
    largest: np.ndarray
    mean: np.ndarray
    rms: np.ndarray

    @property
    def peak(self) -> np.ndarray:
        """(B, n) largest magnitude."""
        return np.maximum(np.abs(self.least), np.abs(self.largest))


@dataclass(frozen=True, kw_only=True)
class Batch:
    """B rollouts of N steps.

    Every `every`-th row is kept: time (R,), x (B, R, nx) in the order of `state_names`, tau_m (B, R, n);
    R is 0 where only summaries were asked for. `final` (B, nx) is the state at the end. `summary` holds the
    true q, dq, theta, dtheta, tau_t of the actuated joints, tau_m, and error = q_ref - q (0 without q_ref)
    over the steps. `failed_at` (B,) is the time [s] at which a rollout had left the finite numbers, or a step
    had not converged, NaN for those that went well: its numbers mean nothing.
    """

    state_names: tuple[str, ...]
    time: np.ndarray
    x: np.ndarray
    tau_m: np.ndarray
    final: np.ndarray
    summary: Mapping[str, Summary]
    failed_at: np.ndarray

    def state(self, name: str) -> np.ndarray:
        """(B, R) an entry of the state by its name; UnknownNameError lists the valid ones."""
        if name not in self.state_names:
            raise unknown("state", name, self.state_names)
        return self.x[:, :, self.state_names.index(name)]


def rollouts(
    model: FlexibleJointModel,
    starts: State | Sequence[State],
    torque: np.ndarray,
    options: RunOptions = DEFAULTS,
    *,
    parameters: Mapping[str, np.ndarray] | None = None,
    every: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Batch:
    """Many rollouts under given motor torques.

    Args:
        starts: one state for all, or one each.
        torque: (N, n) [N m] for all, or (B, N, n).
        parameters: (B,) numbers by name, as `parameter_names` lists them.
        every: keep every such row; None keeps summaries only, and memory is flat in N.
        workers: default one per core.
        progress: called with the share of the rollouts that are done, after each or a few, and
            what they are, e.g. `flexjoint.report.terminal.Progress()`.

    Raises:
        SimulationError, ModelError: shapes that do not fit, parameters out of bounds.
        UnknownNameError: an unknown parameter.
    """
    torque = np.asarray(torque, dtype=float)
    shared, n = torque.ndim == 2, len(model.joints)
    if torque.ndim not in (2, 3) or torque.shape[-1] != n:
        raise SimulationError(f"torque: expected (N, {n}) or (B, N, {n}), got {torque.shape}")
    work = _Work(model, options, None, (), every, torque.shape[-2])
    count = _count(starts, parameters, {}, {} if shared else {"torque": torque})
    drives: Sequence[np.ndarray] = [torque] * count if shared else list(torque)
    return _run(work, _each(starts, count), drives, [None] * count, parameters, workers, progress)


def closed_loops(
    model: FlexibleJointModel,
    starts: State | Sequence[State],
    law: Law,
    references: Mapping[str, np.ndarray],
    options: RunOptions = DEFAULTS,
    *,
    parameters: Mapping[str, np.ndarray] | None = None,
    gains: Mapping[str, np.ndarray] | None = None,
    every: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Batch:
    """Many rollouts under a control law.

    Args:
        references: (T, n) by name for all, one row per control tick.
        gains: (B, n) or (B,) numbers of fields of the law (kp, kd, ...).
        all others: as `rollouts`.

    Raises as `rollouts`; UnknownNameError for a gain that the law has not.
    """
    ticks = check_references(references, len(model.joints))
    own = numbers_of(law)
    for name in gains or {}:
        if name not in own:
            raise unknown("gain", name, own)
    steps = Ticks(options.rate_for(model.robot), model.robot.rates.control).steps(ticks)
    work = _Work(model, options, law, REFERENCES, every, steps)
    count = _count(starts, parameters, gains or {}, {})
    laws = []
    for k in range(count):
        new = {
            name: np.asarray(values)[k] * np.ones_like(own[name]) for name, values in (gains or {}).items()
        }
        laws.append(with_numbers(law, {**own, **new}))
    rows = np.hstack([np.asarray(references[name], dtype=float) for name in REFERENCES])
    return _run(work, _each(starts, count), [rows] * count, laws, parameters, workers, progress)


def parameter_names(model: FlexibleJointModel) -> tuple[str, ...]:
    """What a batch can vary: effect.joint.name and drive.joint.stiffness, damping, ..."""
    return tuple(model_parameters(model.robot, model.effects, ("drives",)))


# --- how it is run ------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Work:
    """What all rollouts share."""

    model: FlexibleJointModel
    options: RunOptions
    law: Law | None
    references: tuple[str, ...]
    every: int | None
    steps: int

    @property
    def rate(self) -> float:
        return self.options.rate_for(self.model.robot)


@dataclass(frozen=True)
class _Alone:
    """What one rollout by the pin loop needs, in a process of its own."""

    options: RunOptions
    robot: Robot
    effects: tuple[Planned, ...]
    springs: Mapping[str, VariableSpring]
    start: State
    law: Law | None
    drive: np.ndarray
    references: tuple[str, ...]
    every: int | None
    steps: int


@dataclass(frozen=True)
class _One:
    """What one rollout leaves; sums (4, 7 n) and lost as the compiled driver has them."""

    x: np.ndarray
    tau_m: np.ndarray
    final: np.ndarray
    sums: np.ndarray
    failed: int
    lost: tuple[float, float] | None = None


_Task = tuple[tuple[int, ...], Callable[..., list[_One]], tuple[Any, ...]]  # of rollouts at these places


def _run(
    work: _Work,
    starts: Sequence[State],
    drives: Sequence[np.ndarray],
    laws: Sequence[Law | None],
    parameters: Mapping[str, np.ndarray] | None,
    workers: int | None,
    progress: Progress | None,
) -> Batch:
    model, options, every = work.model, work.options, work.every
    if every is not None and every < 1:
        raise SimulationError(f"every: expected a whole number of steps >= 1 or None, got {every}")
    names, count = parameter_names(model), len(starts)
    for name in parameters or {}:
        if name not in names:
            raise unknown("parameter", name, names)
    changes = [{name: float(v[k]) for name, v in (parameters or {}).items()} for k in range(count)]
    numbered = [renumbered(model.robot, model.effects, change) if change else None for change in changes]
    total = work.steps * count
    compiled, loop = None, replace(options, engine="pin")
    if find(options.scheme).adaptive:
        loop = loop if adaptive(model, total, options) is model else replace(options, engine="compiled")
    else:
        many = not find(options.scheme).newton
        compiled = choose(model, total, options, work.law, work.references, many)
    if options.scheme != DEFAULT:
        for start, item in zip(starts, numbered, strict=True):
            other = FlexibleJointModel(*item, springs=model.springs) if item else model
            check_stability(other, start, 1.0 / work.rate, options.scheme)
    tasks: list[_Task] = []
    if compiled is None:
        for k, (start, drive, law, item) in enumerate(zip(starts, drives, laws, numbered, strict=True)):
            robot, effects = item or (model.robot, model.effects)
            timing = (work.references, every, work.steps)
            alone = _Alone(loop, robot, effects, model.springs, start, law, drive, *timing)
            tasks.append(((k,), _by_pin, (alone,)))
    else:
        jobs = _jobs(compiled, work, starts, drives, laws, changes)
        for places in _side_by_side(jobs, compiled.lanes):
            tasks.append((places, _by_c, (compiled, [jobs[k] for k in places], every)))
    if model.springs and compiled is None:
        workers = 1  # functions of time do not travel to other processes
    with _executor(compiled, workers, total) as executor:
        done = _in_order(executor, tasks, count, progress)
    _check_followed(work, done)
    return _gathered(work, starts, done)


def _check_followed(work: _Work, done: Sequence[_One]) -> None:
    """Warns of the rollout in which a link turned most within a step that did not follow its motion."""
    lost = [one.lost for one in done if one.lost and one.failed < 0]
    if lost:
        warn_of_order_one(*max(lost, key=lambda one: one[1]), work.rate)


def _jobs(
    compiled: CompiledModel,
    work: _Work,
    starts: Sequence[State],
    drives: Sequence[np.ndarray],
    laws: Sequence[Law | None],
    changes: Sequence[Mapping[str, float]],
) -> list[Job]:
    nominal = compiled.values(work.model)
    places = {name: k for k, name in enumerate(parameter_names(work.model))}
    jobs = []
    for start, drive, law, change in zip(starts, drives, laws, changes, strict=True):
        values = nominal.copy()
        for name, value in change.items():
            values[places[name]] = value
        jobs.append(
            Job(
                row=row_of(work.model, start),
                t=float(start.t),
                values=values,
                drive=drive,
                gains=compiled.gains(law),
                steps=work.steps,
            )
        )
    return jobs


def _side_by_side(jobs: Sequence[Job], lanes: int) -> list[tuple[int, ...]]:
    """Places of jobs that run side by side: they begin at one time."""
    at: dict[float, list[int]] = {}
    for k, job in enumerate(jobs):
        at.setdefault(job.t, []).append(k)
    return [tuple(own[k : k + lanes]) for own in at.values() for k in range(0, len(own), lanes)]


def _by_c(compiled: CompiledModel, jobs: Sequence[Job], every: int | None) -> list[_One]:
    found = []
    for rows in compiled.run_all(jobs, stride=every or -1, summary=True):
        assert rows.summary is not None  # it was asked for
        found.append(_One(rows.states, rows.tau_m, rows.final, rows.summary, rows.failed, rows.lost))
    return found


def _by_pin(work: _Alone) -> list[_One]:
    return [_looped(work)]


def _looped(work: _Alone) -> _One:
    model, n = FlexibleJointModel(work.robot, work.effects, springs=work.springs), len(work.robot.joints)
    drive = work.drive
    references = {name: drive[:, k * n : (k + 1) * n] for k, name in enumerate(work.references)}
    try:
        if work.law is None:
            tape = rollout(model, work.start, drive, work.options)
        else:
            tape = closed_loop(model, work.start, work.law, references, work.options)
    except SimulationError:  # it left the finite numbers: its shape and step were checked before
        width = row_of(model, work.start).shape[0]
        kept = len(range(0, work.steps, work.every)) if work.every else 0
        nothing = np.full((kept, width), np.nan), np.full((kept, n), np.nan)
        return _One(*nothing, np.full(width, np.nan), np.full((4, 7 * n), np.nan), work.steps - 1)
    rows = slice(tape.first, len(tape.time) - 1)
    x = np.hstack([getattr(tape, name)[tape.first :] for name in ("q", "v", "theta", "dtheta", "z")])
    true = true_signals(model, tape)
    columns = [true[c, joint.name][rows] for c in SIGNALS[:5] for joint in model.joints]
    observed = np.column_stack(
        [*columns, tape.tau_m[rows], _error(model, tape, rows, references, work.options.rate_for(work.robot))]
    )
    sums = np.array([observed.min(0), observed.max(0), observed.sum(0), (observed**2).sum(0)])
    stride = work.every or work.steps + 1
    kept_rows = slice(0, work.steps if work.every else 0, stride)
    return _One(x[kept_rows], tape.tau_m[rows][kept_rows], x[-1], sums, -1)


def _error(
    model: FlexibleJointModel,
    tape: Trajectory,
    rows: slice,
    references: Mapping[str, np.ndarray],
    rate: float,
) -> np.ndarray:
    q = tape.q[rows][:, [joint.idx_q for joint in model.joints]]
    if "q_ref" not in references:
        return np.zeros_like(q)
    ticks = Ticks(rate, model.robot.rates.control)
    return references["q_ref"][[ticks.last(step) for step in range(len(q))]] - q


@contextmanager
def _executor(compiled: CompiledModel | None, workers: int | None, steps: int) -> Iterator[Executor | None]:
    """Threads for C, processes for Python; none where one core or little work makes them useless."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = cores if workers is None else workers
    if workers < 1:
        raise SimulationError(f"workers: expected 1 or more, got {workers}")
    if workers == 1 or (compiled is None and steps < LONG):
        yield None
        return
    pool = ThreadPoolExecutor(workers) if compiled is not None else ProcessPoolExecutor(workers)
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _in_order(
    executor: Executor | None, tasks: Sequence[_Task], count: int, progress: Progress | None
) -> list[_One]:
    report: Progress = progress or (lambda _share, _what: None)
    results: list[_One | None] = [None] * count
    finished = 0

    def note(places: tuple[int, ...], found: list[_One]) -> None:
        nonlocal finished
        for place, one in zip(places, found, strict=True):
            results[place] = one
        finished += len(places)
        report(finished / count, "rollouts")

    if executor is None:
        for places, task, arguments in tasks:
            note(places, task(*arguments))
    else:
        running: dict[Future[list[_One]], tuple[int, ...]] = {
            executor.submit(task, *arguments): places for places, task, arguments in tasks
        }
        for future in as_completed(running):
            note(running[future], future.result())
    return [result for result in results if result is not None]


def _gathered(work: _Work, starts: Sequence[State], done: Sequence[_One]) -> Batch:
    model = work.model
    n, h = len(model.joints), 1.0 / work.rate
    sums = np.array([one.sums for one in done]).reshape(len(done), 4, len(SIGNALS), n)
    steps = max(work.steps, 1)
    summary = {
        name: Summary(sums[:, 0, k], sums[:, 1, k], sums[:, 2, k] / steps, np.sqrt(sums[:, 3, k] / steps))
        for k, name in enumerate(SIGNALS)
    }
    failed = [
        start.t + (one.failed + 1) * h if one.failed >= 0 else np.nan
        for start, one in zip(starts, done, strict=True)
    ]
    kept = np.arange(0, work.steps, work.every) if work.every else np.zeros(0)
    return Batch(
        state_names=model.state_names,
        time=starts[0].t + kept * h,
        x=np.array([one.x[:, : model.nx] for one in done]),
        tau_m=np.array([one.tau_m for one in done]),
        final=np.array([one.final[: model.nx] for one in done]),
        summary=summary,
        failed_at=np.array(failed),
    )


def _each(starts: State | Sequence[State], count: int) -> Sequence[State]:
    return [starts] * count if isinstance(starts, State) else list(starts)


def _count(
    starts: State | Sequence[State],
    parameters: Mapping[str, np.ndarray] | None,
    gains: Mapping[str, np.ndarray],
    drives: Mapping[str, np.ndarray],
) -> int:
    """B, on which all that varies must agree."""
    lengths = {name: len(values) for name, values in {**(parameters or {}), **gains, **drives}.items()}
    if not isinstance(starts, State):
        lengths["starts"] = len(starts)
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        listed = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise SimulationError(f"expected as many rollouts (1 or more) in each, got {listed}")
    return next(iter(lengths.values()), 1)
