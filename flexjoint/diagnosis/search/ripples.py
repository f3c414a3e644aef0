"""Cycles of the ripples that a set of effects leaves in a joint's balances: where a search for a law that is
periodic in an angle, or in time, starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import pi

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.settings import SearchSettings
from flexjoint.effects import Planned

BINS = 1 << 14  # of the angle's range
FINER = 4  # steps of the cycles within the width of a peak


def ripples(problem: Problem, joint: str, signal: str, base: Sequence[Planned]) -> tuple[float, ...]:
    """Cycles per unit of a joint's signal (an angle, or the time), from the periodogram over it of what the
    effects `base`, nominal ones included, leave of each balance of the joint.

    What is left is whitened, so that the cycles are those which a fit would find: a ripple of an encoder
    shows in the balance of the sensors that measure best beside it.
    """
    signals = problem.signals(joint)
    place = np.interp(problem.balances.chains.t[0] + problem.time, signals.t, getattr(signals, signal))
    own = problem.robot.joint_names.index(joint)
    rows = [r for r, row in enumerate(problem.balances.rows) if row.joint == own]
    found: list[float] = []
    for left in _left(problem, base)[rows]:
        found += strongest(place, left, problem.time, problem.settings.search)
    return tuple(dict.fromkeys(found))


def _left(problem: Problem, base: Sequence[Planned]) -> np.ndarray:
    """(rows, n) what effects leave beside the nominal numbers, at the noise that is predicted: it depends on
    these effects alone, and not on what else a search has tried."""

    def rest() -> np.ndarray:
        here = problem.about(extra).at(NoiseLevel.predicted(len(problem.balances.rows)))
        return here.rest(here.residual(extra)) * here.weights

    listed = {e.identity for e in problem.nominal}
    extra = [e for e in base if e.identity not in listed]
    return problem.remembered("ripples", extra, rest).reshape(len(problem.balances.rows), -1)


def strongest(
    place: np.ndarray, left: np.ndarray, time: np.ndarray, settings: SearchSettings
) -> Iterator[float]:
    """Cycles per unit of `place` (n,) of the strongest ripples of `left` (n,) at times (n,) [s]: only those
    that the motion covers at least twice, and samples at least thrice a period, can be told."""
    travel = float(np.ptp(place))
    period = float(np.median(np.diff(time)))
    if travel <= 0.0:
        return
    speed = float(np.mean(np.abs(np.diff(place)))) / period
    where = np.minimum(((place - place.min()) / travel * BINS).astype(int), BINS - 1)
    width = 2.0 * pi / travel
    cycles = width * np.arange(FINER * BINS // 2 + 1) / FINER
    # a bin must be a small part of a period
    most = min(2.0 * pi / (3.0 * period * speed), width * BINS / 16.0)
    visible = (cycles >= 2.0 * width) & (cycles <= most)
    found: list[float] = []
    for scale in settings.ripple_scales:
        if place.size < 4.0 * scale / period:
            break
        fast = left - gaussian_filter1d(left, scale / period)
        gathered = np.bincount(where, weights=fast, minlength=BINS)
        power = np.where(visible, np.abs(np.fft.rfft(gathered, FINER * BINS)) ** 2, 0.0)
        for top in found:
            power[np.abs(cycles - top) < 2.0 * width] = 0.0
        for _ in range(settings.ripples):
            if not np.max(power) > 0.0:
                break
            top = float(cycles[np.argmax(power)])
            found.append(top)
            power[np.abs(cycles - top) < 2.0 * width] = 0.0
            yield top
