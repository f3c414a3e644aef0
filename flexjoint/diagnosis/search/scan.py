"""First-order score of every candidate on top of a set of effects, with its onset scanned alongside.

Candidates are shared out to processes in parts that do not depend on how many there are, and a trace depends
on nothing but its candidate and the effects of its own joint: the bits are the same for any number.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexjoint.core.running.budget import checkpoint
from flexjoint.core.running.worker_pool import WorkerPool
from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.whitening import Band
from flexjoint.diagnosis.search.candidates import Candidate, Trace, may_replace, traces
from flexjoint.diagnosis.settings import SearchSettings
from flexjoint.effects import Planned

RUNS_AWAY = 1e15  # N m: no machine has such torques, but a spring that its load turns over gives them
INVISIBLE = 1e-6  # noise deviations: a smaller trace is rounding
RIDGE = 1e-7  # of a tangent of unit length
MEMORY = 1.6e8  # bytes of the tolerances' columns and of traces that are remembered between scans
ROUNDED = 256.0  # steps to which a number's mantissa (0.5 to 1) is rounded
PART = 6  # candidates that are taken at a time
BATCH = 16  # columns whose products are taken together


@dataclass(frozen=True)
class Scored:
    """A candidate at its best start and onset, and the energy that it would remove to first order. The
    trace's columns are not kept."""

    trace: Trace
    amplitude: np.ndarray
    removes: float
    since: float | None
    sight: float  # size of the whole record's trace, in deviations of the sensors' noise

    @property
    def candidate(self) -> Candidate:
        return self.trace.candidate

    def planned(self) -> Planned:
        return self.candidate.planned(self.trace.values(self.amplitude), self.since)


@dataclass(frozen=True)
class _Kept:
    """A trace with its columns before they are whitened, which is fast and makes them larger; kept in single
    precision, as there are many."""

    trace: Trace  # without columns
    bands: tuple[Band, ...]
    first: int  # the first balance that it changes
    sight: float

    @property
    def nbytes(self) -> int:
        return sum(band.nbytes for band in self.bands)

    def columns(self) -> np.ndarray:
        """(k, rows - first, K) whitened, from the first balance on."""
        return np.array([self.trace.whitening.white_from(band, self.first) for band in self.bands])

    def columns_in(self, row: int) -> np.ndarray:
        """(k, K) whitened, in one balance."""
        return np.array([self.trace.whitening.white_in(band, row) for band in self.bands])


@dataclass(frozen=True)
class _Traced:
    """A trace of a candidate (by number), its columns (k, rows - first, K), and the fits that it is of."""

    candidate: int
    kept: _Kept
    columns: np.ndarray
    places: tuple[int, ...]


@dataclass(frozen=True)
class Products:
    """The traces of some candidates all along the record, and the products of their n columns with each other
    and with what is left, after the free numbers and the nominal ones have taken their part."""

    traces: tuple[Trace, ...]  # without columns
    places: tuple[slice, ...]  # of their columns
    curvature: np.ndarray  # (n, n)
    force: np.ndarray  # (n,)
    squares: np.ndarray  # (n,) of the columns before

    def visible(self) -> list[int]:
        """The numbers of the traces of which each column is more than rounding."""
        left = np.diag(self.curvature)
        seen = (left >= INVISIBLE**2) & (left >= RIDGE * self.squares)
        return [k for k, place in enumerate(self.places) if np.all(seen[place])]


@dataclass(frozen=True)
class _Share:
    """The candidates, by their numbers and in parts, that one of several processes scans on top of some
    fits."""

    parts: tuple[tuple[int, ...], ...]
    currents: tuple[Fit, ...]
    processes: int
    replaced: Planned | None  # only candidates that may take its place are scanned; None: all


class Scanner:
    """Scans candidates; traces that an added effect does not touch are remembered."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = candidates
        # joint by joint: columns that begin at the same balance make one product
        joints = list(dict.fromkeys(c.joint for c in candidates))
        order = sorted(range(len(candidates)), key=lambda k: joints.index(candidates[k].joint))
        self._parts = [tuple(order[k : k + PART]) for k in range(0, len(order), PART)]
        self._traces: dict[object, list[_Kept]] = {}
        self._bytes = 0

    def scan(
        self, current: Fit, pool: WorkerPool | None = None, replaced: Planned | None = None
    ) -> tuple[Scored, ...]:
        """Best start of every candidate on top of a fitted set, best first; where an effect is to be
        `replaced`, of those that may."""
        return self.scans([current], pool, replaced)[0]

    def scans(
        self, currents: Sequence[Fit], pool: WorkerPool | None = None, replaced: Planned | None = None
    ) -> list[tuple[Scored, ...]]:
        """The same on top of each of some fits of one set: traces that they share are made once. A pool that
        knows the scanner shares the work; each of it remembers what it made."""
        count = 1 if pool is None else pool.size
        shares = [
            _Share(tuple(self._parts[k::count]), tuple(currents), count, replaced) for k in range(count)
        ]
        found = [self.scored(shares[0])] if pool is None else pool.each(self.scored, shares)
        out = []
        for k in range(len(currents)):
            best = [pair for share in found for pair in share[k].items()]
            out.append(tuple(one for _, one in sorted(best, key=lambda pair: (-pair[1].removes, pair[0]))))
        return out

    def scored(self, share: _Share) -> list[dict[int, Scored]]:
        """The best start of each candidate of a share, by its number, against each of some fits."""
        against = [_Against(current) for current in share.currents]
        best: list[dict[int, Scored]] = [{} for _ in against]
        taken = {e.key for e in share.currents[0].effects}
        joints = share.currents[0].problem.robot.joint_names
        for part in share.parts:
            checkpoint()
            waiting = [k for k in part if self.candidates[k].key not in taken]
            if share.replaced is not None:
                waiting = [k for k in waiting if may_replace(self.candidates[k], share.replaced, joints)]
            every = (t for k in waiting for t in self._traced(k, against, share.processes))
            for batch in _batches(every):
                self._score_batch(batch, against, best)
        return best

    def products(self, current: Fit, joint: str) -> Products:
        """All traces of the effects within a joint on top of a fitted set, except those that have a start."""
        against = _Against(current)
        taken = {e.key for e in current.effects}
        seen: list[_Kept] = []
        for k, candidate in enumerate(self.candidates):
            checkpoint()
            if candidate.joint != joint or candidate.key in taken or not acts_within_a_joint(candidate):
                continue
            traced = self._traced(k, [against], 1)
            seen += [t.kept for t in traced if t.kept.trace.since is None]
        traces, width = tuple(kept.trace for kept in seen), [len(kept.bands) for kept in seen]
        ends = np.cumsum([0, *width])
        places = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        rows = range(min((kept.first for kept in seen), default=against.rows), against.rows)
        by_row = ((row, np.concatenate([kept.columns_in(row) for kept in seen])) for row in rows)
        return Products(traces, places, *against.whole(int(ends[-1]), by_row))

    def _score_batch(
        self, batch: Sequence[_Traced], against: Sequence[_Against], best: Sequence[dict[int, Scored]]
    ) -> None:
        """Enter into `best` the best start of each candidate of a batch, by its number, for each fit."""
        fixed = against[batch[0].places[0]].fixed(batch)
        settings = against[0].current.settings.search
        for place in batch[0].places:
            products = against[place].tails(batch, fixed)
            for traced, (curvature, force) in zip(batch, products, strict=True):
                scored = _score(traced.kept, curvature, force, against[place].starts, settings)
                k = traced.candidate
                if scored is not None and (k not in best[place] or scored.removes > best[place][k].removes):
                    best[place][k] = scored

    def _traced(self, k: int, against: Sequence[_Against], processes: int) -> Iterator[_Traced]:
        """The traces of candidate k, one per start, for each of some fits of one set. To first order a trace
        is the same beside other numbers of the set: those of the last fit are taken; only a body's, which is
        fitted to the residual, is made for each."""
        candidate, every = self.candidates[k], range(len(against))
        apart = candidate.effect.overrides("edit_inertial")
        for places in [(place,) for place in every] if apart else [tuple(every)]:
            for kept, columns in self._kept(candidate, against[places[-1]], processes):
                yield _Traced(k, kept, columns, places)

    def _kept(
        self, candidate: Candidate, against: _Against, processes: int
    ) -> Iterator[tuple[_Kept, np.ndarray]]:
        current, base = against.current, against.base
        problem, own = current.problem, against.around(candidate)
        if candidate.effect.overrides("edit_inertial"):
            yield from (_kept(t) for t in _bounded_traces(problem, candidate, base, current.y))
            return
        key = (candidate.key, candidate.words, *(e.identity for e in own))
        if key in self._traces:
            yield from ((kept, kept.columns()) for kept in self._traces[key])
            return
        remembered: list[_Kept] | None = []
        # beside the tolerances' columns, each process has its share of the memory
        room = (MEMORY - 8 * len(problem.nuisance) * problem.samples) / processes
        for trace in _bounded_traces(problem, candidate, own, current.y):
            kept, columns = _kept(trace)
            yield kept, columns
            if remembered is not None:
                remembered.append(kept)
                self._bytes += kept.nbytes
                if self._bytes > room:
                    self._bytes -= sum(k.nbytes for k in remembered)
                    remembered = None
        if remembered is not None:
            self._traces[key] = remembered


def _bounded_traces(
    problem: Problem, candidate: Candidate, base: Sequence[Planned], y: np.ndarray
) -> Iterator[Trace]:
    """The traces of a candidate that do not run away."""
    for trace in traces(problem, candidate, base, y):
        if all(np.all(np.abs(band.spectra) < RUNS_AWAY) for band in trace.bands):
            yield trace


def _kept(trace: Trace) -> tuple[_Kept, np.ndarray]:
    first = min((band.first for band in trace.bands if band.rows.size), default=0)
    bands = tuple(Band(band.rows, band.spectra.astype(np.complex64)) for band in trace.bands)
    kept = _Kept(replace(trace, bands=()), bands, first, 0.0)
    columns = kept.columns()
    return replace(kept, sight=float(np.sqrt(np.max(np.einsum("krt,krt->k", columns, columns))))), columns


def _batches(every: Iterator[_Traced]) -> Iterator[list[_Traced]]:
    """Neighbours of the same fits that begin at the same balance, up to BATCH columns at a time."""
    batch: list[_Traced] = []
    width = 0
    for traced in every:
        width += len(traced.columns)
        alike = batch and (traced.kept.first, traced.places) == (batch[0].kept.first, batch[0].places)
        if batch and (not alike or width > BATCH):
            yield batch
            batch, width = [], len(traced.columns)
        batch.append(traced)
    if batch:
        yield batch


def _score(
    kept: _Kept, curvature: np.ndarray, force: np.ndarray, starts: np.ndarray, settings: SearchSettings
) -> Scored | None:
    """Solve for the amplitudes at every possible onset and keep the best. `curvature` (blocks, k, k) and
    `force` (blocks, k) are those of the columns switched on at each block's start."""
    trace = kept.trace
    size = np.sqrt(np.maximum(np.einsum("bkk->bk", curvature), 0.0))
    if not np.all(np.isfinite(size)) or np.any(size[0] < INVISIBLE):
        return None
    size = np.maximum(size, 1e-9)
    scaled = curvature / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(size.shape[1])
    amplitude = -np.linalg.solve(scaled, (force / size)[:, :, None])[:, :, 0] / size
    amplitude = _bounded(bounds_of(trace, settings), amplitude, curvature, force)
    removes = -(2.0 * np.sum(amplitude * force, axis=1))
    removes -= np.einsum("bk,bkl,bl->b", amplitude, curvature, amplitude)
    at = int(np.argmax(removes))
    if trace.since is not None:
        return Scored(trace, amplitude[0], float(removes[0]), trace.since, kept.sight)
    always = trace.candidate.joint is None or trace.candidate.effect.for_rigid
    if always or removes[at] - removes[0] < settings.onset_margin * abs(removes[at]):
        at = 0
    since = None if at == 0 else float(starts[at])
    return Scored(trace, amplitude[at], float(removes[at]), since, kept.sight)


def onset_margin(seconds: float, settings: SearchSettings) -> float:
    """[s] beside the ends of a recording of so many seconds, where no onset is looked for."""
    return min(settings.onset_seconds, settings.onset_share * seconds)


class _Against:
    """Residual, nuisance and tangents of the current set, with sums over the tail of the record."""

    def __init__(self, current: Fit) -> None:
        problem = current.problem
        self.current, self.base = current, problem.with_nominal(current.effects)
        self._rounded = problem.with_nominal([rounded(e) for e in current.effects])
        self.rows = len(problem.balances.rows)
        time = problem.time
        even = np.linspace(time[0], time[-1], current.settings.search.onset_blocks + 1)[:-1]
        beside = onset_margin(time[-1] - time[0], current.settings.search)
        seen = (even >= time[0] + beside) & (even <= time[-1] - beside)
        edges = np.unique(np.searchsorted(time, [time[0], *even[seen]]))
        self.starts = problem.balances.chains.t[0] + time[edges]
        fixed, free = len(problem.nuisance), len(current.tangents)
        tangents = current.tangents * problem.weights
        size = np.maximum(np.sqrt(np.sum(tangents**2, axis=1)), 1e-9)[:, None]
        tangents = tangents / size
        y = current.y * problem.weights
        gram = np.zeros((fixed + free, fixed + free))
        gram[:fixed, :fixed] = problem.gram
        pull = problem.pull(current.y)
        if free:
            gram[fixed:, :fixed] = problem.across(tangents * problem.weights)
            gram[fixed:, fixed:] = tangents @ tangents.T
            gram[:fixed, fixed:] = gram[fixed:, :fixed].T
            # tangents are free; a ridge for rounding, and for numbers without any trace
            gram[range(fixed, fixed + free), range(fixed, fixed + free)] += RIDGE
            pull = np.concatenate([pull, tangents @ y])
        self.factor = cho_factor(gram)
        self.pulled = cho_solve(self.factor, pull)
        self.squares = problem.squares.reshape(self.rows, -1)
        ends = [*edges[1:], time.size]
        self.slices = [slice(a, b) for a, b in zip(edges, ends, strict=True)]
        # what columns are multiplied by beside the nominal numbers' plain ones: tangents, residual, and the
        # nominal numbers' columns that effects change, (p, rows, samples)
        moves = problem.moves
        self.moved = moves.numbers
        free_part = np.concatenate([current.tangents / size, current.y[None], moves.columns])
        self.free = free_part.reshape(len(free_part), self.rows, time.size)

    def around(self, candidate: Candidate) -> list[Planned]:
        """The effects on whose top a candidate's traces are taken, with rounded numbers."""
        return self.current.problem.balances.beside(self._rounded, candidate.planned({}))

    def whole(
        self, count: int, by_row: Iterable[tuple[int, np.ndarray]]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Projected curvature (n, n) and force (n,) of so many columns, all along the record, and their
        squares (n,) before they are projected; the columns (n, K) come balance by balance."""
        problem, free = self.current.problem, len(self.free) - len(self.moved) - 1
        own, beside = np.zeros((count, count)), np.zeros((count, len(self.free)))
        plain = np.zeros((count, len(problem.nuisance)))
        for row, columns in by_row:
            weighted = columns * self.squares[row]
            own += weighted @ columns.T
            beside += weighted @ self.free[:, row].T
            plain += problem.across_part(weighted, row, slice(None))
        plain[:, self.moved] = beside[:, free + 1 :]
        through = np.hstack([plain, beside[:, :free]])
        curvature = own - through @ cho_solve(self.factor, through.T)
        return curvature, beside[:, free] - through @ self.pulled, np.diag(own)

    def fixed(self, batch: Sequence[_Traced]) -> np.ndarray:
        """(blocks, rows - first, k, numbers) products of the columns with the nominal numbers' plain ones, as
        yet without weights: the same for any fit of one set."""
        problem, first = self.current.problem, batch[0].kept.first
        out = []
        for s in self.slices:
            columns = np.concatenate([traced.columns[:, :, s] for traced in batch]) * problem.used[s]
            by_row = enumerate(columns.transpose(1, 0, 2), start=first)
            out.append([problem.across_part(part, r, s) for r, part in by_row])
        return np.array(out)

    def tails(self, batch: Sequence[_Traced], fixed: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Projected curvature and force of each trace's columns, switched on at each block's start. The
        traces begin at the same balance."""
        first, free = batch[0].kept.first, len(self.free) - len(self.moved)
        plain = np.tensordot(self.current.problem.by_row[first:], fixed, (0, 1))
        own, across = [], []
        for s, by_plain in zip(self.slices, plain, strict=True):
            columns = np.concatenate([traced.columns[:, :, s] for traced in batch])
            weighted = columns * self.squares[first:, s]
            weighted = weighted.reshape(len(columns), -1)
            own.append(weighted @ columns.reshape(len(columns), -1).T)
            beside = weighted @ self.free[:, first:, s].reshape(len(self.free), -1).T
            by_plain[:, self.moved] = beside[:, free:]
            across.append(np.hstack([by_plain, beside[:, :free]]))
        curvature, both = (np.cumsum(np.array(x)[::-1], axis=0)[::-1] for x in (own, across))
        through, with_y = both[:, :, :-1], both[:, :, -1]
        solved = cho_solve(self.factor, through.reshape(-1, through.shape[2]).T).T.reshape(through.shape)
        force = with_y - through @ self.pulled
        out, start = [], 0
        for traced in batch:
            k = slice(start, start + len(traced.columns))
            start = k.stop
            out.append((curvature[:, k, k] - through[:, k] @ solved[:, k].transpose(0, 2, 1), force[:, k]))
        return out


def rounded(e: Planned) -> Planned:
    """An effect with its numbers rounded: a trace on top of it is hardly another one, and need not be made
    anew where numbers have moved by little."""
    values = {}
    for param in e.effect.params:
        numbers = np.ravel(e.values[param.name])
        _, exponent = np.frexp(np.max(np.abs(numbers)))  # a vector's small components matter as little
        near = np.ldexp(np.round(np.ldexp(numbers, -exponent) * ROUNDED) / ROUNDED, exponent)
        values[param.name] = float(near[0]) if param.size == 1 else tuple(map(float, near))
    return e.with_values(values)


def _bounded(
    bounds: np.ndarray, amplitude: np.ndarray, curvature: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """(blocks, k) amplitudes within bounds (2, k): where one is at its bound, the others are solved again."""
    out = np.clip(amplitude, *bounds)
    for block in np.flatnonzero(np.any(out != amplitude, axis=1)):
        free = out[block] == amplitude[block]
        if not np.any(free):
            continue
        pull = force[block][free] + curvature[block][np.ix_(free, ~free)] @ out[block][~free]
        own = curvature[block][np.ix_(free, free)]
        size = np.maximum(np.sqrt(np.maximum(np.diag(own), 0.0)), 1e-9)
        scaled = own / np.outer(size, size) + 1e-9 * np.eye(size.size)
        out[block][free] = -np.linalg.solve(scaled, pull / size) / size
    return np.clip(out, *bounds)


def bounds_of(trace: Trace, settings: SearchSettings) -> np.ndarray:
    """(2, k) least and most amplitudes of a trace's columns."""
    if trace.kind == "whole":
        return np.array([[0.0], [settings.most_amplitude]])
    limits = {p.name: (p.low, p.high) for p in trace.candidate.effect.params}
    if trace.kind == "phase":
        return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    ends = [
        sorted((end - trace.origin[name]) / trial for end in limits[name])
        for name, trial in trace.trial.items()
    ]
    return np.array(ends).T
