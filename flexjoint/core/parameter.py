"""A number that may vary: its name, unit, value, bounds, and how well it is known."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace

from flexjoint.core.errors import ModelError
from flexjoint.core.units import of_joint

SMALLEST = math.ulp(0.0)  # the lower bound of a number that must be above 0


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, of a drive or of a body.

    Args:
        name: within an effect its own (`gap`), within a model the whole one (`backlash.elbow.gap`).
        unit: SI, of a joint that turns.
        symbol: LaTeX.
        value: its value, or the default where none is given.
        low, high: bounds, which belong to it.
        null: the value at which it does nothing, so that an effect is absent. None marks a shape parameter:
            it means nothing while the amplitude is null, so it is never tested alone.
        std: standard deviation: the prior one of a nominal number, the standard error of a fitted one; None
            where it is not known.
        size: > 1 is a vector (a position), all of whose entries share value and bounds.
        wraps: an angle, known only modulo 2 pi.
        step: longest step over which a law may be taken as linear in it.
    """

    name: str
    unit: str = ""
    symbol: str = ""
    _: KW_ONLY
    value: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    null: float | None = 0.0
    std: float | None = None
    size: int = 1
    wraps: bool = False
    step: float = math.inf

    def unit_at(self, prismatic: bool) -> str:
        """Its unit at a joint that turns or slides; a phase is an angle at either."""
        return self.unit if self.wraps else of_joint(self.unit, prismatic)

    def bounds(self, listed: bool = False) -> tuple[float, float]:
        """The bounds at which a fit may be said to end. Of an effect that a nominal model lists its absence
        is none: it is gone."""
        low, high = self.low, self.high
        if listed:
            low, high = (-math.inf if low == self.null else low), (math.inf if high == self.null else high)
        return low, high

    def checked(self, number: object, where: str = "") -> float:
        """The number as a float; raises ModelError for what is no number, or out of bounds. `where` is the
        name to say instead of its own."""
        if isinstance(number, (int, float)) and math.isfinite(number) and self.low <= number <= self.high:
            return float(number)
        if math.isfinite(self.high):
            bounds = f"in [{self.low:g}, {self.high:g}] {self.unit}"
        else:
            bounds = f"> 0 {self.unit}" if self.low == SMALLEST else f">= {self.low:g} {self.unit}"
        raise ModelError(f"{where or self.name}: expected a number {bounds.strip()}, got {number!r}")

    def within(self, deviations: float) -> Parameter:
        """The parameter with bounds of so many standard deviations about its value, inside those that it has.

        Raises ModelError where its standard deviation is not known.
        """
        if self.std is None:
            raise ModelError(f"{self.name}: its standard deviation is not known; give low and high instead")
        reach = deviations * self.std
        return replace(self, low=max(self.low, self.value - reach), high=min(self.high, self.value + reach))
