"""The time that work may take: asked at the boundaries between its steps, which are then left out.

Work of many short steps need not be handed its time: `within` says it once for all that is called there, and
`checkpoint`, which the innermost loops call, ends the work by an error where it is over. Who said it catches
that and keeps what was whole.

Work without a limit never looks at the clock, and work within its limit gives the same bits as without one.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from flexjoint.core.errors import FlexJointError

UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
LEAST = 1.0  # s: less is over before a recording is read
_WRITTEN = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)")


class OutOfTimeError(FlexJointError):
    """The time that was allowed is over."""

    def __init__(self, text: str = "the time allowed was over") -> None:  # it is sent between processes
        super().__init__(text)


@dataclass(frozen=True)
class Budget:
    """Seconds of wall clock from the making of this value on; without a number there is no limit."""

    seconds: float = math.inf
    clock: Callable[[], float] = field(default=time.monotonic, repr=False, compare=False)
    _begun: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.seconds >= 0.0:
            raise FlexJointError(f"budget: expected seconds from 0 on, got {self.seconds}")
        object.__setattr__(self, "_begun", self.clock() if self.limited else 0.0)

    @property
    def limited(self) -> bool:
        return math.isfinite(self.seconds)

    @property
    def left(self) -> float:
        """Seconds that are left, at least 0."""
        return max(0.0, self.seconds - (self.clock() - self._begun)) if self.limited else math.inf

    @property
    def spent(self) -> bool:
        """Whether the time is over: what is asked at a boundary between two steps."""
        return self.limited and self.left <= 0.0

    def check(self) -> None:
        """Raise OutOfTimeError if it is spent."""
        if self.spent:
            raise OutOfTimeError

    def part(self, share: float) -> Budget:
        """The first part of this time, counted from the same beginning; without a limit itself."""
        if not self.limited:
            return self
        out = Budget(share * self.seconds, self.clock)
        object.__setattr__(out, "_begun", self._begun)
        return out


UNLIMITED = Budget()
_HERE: ContextVar[Budget] = ContextVar("budget", default=UNLIMITED)


@contextmanager
def within(budget: Budget) -> Iterator[None]:
    """What is called here ends with OutOfTimeError at the first checkpoint after this time; an inner time
    takes the place of an outer one."""
    token = _HERE.set(budget)
    try:
        yield
    finally:
        _HERE.reset(token)


def here() -> Budget:
    """The time of the work that is being done (`within`)."""
    return _HERE.get()


def checkpoint() -> None:
    """Raise OutOfTimeError if that is spent."""
    _HERE.get().check()


def budget_of(text: str) -> Budget:
    """A budget as it is written: 60s, 2min, 1.5h, or seconds without a unit.

    Raises FlexJointError for anything else, and for less than a second."""
    written = _WRITTEN.fullmatch(text.strip())
    if written is None or written[2] not in UNITS:
        raise FlexJointError(f"budget: expected a time such as 60s, 5min or 1h, got {text!r}")
    seconds = float(written[1]) * UNITS[written[2]]
    if seconds < LEAST:
        raise FlexJointError(f"budget: expected at least {LEAST:g} s, got {text!r}")
    return Budget(seconds)
