"""How white the noise of a coarse encoder is.

What rounding to an encoder's steps leaves is white only where the motion crosses many of them between
samples, or other noise does (Bennett 1948; Widrow and Kollar 2008, "Quantization Noise"). A body at rest is
off by one and the same part of a step, and a slow one by a sawtooth: there most of that noise lies at low
frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from flexjoint.diagnosis.settings import SignalSettings
from flexjoint.diagnosis.signals.signals import Readings

PHASES = 8  # places of the motion on the encoder's grid, over which is averaged: nobody knows it
SEGMENT = 1024  # samples
SEED = 3  # of the noise beside rounding


@dataclass(frozen=True)
class Colour:
    """Spectrum of a noise over that of white noise of its variance, by frequency."""

    omega: np.ndarray  # (k,) rad/s
    factor: np.ndarray  # (k,)

    def at(self, omega: np.ndarray) -> np.ndarray:
        """(F,) the factor at some frequencies."""
        return np.interp(omega, self.omega, self.factor)


def colours_of(readings: Readings, clean: Readings) -> dict[int, Colour]:
    """Of the links' and then the motors' angles, by their number, those whose noise is not white; `clean` are
    the readings without it."""
    angles = (*clean.q, *clean.theta)
    noise, steps = ((*x["q"], *x["theta"]) for x in (readings.noise, readings.steps))
    found = {
        k: colour_of(angles[k], float(step), float(noise[k]), readings.period, readings.settings.signals)
        for k, step in enumerate(steps)
        if step > 0.0
    }
    return {k: colour for k, colour in found.items() if colour is not None}


def colour_of(
    clean: np.ndarray, step: float, noise: float, period: float, settings: SignalSettings
) -> Colour | None:
    """The colour of a position's noise, of standard deviation `noise`, from the readings (N,) without it and
    the step of their encoder; None where it is white."""
    besides = float(np.sqrt(max(0.0, noise**2 - step**2 / 12.0)))
    if besides > settings.dithered * step:
        return None
    moved = clean + besides * np.random.default_rng(SEED).standard_normal(clean.size)
    power = np.zeros(1)
    for phase in np.arange(PHASES) / PHASES * step:
        error = step * np.round((moved + phase) / step) - (clean + phase)
        frequency, density = welch(error, 1.0 / period, nperseg=min(SEGMENT, error.size), detrend=False)
        power = power + density / PHASES
    white = 2.0 * noise**2 * period  # one-sided
    return Colour(2.0 * np.pi * frequency, np.maximum(power / white, settings.least_colour))
