"""A run of the compiled clockwork that goes on while its references, gains and springs change."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.simulation.compiled.model import CompiledModel, DriverRun, lost_by, row_of
from flexjoint.simulation.loop import diverged
from flexjoint.simulation.schemes.implicit import not_converged
from flexjoint.simulation.schemes.midpoint import warn_of_order_one
from flexjoint.simulation.trajectory import Trajectory


class LiveRun:
    """Steps by the driver, which has the rows behind the present one in a window of its own.

    Args:
        compiled: the compiled model. model: a numeric one of its structure. start: where it begins.
        kept: steps whose rows are kept at least, beside those that delays look up.
    """

    def __init__(
        self, compiled: CompiledModel, model: FlexibleJointModel, start: State, kept: int = 2
    ) -> None:
        self._begin, self._model, self.done = start.t, model, 0
        first = compiled.history
        window = first + 1 + max(kept, 2)
        self._x, self._tau_m = np.empty((window, compiled.program.row)), np.zeros((window, len(model.joints)))
        self._x[: first + 1] = row_of(model, start)
        sizes = (model.nq, model.nv, model.nf, model.nf, model.nz, model.nv, model.nf, len(model.rigid))
        self._parts = [slice(*pair) for pair in pairwise(np.cumsum([0, *sizes]).tolist())]
        run = self._run = DriverRun()
        run.x, run.tau_m = self._x.ctypes.data, self._tau_m.ctypes.data
        run.window, run.first, run.stride, run.q_ref, run.fill = window, first, 1, -1, 1
        run.h, run.t_start, run.t = 1.0 / compiled.rate, start.t, start.t
        self.use(compiled)

    def use(self, compiled: CompiledModel) -> None:
        """Go on with this program, whose state must have the same form."""
        self._compiled, run = compiled, self._run
        self._y = np.empty((run.window, max(compiled.program.readings, 1)))
        run.y, run.fresh = self._y.ctypes.data, 1
        run.command_delay = run.reading_delay = None  # those of the program before
        run.tick_count, run.tick_steps = compiled.ticks.ratio

    @property
    def time(self) -> float:
        """The present time [s], as the time of a trajectory."""
        return float(self._begin + self.done / self._compiled.rate)

    @property
    def last_command(self) -> np.ndarray:
        """(n,) the motor torque commanded last."""
        return np.array(self._tau_m[(self._run.first + self.done - 1) % self._run.window])

    @property
    def x(self) -> State:
        """A copy of the present state."""
        row = self._x[(self._run.first + self.done) % self._run.window]
        q, v, theta, dtheta, z, acc, ddtheta, tau_rigid = (row[part].copy() for part in self._parts)
        return State(self._run.t, q, v, theta, dtheta, z, acc, ddtheta, tau_rigid)

    def advance(self, steps: int, values: np.ndarray, reference: np.ndarray, gains: np.ndarray) -> None:
        """So many steps with parameters and gains (see CompiledModel) and a row of references that stay.

        Raises SimulationError where numbers are no longer finite, or a step does not converge.
        """
        self._run.reference, self._run.reference_step = reference.ctypes.data, 0
        self._run.gains = gains.ctypes.data
        self._take(self.done + steps, values)

    def along(
        self, end: int, values: np.ndarray, drive: np.ndarray, origin: int, gains: np.ndarray
    ) -> Trajectory:
        """The steps up to a number, at most `kept`, along rows of references, or of torques where there is no
        law, of which the first is that of tick `origin` (of torques: of step `origin`). Returns their rows,
        with those before that delays look up.

        Raises as `advance` does.
        """
        run, compiled, begin = self._run, self._compiled, self.done
        drive = np.ascontiguousarray(drive, dtype=float)
        place = drive.ctypes.data - origin * drive.shape[1] * drive.itemsize
        run.gains = gains.ctypes.data
        if compiled.law_kind is None:
            run.torque = place
        else:
            run.reference, run.reference_step = place, drive.shape[1]
        self._take(end, values)
        rows = np.arange(begin, run.first + end + 1)
        time = self._begin + (rows - run.first) / compiled.rate
        tau_m = self._tau_m[rows % run.window]
        tau_m[-1] = tau_m[-2]
        return compiled.tape_of(time, self._x[rows % run.window], tau_m, run.first)

    def _take(self, end: int, values: np.ndarray) -> None:
        run, compiled, before = self._run, self._compiled, lost_by(self._run, 0)
        (failed,) = compiled.take_steps(run, [values], self.done, end)
        lost = lost_by(run, 0)
        if lost and not before and failed < 0:
            warn_of_order_one(*lost, compiled.rate)
        if failed < 0:
            self.done = end
        elif run.worst >= 0:
            self.done = failed
            raise not_converged(self._model, run.t, run.h, run.worst)
        else:
            self.done = failed + 1
            raise diverged(self._model, self.x.v, self.time, compiled.options.scheme, compiled.rate)
