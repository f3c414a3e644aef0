"""Numbers of named causes refined by output error: the simulation is fitted to the readings themselves.

The balances name the causes; here only their numbers move. Windows are simulated from start states of their
own (`shooting`), residuals are readings minus simulation over their noise, nominal numbers move within
their tolerances, and Gauss-Newton steps use exact sensitivities (Ljung 1999, chapter 7; Bock 1983).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import SimulationError
from flexjoint.core.running.budget import checkpoint
from flexjoint.diagnosis.refinement.shooting import Reduced, Shooting
from flexjoint.diagnosis.regression.fit import Fit, weak_prior
from flexjoint.diagnosis.regression.uncertainty import beside_bounds
from flexjoint.effects import Planned

MOST_PASSES = 8
MOST_HALVINGS = 3
FEWEST_PASSES = 3  # before numbers that are far off end the search: the first starts are measured ones


@dataclass(frozen=True)
class Estimate:
    """Numbers (k,), their covariance (k, k), bounds (k,) -1 lower, 1 upper, 0 between; `level` is the squared
    residual per degree of freedom, at least 1, `seconds` the windows' length."""

    numbers: np.ndarray
    covariance: np.ndarray
    bounds: np.ndarray
    level: float
    gain: float  # of energy on held-out windows, against the numbers it started from, and
    chance: float  # what chance alone is expected to take from it
    outlying: float  # share of the windows that were left out
    furthest: float  # prior deviations by which the furthest nominal number had to move
    seconds: float
    passes: int
    converged: bool


@dataclass(frozen=True)
class _Point:
    """Where an iteration stands: slots (k,), deviations (d,), starts (windows, nx), and the windows there."""

    slots: np.ndarray
    deviations: np.ndarray
    starts: np.ndarray
    windows: Sequence[Reduced]


class Refinement:
    """Gauss-Newton on the windows of a recording."""

    def __init__(self, shooting: Shooting, best: Fit) -> None:
        self.shooting, self.slots, self.effects = shooting, best.slots, list(best.effects)
        self.settings = best.settings
        self.first = np.array([slot.get(best.effects) for slot in best.slots])
        self.k, self.d = len(best.slots), len(shooting.nominal)
        self.low = np.array([-np.inf if s.param.wraps else s.param.low for s in self.slots])
        self.high = np.array([np.inf if s.param.wraps else s.param.high for s in self.slots])
        self.begin = self._at(self.first, np.zeros(self.d), shooting.starts)
        self.cap = self._usual(self.begin)
        self.level = self._level(self.begin)
        self.outlying = 1.0 - float(np.mean(self._used(self.begin)))

    def _at(self, slots: np.ndarray, deviations: np.ndarray, starts: np.ndarray, coarse: int = 1) -> _Point:
        return _Point(slots, deviations, starts, self.shooting.linearise(slots, deviations, starts, coarse))

    def _usual(self, point: _Point) -> float:
        """Squared residual per sample up to which windows are used."""
        left = [r.energy / max(1, r.samples) for r in point.windows]
        return self.settings.refinement.outlying * max(1.0, float(np.median(left)))

    def _used(self, point: _Point) -> np.ndarray:
        """(windows,) bool: those that the simulation follows. Where a body breaks loose a little earlier or
        later than it did, a window says nothing of numbers nearby, and would outweigh all others."""
        return np.array([r.energy < self.cap * max(1, r.samples) for r in point.windows])

    # --- search --------------------------------------------------------------------------------------
    def estimate(self) -> Estimate:
        """Steps until they no longer matter; a step that raises the energy is halved.

        Raises OutOfTimeError where the time of the work is over before that."""
        limits = self.settings.refinement
        point, passes = self.begin, 1
        while passes < MOST_PASSES:
            checkpoint()
            self.level = self._level(point)
            step, left = self._next(point)
            if left < limits.converged and passes > 1:  # the starts of the first pass are measured ones
                break
            taken = None
            for halving in range(MOST_HALVINGS):
                taken = self._moved(point, step * 0.5**halving)
                passes += 1
                # the first energy is that of starts which have not been tried yet
                lower = point is self.begin or self._energy(taken) < self._energy(point) + 1e-3
                if lower and np.any(self._used(taken)):  # a simulation may leave the finite numbers
                    break
                taken = None
            if taken is None:
                break
            point = taken
            self.cap = min(self.cap, self._usual(point))
            if passes >= FEWEST_PASSES and _furthest(point) > self.settings.regression.implausible:
                break  # no such numbers are taken
        self.level = self._level(point)
        left, used = self._next(point)[1], self._used(point)
        spread, grown = self._covariance(point, used)
        bounds = np.where(point.slots <= self.low, -1, np.where(point.slots >= self.high, 1, 0))
        spread = beside_bounds(spread, bounds != 0)
        size = np.where(np.isinf(self.high), 0.0, np.abs(point.slots))  # angles have no size
        method = limits.method_error * size
        spread = spread + np.diag(self._step_error(point, used) ** 2 + method**2)
        gain, chance = self._held_out(point)
        chance *= float(np.max(grown)) ** 2
        outlying = 1.0 - float(np.mean(used))
        return Estimate(
            point.slots,
            spread,
            bounds,
            self.level,
            gain,
            chance,
            outlying,
            _furthest(point),
            self.shooting.seconds,
            passes,
            left < limits.small_step,
        )

    def _next(self, point: _Point) -> tuple[np.ndarray, float]:
        """The step from a point, and how far it moves any number in standard errors."""
        used = self._used(point)
        step, curvature = self._step(point, used), self._curvature(point, used)
        errors = np.sqrt(np.diag(self._inverse(curvature))[: self.k])
        never = np.full_like(errors, np.inf)  # a number that no window shows does not converge
        return step, float(np.max(np.divide(np.abs(step[: self.k]), errors, out=never, where=errors > 0.0)))

    def _moved(self, point: _Point, step: np.ndarray) -> _Point:
        slots = np.clip(point.slots + step[: self.k], self.low, self.high)
        done = np.concatenate([slots - point.slots, step[self.k :]])
        moves = [r.start + r.start_by @ done for r in point.windows]
        return self._at(slots, point.deviations + step[self.k :], point.starts + np.array(moves))

    def _energy(self, point: _Point) -> float:
        weak = sum(value**2 for value, _ in self._weak(point.slots))
        prior = float(point.deviations @ point.deviations)
        return sum(min(r.energy, self.cap * r.samples) for r in point.windows) / self.level + prior + weak

    # --- equations -----------------------------------------------------------------------------------
    def _level(self, point: _Point) -> float:
        """Squared residual per degree of freedom, at least 1: what noise and model leave."""
        used = self._used(point)
        windows = [r for r, use in zip(point.windows, used, strict=True) if use]
        freedom = sum(r.samples for r in windows) - len(windows) * self.shooting.model.nx - self.k - self.d
        self.level = 1.0
        step = self._step(point, used)
        best = sum(_predicted(r, step) for r in windows)
        return max(1.0, best / max(1, freedom))

    def _curvature(self, point: _Point, used: np.ndarray) -> np.ndarray:
        out = np.sum([r.curvature for r in _those(point, used)], axis=0)
        out = out / self.level + np.diag(np.concatenate([np.zeros(self.k), np.ones(self.d)]))
        for k, (_, first) in enumerate(self._weak(point.slots)):
            out[k, k] += first**2
        return out

    def _slope(self, point: _Point, used: np.ndarray) -> np.ndarray:
        out = np.sum([r.slope for r in _those(point, used)], axis=0) / self.level
        out[self.k :] += point.deviations
        for k, (value, first) in enumerate(self._weak(point.slots)):
            out[k] += value * first
        return out

    def _weak(self, slots: np.ndarray) -> list[tuple[float, float]]:
        effects = self.with_numbers(slots)
        return [weak_prior(slot, effects, self.settings.regression) for slot in self.slots]

    def with_numbers(self, slots: np.ndarray) -> list[Planned]:
        """The effects with these numbers."""
        effects = list(self.effects)
        for slot, value in zip(self.slots, slots, strict=True):
            slot.put(effects, float(value))
        return effects

    def _step(self, point: _Point, used: np.ndarray) -> np.ndarray:
        """(k + d,) Gauss-Newton step from some windows. Numbers that would leave their bounds are
        fixed, and so are numbers that the recording does not show at all."""
        curvature, slope = self._curvature(point, used), self._slope(point, used)
        free = np.ones(self.k + self.d, dtype=bool)
        free[: self.k] = np.diag(curvature)[: self.k] > (self.high - self.low) ** -2.0
        while True:
            step = np.zeros(self.k + self.d)
            step[free] = -self._inverse(curvature[np.ix_(free, free)]) @ slope[free]
            own = step[: self.k]
            stuck = ((point.slots <= self.low) & (own < 0.0)) | ((point.slots >= self.high) & (own > 0.0))
            if not np.any(stuck & free[: self.k]):
                return step
            free[: self.k] &= ~stuck

    @staticmethod
    def _inverse(curvature: np.ndarray) -> np.ndarray:
        size = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        scale = np.outer(size, size)
        return np.asarray(np.linalg.pinv(curvature / scale, rcond=1e-12, hermitian=True) / scale)

    # --- how good it is ------------------------------------------------------------------------------
    def _covariance(self, point: _Point, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k, k), as `fit.covariance`: curvature outside, scores of blocks of time inside, never below the
        curvature's own; and by how much the scores have widened each error."""
        k, curvature = self.k, self._curvature(point, used)
        begins = np.array([w.start for w in self.shooting.windows])
        block = self.settings.regression.time_block
        blocks = np.unique(((begins - begins[0]) / block + 1e-9).astype(int), return_inverse=True)[1]
        scores = np.zeros((blocks.max() + 1, k + self.d))
        for block, r, use in zip(blocks, point.windows, used, strict=True):
            scores[block] += use * r.slope / self.level
        nominal = self._inverse(curvature[k:, k:]) if self.d else np.zeros((0, 0))
        projected = scores[:, :k] - scores[:, k:] @ nominal @ curvature[k:, :k]
        meat = projected.T @ projected * (len(scores) / max(1, len(scores) - k))
        own = self._inverse(curvature)[:k, :k]
        robust = np.diag(own @ meat @ own)
        grown = np.sqrt(np.maximum(1.0, robust / np.maximum(np.diag(own), 1e-300)))
        return np.asarray(own * np.outer(grown, grown)), grown

    def _step_error(self, point: _Point, used: np.ndarray) -> np.ndarray:
        """(k,) how far the numbers depend on the length of the simulation's steps: half of what they move
        with steps twice as long (a third at order 2, all of it where kinks make it order 1)."""
        coarse = self._at(point.slots, point.deviations, point.starts, coarse=2)
        used = used & self._used(coarse)
        return 0.5 * np.abs(self._step(coarse, used) - self._step(point, used))[: self.k]

    def _held_out(self, point: _Point) -> tuple[float, float]:
        """Energy that numbers found on every second window save on the others, against the first numbers
        with nominal numbers of their own; and how much they are expected to lose if the first were right."""
        gained, chance, odd = 0.0, 0.0, np.arange(len(point.windows)) % 2 == 1
        used = self._used(point)
        for fitted, unseen in ((used & odd, used & ~odd), (used & ~odd, used & odd)):
            step = self._step(point, fitted)
            seen, slope = self._curvature(point, fitted), self._slope(point, fitted)
            there = np.sum([r.curvature for r, u in zip(point.windows, unseen, strict=True) if u], axis=0)
            back = np.concatenate([self.first - point.slots, np.zeros(self.d)])
            chance += float(np.sum(self._inverse(seen) * there)) / self.level
            if self.d:
                nominal = self._inverse(seen[self.k :, self.k :])
                back[self.k :] = -nominal @ (slope + seen @ back)[self.k :]
                chance -= float(np.sum(nominal * there[self.k :, self.k :])) / self.level
            for r, use in zip(point.windows, unseen, strict=True):
                gained += use * (_predicted(r, back) - _predicted(r, step))
        return gained / self.level, chance


def _furthest(point: _Point) -> float:
    """Prior deviations by which the furthest nominal number has moved."""
    return float(np.max(np.abs(point.deviations), initial=0.0))


def _those(point: _Point, used: np.ndarray) -> list[Reduced]:
    """The windows that are used; SimulationError where none can be."""
    windows = [r for r, use in zip(point.windows, used, strict=True) if use]
    if not windows:
        raise SimulationError("no window of the recording can be simulated with these numbers")
    return windows


def _predicted(reduced: Reduced, step: np.ndarray) -> float:
    return float(reduced.energy + 2.0 * reduced.slope @ step + step @ reduced.curvature @ step)
