"""A model's clockwork compiled to C, and runs of it.

The C program depends on the structure of a model (robot, effects, law, scheme, rate) and not on its
numbers, so all models of one structure share it.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.parameters import model_parameters, numbers
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.simulation.compiled.cache import load
from flexjoint.simulation.compiled.compiler import Compiler
from flexjoint.simulation.compiled.lanes import aligned, side_by_side
from flexjoint.simulation.compiled.program import Program, c_program, numbers_of, write_program
from flexjoint.simulation.controllers import Law
from flexjoint.simulation.loop import Ticks, diverged, segments
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.schemes.implicit import not_converged
from flexjoint.simulation.schemes.midpoint import warn_of_order_one
from flexjoint.simulation.trajectory import Past, Trajectory

RATES_FREE = ("drives",)  # numbers of the model that a compiled right-hand side takes as parameters
SHORT = -2  # what driver.c returns where memory is short
MOST = 8  # lanes that it takes


class DriverRun(ctypes.Structure):
    """fj_run of driver.c, field by field."""

    _fields_ = (
        *(
            (name, ctypes.c_void_p)
            for name in (
                "x",
                "tau_m",
                "y",
                "constants",
                "torque",
                "reference",
                "gains",
                "command_delay",
                "reading_delay",
                "kept_x",
                "kept_tau_m",
                "summary",
            )
        ),
        *(
            (name, ctypes.c_longlong)
            for name in (
                "window",
                "first",
                "begin",
                "end",
                "tick_count",
                "tick_steps",
                "reference_step",
                "fresh",
                "stride",
                "q_ref",
                "worst",
                "fill",
                "drive_lane",
                "kept_lane",
            )
        ),
        *((name, ctypes.c_longlong * MOST) for name in ("failed", "lost")),
        ("turned", ctypes.c_double * MOST),
        *((name, ctypes.c_double) for name in ("t_start", "t", "h")),
    )


@dataclass(frozen=True)
class Phase:
    """The program of the spans of time in which the same effects act."""

    program: Program
    library: ctypes.CDLL
    delays: ca.Function  # of the parameters: (n,) of commands, (readings,) of readings [s]


@dataclass(frozen=True, kw_only=True)
class Job:
    """What one run needs, checked and in the layout of the program.

    row (row,) state at the start and t its time [s]; values (parameters,); drive (steps, n) torques, or
    (ticks, reference) references; gains (gain,); before: rows before the start, if they are known.
    """

    row: np.ndarray
    t: float
    values: np.ndarray
    drive: np.ndarray
    gains: np.ndarray
    steps: int
    before: tuple[np.ndarray, np.ndarray] | None = None  # (H, row) states and (H, n) commands


@dataclass(frozen=True, kw_only=True)
class Rows:
    """What a run leaves: states (R, row) and commands (R, n) of the kept rows (of the whole tape, where all
    are kept, with the `first` ones before the start); final (row,); summary (4, observed): least, largest,
    sum and sum of squares over the steps; failed: the step that left the finite numbers, or did not converge
    (worst is the place of its worst unknown then, else -1), or -1; lost: the time [s] of the first step that
    did not follow its motion, and the most [rad] by which a link turned within such a step."""

    states: np.ndarray
    tau_m: np.ndarray
    final: np.ndarray
    summary: np.ndarray | None
    first: int
    failed: int
    worst: int = -1
    lost: tuple[float, float] | None = None


class CompiledModel:
    """The compiled clockwork of all models of one structure.

    Args:
        model: a numeric model; its structure counts, not its numbers.
        options: rate, scheme and width count.
        law, references: of a closed loop, with the names that a row of references holds; without a law runs
            take given torques.
        free, commanded: see `SymbolicModel`.
        many: run several jobs side by side, in `lanes` of the processor's registers.
        compiler: default: the first that works.

    Raises:
        CompilerError: no compiler, or it fails.
        ModelError, SimulationError: the structure has no symbolic model (see `SymbolicModel`).
    """

    def __init__(
        self,
        model: FlexibleJointModel,
        options: RunOptions = DEFAULTS,
        *,
        law: Law | None = None,
        references: Sequence[str] = (),
        free: Collection[str] = ("drives",),
        commanded: Collection[str] = (),
        many: bool = False,
        compiler: Compiler | None = None,
    ) -> None:
        rate = self.rate = options.rate_for(model.robot)
        self.options, self.free, self.commanded = options, tuple(free), tuple(commanded)
        self.law_kind = type(law) if law is not None else None
        self._layout = model  # for sizes, names and effects' onsets
        self.ticks = Ticks(rate, rate if law is None else model.robot.rates.control)
        longest = longest_delay(model)
        self.history = math.ceil(longest * rate - 1e-9) + 1 if longest > 0.0 else 0
        self._late = any(flow.max_command_delay > 0.0 for _, phase in model.phases for flow in phase.flows)

        def made(at: float | None) -> Phase:
            symbolic = SymbolicModel(
                model.robot,
                model.effects,
                free=self.free,
                at=at,
                springs=model.springs,
                commanded=self.commanded,
            )
            program = write_program(symbolic, options, law, references, many)
            self.compiler, loaded = _load(program, compiler)
            self.parameters: tuple[str, ...] = symbolic.parameters
            return Phase(program, loaded, _delays(symbolic, program))

        self.phases = tuple(phase for _, phase in model.by_phase(made)) if model.onsets else (made(None),)
        self.program = self.phases[0].program
        self.lanes: int = self.phases[0].library.flexjoint_lanes()
        self.delayed = any(
            flow.max_reading_delay(channel) > 0.0
            for _, phase in model.phases
            for flow in phase.flows
            for channel in self.program.reads
        ) or (bool(self.program.reads) and model.robot.file.sensing_delay > 0.0)
        self._sensing = model.robot.file.sensing_delay

    # --- jobs ------------------------------------------------------------------------------------
    def values(
        self, model: FlexibleJointModel, springs: Mapping[str, tuple[float, float]] | None = None
    ) -> np.ndarray:
        """(parameters,) numbers of a model of this structure, in the order of `parameters`; springs:
        stiffness and damping of commanded joints."""
        own = numbers(model_parameters(model.robot, model.effects, self.free))
        commanded = [number for name in self.commanded for number in (springs or {})[name]]
        return np.concatenate([own, commanded])

    def gains(self, law: Law | None) -> np.ndarray:
        """(gain,) numbers of a law of this kind."""
        if law is None:
            return np.zeros(0)
        return np.concatenate([np.zeros(0), *numbers_of(law).values()])

    def references(self, references: Mapping[str, np.ndarray]) -> np.ndarray:
        """(ticks, reference) rows of references (ticks, n) by name."""
        columns = [np.asarray(references[name], dtype=float) for name in self.program.references]
        return np.hstack(columns)

    def before(self, model: FlexibleJointModel, start: State, past: Past) -> tuple[np.ndarray, np.ndarray]:
        """Rows of what went before a start."""
        rows = np.tile(row_of(model, start), (len(past.tau_m), 1))
        nq, nv, nf = model.nq, model.nv, model.nf
        rows[:, : nq + nv + 2 * nf] = np.hstack([past.q, past.v, past.theta, past.dtheta])
        return rows, np.asarray(past.tau_m, dtype=float)

    # --- runs ------------------------------------------------------------------------------------
    def run(self, job: Job, stride: int = 0, summary: bool = False) -> Rows:
        """Run a job; see `run_all`."""
        return self.run_all([job], stride, summary)[0]

    def run_all(self, jobs: Sequence[Job], stride: int = 0, summary: bool = False) -> list[Rows]:
        """Run as many jobs as there are lanes, or fewer, side by side; thread-safe, and other threads run
        meanwhile. The jobs begin at one time and have as many steps; none sees the others.

        Args:
            stride: 0 keeps the whole tape; k > 0 every k-th row from the start on; -1 none. Memory is flat
                in the number of steps without the whole tape.
        """
        program, n, lanes, job = self.program, self.program.inputs, self.lanes, jobs[0]
        first = self.history if job.before is None else len(job.before[1])
        whole = stride == 0
        window = first + job.steps + 1 if whole else max(first, self.history) + 3
        x, tau_m = aligned(window, program.row, lanes), aligned(window, n, lanes)
        tau_m[:] = 0.0
        x[: first + 1] = side_by_side([one.row for one in jobs], lanes)
        if job.before is not None:
            befores = [one.before for one in jobs if one.before is not None]
            x[:first] = side_by_side([states for states, _ in befores], lanes)
            tau_m[:first] = side_by_side([commands for _, commands in befores], lanes)
        kept = len(range(0, job.steps, stride)) if stride > 0 else 0
        kept_x, kept_tau_m = np.empty((lanes, kept, program.row)), np.empty((lanes, kept, n))
        sums = aligned(4, program.observed, lanes) if summary else None
        if sums is not None:
            sums[0], sums[1], sums[2:] = np.inf, -np.inf, 0.0
        run = DriverRun()
        run.x, run.tau_m, run.kept_x, run.kept_tau_m = map(_pointer, (x, tau_m, kept_x, kept_tau_m))
        run.kept_x, run.kept_lane = run.kept_x if kept else None, kept
        y = aligned(window if self.delayed else 0, program.readings, lanes)
        run.y, run.summary = _pointer(y), None if sums is None else _pointer(sums)
        drive, run.drive_lane = _drive([one.drive for one in jobs], lanes)
        gains = side_by_side([one.gains for one in jobs], lanes)
        run.gains = _pointer(gains)
        if self.law_kind is None:
            run.torque = _pointer(drive)
        else:
            run.reference = _pointer(drive)
        names = program.references
        run.q_ref = names.index("q_ref") * n if "q_ref" in names else -1
        run.window, run.first, run.stride, run.fill = window, first, max(stride, 1), job.before is None
        run.tick_count, run.tick_steps = self.ticks.ratio
        run.reference_step, run.fresh = program.reference, 1
        run.h = 1.0 / self.rate
        run.t_start = run.t = job.t
        failed = self.take_steps(run, [one.values for one in jobs], 0, job.steps)
        if whole and job.steps:
            tau_m[-1] = tau_m[-2]
        found = []
        for lane in range(len(jobs)):
            last = job.steps if failed[lane] < 0 else failed[lane] + 1
            rows = Rows(
                states=x[:, :, lane] if whole else kept_x[lane],
                tau_m=tau_m[:, :, lane] if whole else kept_tau_m[lane],
                final=x[(first + last) % window, :, lane].copy(),
                summary=None if sums is None else sums[:, :, lane],
                first=first if whole else 0,
                failed=failed[lane],
                worst=run.worst,
                lost=lost_by(run, lane),
            )
            found.append(rows)
        return found

    def take_steps(self, run: DriverRun, values: Sequence[np.ndarray], begin: int, end: int) -> list[int]:
        """The steps [begin, end) of a run, phase by phase; of each lane the step that failed, or -1.

        Args:
            values: (parameters,) of each lane.
        """
        lanes, done = self.lanes, begin
        failed = [-1] * lanes
        spans = segments(self._layout, run.t_start, end, 1.0 / self.rate)
        for phase, (_, until) in zip(self.phases, spans, strict=True):
            if until <= done:
                continue
            parameters, constants = side_by_side(values, lanes), aligned(phase.program.constants, lanes)
            phase.library.flexjoint_setup(_pointer(parameters), _pointer(constants))
            run.constants = _pointer(constants)
            if self._late or self.delayed:
                delays = [[np.array(d).ravel() * self.rate for d in phase.delays(own)] for own in values]
                command = side_by_side([own for own, _ in delays], lanes)
                reading = side_by_side([own + self._sensing * self.rate for _, own in delays], lanes)
                run.command_delay = _pointer(command) if self._late else None
                run.reading_delay = _pointer(reading) if self.delayed else None
            run.begin, run.end = done, until
            run.failed = (ctypes.c_longlong * MOST)(*[-1] * MOST)
            ended = phase.library.flexjoint_run(ctypes.byref(run))
            if ended == SHORT:
                raise MemoryError("no memory for the work space of a step")
            own = [ended] * lanes if run.worst >= 0 else run.failed[:lanes]
            failed = [now if before < 0 else before for before, now in zip(failed, own, strict=True)]
            if ended >= 0:
                break
            done = until
        return failed

    def trajectory(self, job: Job, rows: Rows) -> Trajectory:
        """The whole tape of a run; raises SimulationError where it left the finite numbers."""
        model, x = self._layout, rows.states
        time = job.t + (np.arange(len(x)) - rows.first) / self.rate
        tape = self.tape_of(time, x, rows.tau_m, rows.first)
        v, dtheta = tape.v, tape.dtheta
        if rows.worst >= 0:
            at = float(time[rows.first + rows.failed])
            raise not_converged(model, at, 1.0 / self.rate, rows.worst)
        if rows.lost and rows.failed < 0:
            warn_of_order_one(*rows.lost, self.rate)
        if rows.failed >= 0:
            taken = slice(rows.first, rows.first + rows.failed + 2)
            finite = np.isfinite(v[taken]).all(axis=1) & np.isfinite(dtheta[taken]).all(axis=1)
            row = rows.first + int(np.argmin(finite))
            raise diverged(model, v[row], float(time[row]), self.options.scheme, self.rate)
        return tape

    def tape_of(self, time: np.ndarray, states: np.ndarray, tau_m: np.ndarray, first: int) -> Trajectory:
        """The trajectory of rows (R, row) of states, `first` of which lie before the start."""
        model = self._layout
        ends = np.cumsum([0, model.nq, model.nv, model.nf, model.nf, model.nz])
        q, v, theta, dtheta, z = (states[:, a:b] for a, b in pairwise(ends))
        return Trajectory(
            time=time,
            q=q,
            v=v,
            theta=theta,
            dtheta=dtheta,
            z=z,
            tau_rigid=states[:, ends[-1] + model.nv + model.nf :],
            tau_m=tau_m,
            first=first,
        )


class RatesProgram:
    """The compiled right-hand side of all models of one structure, of the effects that are awake at `at`.

    Raises CompilerError; ModelError where the structure has no symbolic model.
    """

    def __init__(self, model: FlexibleJointModel, at: float | None, compiler: Compiler | None = None) -> None:
        symbolic = SymbolicModel(model.robot, model.effects, free=RATES_FREE, at=at, springs=model.springs)
        x, width = ca.SX.sym("x", symbolic.model.nx), ca.SX.sym("width")
        r = symbolic.model.rates(symbolic.model.unpack(x, symbolic.t), symbolic.u, width)
        out = ca.cse(ca.densify(ca.vertcat(r.acc, r.ddtheta, r.dz, r.tau_t)))
        (rest,), symbols, constant = ca.extract_parametric([out], symbolic.p, {"extract_trivial": True})
        c = ca.vertcat(ca.SX(0, 1), *symbols)
        rates = ca.Function("fj_rates", [x, symbolic.u, c, symbolic.t, width], [rest])
        setup = ca.Function("fj_setup", [symbolic.p], [ca.vertcat(ca.SX(0, 1), *constant)])
        sizes = {
            "FJ_RATES_ARG": rates.sz_arg(),
            "FJ_RATES_RES": rates.sz_res(),
            "FJ_RATES_W": rates.sz_w() + 1,
        }
        source = c_program([rates, setup], sizes, ["setup.c", "rates.c"])
        self.compiler, library = load(source, compiler)
        self._setup, self.rates = library.flexjoint_setup, library.flexjoint_rates
        self._setup.argtypes, self._setup.restype = [ctypes.c_void_p, ctypes.c_void_p], None
        self.rates.argtypes = [
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_double,
            ctypes.c_void_p,
        ]
        self.rates.restype = None
        self._constants = c.numel()
        self.model = model  # in shared.py its robot's id stands for it

    def constants(self, model: FlexibleJointModel) -> np.ndarray:
        """What follows from the numbers of a model of this structure alone."""
        values = numbers(model_parameters(model.robot, model.effects, RATES_FREE))
        constants = np.empty(max(self._constants, 1))
        self._setup(values.ctypes.data, constants.ctypes.data)
        return constants


def row_of(model: FlexibleJointModel, state: State) -> np.ndarray:
    """(row,) of a numeric state."""
    return np.concatenate([model.pack(state), state.acc, state.ddtheta, state.tau_rigid])


def lost_by(run: DriverRun, lane: int) -> tuple[float, float] | None:
    """When a run no longer followed its motion; see Rows."""
    if not run.lost[lane]:
        return None
    return run.t_start + run.h * (run.lost[lane] - 1), run.turned[lane]


def _delays(symbolic: SymbolicModel, program: Program) -> ca.Function:
    flows = symbolic.model.flows
    command = ca.vertcat(*(flow.command_delay() for flow in flows))
    reading = ca.vertcat(
        ca.SX(0, 1), *(flow.reading_delay(channel) for channel in program.reads for flow in flows)
    )
    return ca.Function("delays", [symbolic.p], [ca.densify(ca.SX(command)), ca.densify(ca.SX(reading))])


def _load(program: Program, compiler: Compiler | None) -> tuple[Compiler, ctypes.CDLL]:
    """The program's library, by the first compiler that succeeds."""
    used, loaded = load(program.source, compiler)
    loaded.flexjoint_setup.argtypes, loaded.flexjoint_setup.restype = [ctypes.c_void_p, ctypes.c_void_p], None
    loaded.flexjoint_run.argtypes = [ctypes.POINTER(DriverRun)]
    loaded.flexjoint_run.restype = ctypes.c_longlong
    return used, loaded


def _drive(drives: Sequence[np.ndarray], lanes: int) -> tuple[np.ndarray, int]:
    """Torques or references of all lanes, and how many numbers lie from one lane's to the next one's: 0 where
    all share them."""
    if all(drive is drives[0] for drive in drives):
        return np.ascontiguousarray(drives[0]), 0
    rows = [drives[min(lane, len(drives) - 1)] for lane in range(lanes)]
    return np.stack(rows), rows[0].size


def _pointer(values: np.ndarray) -> int:
    return values.ctypes.data
