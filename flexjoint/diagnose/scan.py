"""First-order score of every candidate on top of a set of effects, with its onset scanned alongside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexjoint.diagnose.candidates import Candidate, Trace, traces
from flexjoint.diagnose.chain import identity
from flexjoint.diagnose.fit import Fit
from flexjoint.effect import Planned

BLOCKS = 16  # time blocks at whose edges an onset is tried
ONSET_MARGIN = 0.05  # share by which a dated trace must be better to be preferred
RIDGE = 1e-7  # of a tangent of unit length
MEMORY = 4e8  # bytes of traces that are remembered between scans


@dataclass(frozen=True)
class Scored:
    """A candidate at its best start and onset, and the energy that it would remove to first order."""

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


class Scanner:
    """Scans candidates; traces that an added effect does not touch are remembered."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.candidates = candidates
        self._traces: dict[object, list[Trace]] = {}
        self._bytes = 0

    def scan(self, current: Fit) -> tuple[Scored, ...]:
        """Best start of every candidate on top of a fitted set, best first."""
        workspace = current.workspace
        base = workspace.with_nominal(current.effects)
        taken = {e.key for e in current.effects}
        against = _Against(current)
        best: dict[object, Scored] = {}
        for candidate in self.candidates:
            if candidate.key in taken:
                continue
            for trace in self._traces_of(candidate, base, current):
                scored = _score(trace, against)
                key = (candidate.key, candidate.words)
                if scored is not None and (key not in best or scored.removes > best[key].removes):
                    best[key] = scored
        return tuple(sorted(best.values(), key=lambda s: -s.removes))

    def _traces_of(self, candidate: Candidate, base: Sequence[Planned], current: Fit) -> list[Trace]:
        # a trace depends on the effects of its own joint only (a body's is fitted to the residual)
        if candidate.effect.overrides("edit_inertial"):
            return traces(current.workspace, candidate, base, current.y)
        key = (candidate.key, candidate.words, *(identity(e) for e in base if e.joint == candidate.joint))
        if key not in self._traces:
            found = traces(current.workspace, candidate, base, current.y)
            self._bytes += sum(trace.columns.nbytes for trace in found)
            if self._bytes > MEMORY:
                return found
            self._traces[key] = found
        return self._traces[key]


def _score(trace: Trace, against: _Against) -> Scored | None:
    """Solve for the amplitudes at every possible onset and keep the best."""
    curvature, force = against.tails(trace.columns)  # (blocks, k, k), (blocks, k)
    size = np.sqrt(np.maximum(np.einsum("bkk->bk", curvature), 0.0))
    if not np.all(np.isfinite(size)) or np.any(size[0] < 1e-6):
        return None
    size = np.maximum(size, 1e-9)
    scaled = curvature / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(size.shape[1])
    amplitude = -np.linalg.solve(scaled, (force / size)[:, :, None])[:, :, 0] / size
    if trace.kind == "whole":
        amplitude = np.clip(amplitude, 0.0, 1.5)
    elif trace.kind == "amplitudes":
        amplitude = _within_bounds(trace, amplitude)
    removes = -(2.0 * np.sum(amplitude * force, axis=1))
    removes -= np.einsum("bk,bkl,bl->b", amplitude, curvature, amplitude)
    at = int(np.argmax(removes))
    if trace.candidate.joint is None or removes[at] - removes[0] < ONSET_MARGIN * abs(removes[at]):
        at = 0
    since = None if at == 0 else float(against.starts[at])
    sight = float(np.sqrt(np.max(np.sum(trace.columns**2, axis=1))))
    return Scored(trace, amplitude[at], float(removes[at]), since, sight)


class _Against:
    """Residual, nuisance and tangents of the current set, with sums over the tail of the record."""

    def __init__(self, current: Fit) -> None:
        workspace = current.workspace
        self.rows = len(workspace.balances.rows)
        time = workspace.time
        even = np.linspace(time[0], time[-1], BLOCKS + 1)[:-1]
        self.edges = edges = np.unique(np.searchsorted(time, even))
        self.starts = workspace.balances.chains.t[0] + time[edges]
        fixed, free = len(workspace.J), len(current.tangents)
        tangents = current.tangents * workspace.weights
        tangents = tangents / np.maximum(np.sqrt(np.sum(tangents**2, axis=1)), 1e-9)[:, None]
        columns = np.concatenate([workspace.weighted, tangents]) if free else workspace.weighted
        y = current.y * workspace.weights
        gram = np.zeros((fixed + free, fixed + free))
        gram[:fixed, :fixed] = workspace.gram
        if free:
            gram[fixed:] = tangents @ columns.T
            gram[:, fixed:] = gram[fixed:].T
            # tangents are free; a ridge for rounding, and for numbers without any trace
            gram[range(fixed, fixed + free), range(fixed, fixed + free)] += RIDGE
        self.factor = cho_factor(gram)
        pull = columns @ y
        self.weighted = cho_solve(self.factor, pull)
        self.weights = workspace.weights.reshape(self.rows, -1)
        ends = [*edges[1:], workspace.time.size]
        self.slices = [slice(a, b) for a, b in zip(edges, ends, strict=True)]
        split = columns.reshape(len(columns), self.rows, -1)
        self.columns = [np.ascontiguousarray(split[:, :, s].reshape(len(columns), -1)) for s in self.slices]
        self.y = y.reshape(self.rows, -1)

    def tails(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Projected curvature and force of columns that are switched on at each block's start."""
        k = len(columns)
        split = columns.reshape(k, self.rows, -1) * self.weights
        own = np.einsum("arx,brx->abx", split, split, optimize=True)
        own = np.add.reduceat(own, self.edges, axis=-1).transpose(2, 0, 1)
        with_y = np.add.reduceat(np.sum(split * self.y, axis=1), self.edges, axis=-1).T
        across = np.stack(
            [split[:, :, s].reshape(k, -1) @ c.T for s, c in zip(self.slices, self.columns, strict=True)]
        )
        own, with_y, across = (np.cumsum(x[::-1], axis=0)[::-1] for x in (own, with_y, across))
        flat = across.reshape(-1, across.shape[2])
        solved = cho_solve(self.factor, flat.T).T.reshape(across.shape)
        return own - np.einsum("bkp,blp->bkl", across, solved), with_y - across @ self.weighted


def _within_bounds(trace: Trace, amplitude: np.ndarray) -> np.ndarray:
    limits = {p.name: (p.low, p.high) for p in trace.candidate.effect.params}
    out = amplitude.copy()
    for k, (name, trial) in enumerate(trace.trial.items()):
        low, high = limits[name]
        value = np.clip(trace.origin[name] + out[:, k] * trial, low, high)
        out[:, k] = (value - trace.origin[name]) / trial
    return out
