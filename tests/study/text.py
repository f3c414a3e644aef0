"""How the pages write tables, rates and versions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from .score import Record
from .summary import Rate


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    lines += [f"| {' | '.join(map(str, row))} |" for row in rows]
    return "\n" + "\n".join(lines) + "\n"


def percent(share: float) -> str:
    return "" if math.isnan(share) else f"{100 * share:.1f} %"


def rate_text(rate: Rate, interval: tuple[float, float] | None = None) -> str:
    """Counts, share and interval (default: the exact one)."""
    low, high = interval or rate.interval
    return f"{rate.hits}/{rate.cases} = {percent(rate.share)} ({100 * low:.1f} to {100 * high:.1f})"


def code(records: Sequence[Record]) -> str:
    """The versions of the code; where there are several, with the parts that each has run."""
    versions = sorted({r["version"] for r in records})
    if len(versions) < 2:
        return "".join(versions)
    ran = {v: Counter(r["part"] for r in records if r["version"] == v) for v in versions}
    return "; ".join(f"{v} ({', '.join(f'{n} {part}' for part, n in ran[v].items())})" for v in versions)
