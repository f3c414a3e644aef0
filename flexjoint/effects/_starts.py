"""Grids of starting values that several effects share; see `Effect.starts`."""

from collections.abc import Iterable
from itertools import product
from math import floor, pi
from typing import Any

import numpy as np

from flexjoint.core.parameter import Parameter

MAX_CYCLES = 60
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


def whole_cycles(theta: Any, periods: float = 0.25) -> range:
    """Every whole number of cycles per turn up to MAX_CYCLES of which the angle theta (N,) [rad] covers
    about so many periods or more."""
    travel = float(np.ptp(theta))
    least = 2.0 * pi * periods
    if travel * MAX_CYCLES <= least:
        return range(MAX_CYCLES, MAX_CYCLES + 1)
    return range(max(1, floor(least / travel)), MAX_CYCLES + 1)


def few_periods(angle: Any) -> tuple[float, ...]:
    """Cycles per turn of which the angle (N,) [rad] covers fewer than two periods, which a periodogram does
    not tell."""
    travel = float(np.ptp(angle))
    return tuple(periods * 2.0 * pi / travel for periods in (0.5, 1.0, 1.5)) if travel > 0.0 else ()
