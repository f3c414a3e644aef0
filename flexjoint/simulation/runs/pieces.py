"""A long simulation in pieces, one recording after the other: memory does not grow with its length.

What comes out is what `simulate` gives of the whole, bit by bit where the controller drives; recorded torques
are summed up anew in every piece, which rounds differently.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.running.budget import UNLIMITED, Budget
from flexjoint.core.running.progress import Report, silent
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.recording.table import Recording
from flexjoint.simulation.compiled import CompiledModel
from flexjoint.simulation.compiled.engine import adaptive, choose
from flexjoint.simulation.compiled.live import LiveRun
from flexjoint.simulation.controllers import Law, law_of
from flexjoint.simulation.loop import REFERENCES, Runner, Ticks
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.schemes import find
from flexjoint.simulation.schemes.stability import check_stability
from flexjoint.simulation.simulate import (
    Drive,
    check_size,
    command_rate,
    controlled,
    measured_rows,
    references_at,
    rest_of,
    ticks_of,
    torque_over,
)
from flexjoint.simulation.trajectory import Trajectory

PIECE = 20_000  # steps: 20 s at 1 kHz, some megabytes

Tables = dict[str, np.ndarray]
Take = Callable[[int, int], Trajectory]  # the steps from one number to another, and the rows behind them


@dataclass(frozen=True)
class Piece:
    """Readings of a part of a run, and the share of the run that is done with it."""

    measured: Recording
    done: float


def simulated_in_pieces(
    model: FlexibleJointModel,
    reference: Recording,
    options: RunOptions = DEFAULTS,
    *,
    drive: Drive = "auto",
    progress: Report = silent,
    budget: Budget = UNLIMITED,
    size: int = PIECE,
) -> Iterator[Piece]:
    """Simulate the model from rest along a reference, as `flexjoint.simulation.simulate.simulate` does.

    Args:
        drive: as for `simulate`.
        progress: called with a share in [0, 1] and what is being done.
        budget: after which no further piece begins.
        size: steps of a piece.

    Raises what `simulate` raises, when the first piece is asked for, or when the simulation diverges.
    """
    rate, names = options.rate_for(model.robot), model.robot.joint_names
    check_size(model, reference, rate)
    by_law = controlled(reference, names, drive)
    start = rest_of(model, reference, by_law)
    law = law_of(model.robot) if by_law else None
    take: Take
    if law is not None:
        ticks = ticks_of(reference, model.robot.rates.control)
        clock = Ticks(rate, model.robot.rates.control)
        steps = clock.steps(len(ticks))
        take = _by_law(model, start, law, reference, ticks, options, clock, min(size, steps))
    else:
        steps = round(reference.duration * rate) + 1
        edges = reference.time[0] + np.arange(steps + 1) / rate
        held = command_rate(model.robot, reference)

        def torque(begin: int, end: int) -> np.ndarray:
            return torque_over(reference, names, edges[begin : end + 1], held)

        take = _by_torque(model, start, torque, options, steps, min(size, steps))
    around = _Around(reference)
    for begin in range(0, steps, size):
        end = min(begin + size, steps)
        tape = take(begin, end)
        near = around.times(reference.time[0] + begin / rate, reference.time[0] + end / rate)
        yield Piece(measured_rows(model, near, tape, start, by_law, reference.time[0]), end / steps)
        progress(end / steps, f"simulating, {end / rate:.4g} of {steps / rate:.4g} s")
        if budget.spent:
            return


class _Around:
    """A reference from one time to another, with the samples beside: work on a piece does not grow with the
    whole. One that lacks samples is left whole, for the next ones may be far away."""

    def __init__(self, reference: Recording) -> None:
        self._reference = reference
        self._whole = not all(np.all(np.isfinite(values)) for values in reference.columns.values())

    def times(self, begin: float, end: float) -> Recording:
        """The part that holds these times [s]."""
        if self._whole:
            return self._reference
        time = self._reference.time
        first, last = np.searchsorted(time, begin) - 2, np.searchsorted(time, end) + 3
        rows = slice(max(0, first), last)
        columns = {key: values[rows] for key, values in self._reference.columns.items()}
        return replace(self._reference, time=time[rows], columns=columns)


def _by_law(
    model: FlexibleJointModel,
    start: State,
    law: Law,
    reference: Recording,
    ticks: np.ndarray,
    options: RunOptions,
    clock: Ticks,
    size: int,
) -> Take:
    """Steps under a control law that follows a reference."""

    around = _Around(reference)

    def tables(begin: int, end: int) -> tuple[int, Tables]:
        """The number of the first tick in some steps, and the references from there on."""
        first = clock.last(begin)
        own = ticks[first : clock.last(end - 1) + 1]
        return first, references_at(model, around.times(own[0], own[-1]), own)

    steps = clock.steps(len(ticks))
    compiled, model = _engine(model, start, steps, options, law)
    if compiled is not None:
        run, values, gains = (
            LiveRun(compiled, model, start, size),
            compiled.values(model),
            compiled.gains(law),
        )

        def take(begin: int, end: int) -> Trajectory:
            first, table = tables(begin, end)
            return run.along(end, values, compiled.references(table), first, gains)

        return take
    runner = Runner(model, start, size, options)

    def take_by_pin(begin: int, end: int) -> Trajectory:
        first, table = tables(begin, end)

        def command(now: Runner) -> np.ndarray:
            if not clock.acts(now.done):
                return now.last_command
            tick = clock.last(now.done) - first
            return law.torque({name: table[name][tick] for name in REFERENCES}, now.readings(law))

        return _stepped(runner, end - begin, command)

    return take_by_pin


def _by_torque(
    model: FlexibleJointModel,
    start: State,
    torque: Callable[[int, int], np.ndarray],
    options: RunOptions,
    steps: int,
    size: int,
) -> Take:
    """Steps under torques, given from one step to another."""
    compiled, model = _engine(model, start, steps, options)
    if compiled is not None:
        run, values, gains = (
            LiveRun(compiled, model, start, size),
            compiled.values(model),
            compiled.gains(None),
        )
        return lambda begin, end: run.along(end, values, torque(begin, end), begin, gains)
    runner = Runner(model, start, size, options)

    def take_by_pin(begin: int, end: int) -> Trajectory:
        given = torque(begin, end)
        return _stepped(runner, end - begin, lambda now: given[now.done - begin])

    return take_by_pin


def _engine(
    model: FlexibleJointModel, start: State, steps: int, options: RunOptions, law: Law | None = None
) -> tuple[CompiledModel | None, FlexibleJointModel]:
    """The compiled model, or None for the loop in Python, and the model for it."""
    if find(options.scheme).adaptive:
        return None, adaptive(model, steps, options)
    compiled = choose(model, steps, options, law, REFERENCES if law is not None else ())
    if compiled is not None:
        check_stability(model, start, 1.0 / compiled.rate, options.scheme)
    return compiled, model


def _numbers(
    compiled: CompiledModel, model: FlexibleJointModel, law: Law | None
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and gains of a run."""
    return compiled.values(model), compiled.gains(law)


def _stepped(runner: Runner, steps: int, command: Callable[[Runner], np.ndarray]) -> Trajectory:
    """So many steps of the loop in Python: the rows of its tape that they fill, with those before them."""
    with runner.watched():
        for _ in range(steps):
            runner.step(command)
    tape, rows = runner.tape, slice(runner.row - steps - runner.tape.first, runner.row + 1)
    kept = {
        name: getattr(tape, name)[rows].copy()
        for name in ("time", "q", "v", "theta", "dtheta", "z", "tau_rigid", "tau_m")
    }
    kept["tau_m"][-1] = kept["tau_m"][-2]
    return Trajectory(**kept, first=tape.first)
