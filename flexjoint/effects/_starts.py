"""Grids of starting values that several effects share; see `Effect.starts`."""

from collections.abc import Iterable
from itertools import product
from math import floor, pi
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Signals

MAX_CYCLES = 60
RIPPLES = 2  # strongest ripples of a signal that are tried, on each scale
SLOW = (0.1, 1.0)  # s, what a signal does on a longer scale is not a ripple: a slow motion makes slow ones
BINS = 1 << 16  # of the angle's range
# A sine of any phase and positive amplitude correlates by at least 1/2 with one of these three.
PHASES = (0.0, 2 * pi / 3, -2 * pi / 3)


def grid(params: tuple[Parameter, ...], **values: Iterable[Any]) -> tuple[dict[str, float], ...]:
    """One start per combination of the values, each held inside its parameter's bounds, equal ones once."""
    bounds = {p.name: p for p in params}
    axes = []
    for name, wanted in values.items():
        param = bounds[name]
        axes.append(dict.fromkeys(min(max(float(v), param.low), param.high) for v in wanted))
    return tuple(dict(zip(values, point, strict=True)) for point in product(*axes))


def whole_cycles(theta: Any) -> range:
    """Every whole number of cycles per turn up to MAX_CYCLES of which the angle theta (N,) [rad] covers
    about a quarter period or more."""
    travel = float(np.ptp(theta))
    if travel * MAX_CYCLES <= 0.5 * pi:
        return range(MAX_CYCLES, MAX_CYCLES + 1)
    return range(max(1, floor(0.5 * pi / travel)), MAX_CYCLES + 1)


def few_periods(angle: Any) -> tuple[float, ...]:
    """Cycles per turn of which the angle (N,) [rad] covers fewer than two periods, which `ripple_cycles` does
    not tell."""
    travel = float(np.ptp(angle))
    return tuple(periods * 2.0 * pi / travel for periods in (0.5, 1.0, 1.5)) if travel > 0.0 else ()


def rhythms(s: Signals) -> tuple[float, ...]:
    """Frequencies [Hz] of the strongest oscillations that a joint's deflection or command has beside what its
    load and its speed make of them; 1 Hz where it has none."""
    motion = s.tau_t, s.dtheta, s.dphi
    found = (*ripple_cycles(s.t, s.phi, motion, s.t), *ripple_cycles(s.t, s.tau_m, motion, s.t))
    return tuple(omega / (2.0 * pi) for omega in found) or (1.0,)


def ripple_cycles(angle: Any, signal: Any, known: Iterable[Any], t: Any) -> tuple[float, ...]:
    """Cycles per turn of the strongest ripples of a signal (N,) with an angle (N,) [rad] sampled at t [s],
    beyond what is linear in the `known` signals.

    The peaks of the periodogram over the angle, with samples gathered in fine bins of it; only ripples that
    the motion covers at least twice, and samples at least thrice a period, can be distinguished.
    """
    angle, signal = np.asarray(angle, float), np.asarray(signal, float)
    travel = float(np.ptp(angle))
    period = float(np.median(np.diff(t)))
    speed = float(np.mean(np.abs(np.diff(angle)))) / period
    if travel <= 0.0 or not np.ptp(signal) > 0.0:
        return ()
    columns = np.stack([x * np.ones_like(signal) for x in (1.0, t, *known)], axis=1)
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)
    rest = signal - columns @ np.linalg.lstsq(columns, signal, rcond=1e-9)[0]
    place = np.minimum(((angle - angle.min()) / travel * BINS).astype(int), BINS - 1)
    cycles = 2.0 * pi / travel * np.arange(2 * BINS + 1) / 4.0
    visible = (cycles >= 4.0 * pi / travel) & (cycles <= 2.0 * pi / (3.0 * period * speed))
    visible &= cycles <= 2.0 * pi / travel * BINS / 16.0  # a bin must be a small part of a period
    found: list[float] = []
    for scale in SLOW:
        if angle.size < 4.0 * scale / period:
            break
        fast = rest - gaussian_filter1d(rest, scale / period)
        gathered = np.bincount(place, weights=fast, minlength=BINS)
        power = np.where(visible, np.abs(np.fft.rfft(gathered, 4 * BINS)) ** 2, 0.0)
        for top in found:
            power[np.abs(cycles - top) < 4.0 * pi / travel] = 0.0
        for _ in range(RIPPLES):
            if not np.max(power) > 0.0:
                break
            top = float(cycles[np.argmax(power)])
            found.append(top)
            power[np.abs(cycles - top) < 4.0 * pi / travel] = 0.0
    return tuple(found)
