"""The study's tables as Markdown (docs/studies/diagnosis_study.md), and its misses as text."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import date
from typing import Any

import numpy as np

from . import dirty, fresh, summary
from .cases import COUNTS, DIRTY, USUAL
from .score import (
    DETECTABLE,
    OUTCOMES,
    STRUCK_OUTCOMES,
    Record,
    detectable,
    each_detectable,
    instead,
    outcome,
    struck_outcome,
)
from .summary import Rate
from .text import code, percent, rate_text, table

NEAR = 1.2  # times the error that no model comes below: the goal on fresh data

HEAD = """\
# Study of the diagnosis

Written by `make study`; do not edit. Planted recordings, diagnosed and counted: `tests/study` says what is
planted and how it is judged, `tests/planting` makes the recordings with equations, integrator, step and
noise of its own. Intervals are exact binomial ones at 95 % (Clopper and Pearson 1934). *Excess* is the
energy per sample of the nominal model's white residual, what its tolerances explain taken out: 1 for noise
alone.

"""
OUTCOME_WORDS = """
*exact*: every cause named on its joint, its main parameter within 10 % or three of its standard errors, its
onset within 0.5 s, nothing else named. *tied*: as exact, but a cause is listed as indistinguishable of the
one named. *inaccurate*: names right, a number not. *partial*: right names beside missing or false ones, or
an equivalent that was not listed as such. *wrong*: `causes` without any right name. The others are verdicts
without a right name.
"""


BEYOND_WORDS = """
Part *beyond*: effects that few other parts plant, and that no figure of the other sections counts.
"""

DRAWN_WORDS = """
Part *drawn*: a robot of its own for every case, drawn at random with its controller, encoders, noise and
rates (`tests/planting/drawn.py`), and one cause of any effect, or none. No figure of the other sections
counts it.
"""
APART = ("beyond", "drawn")  # parts that figures over several parts leave out


def markdown(records: Sequence[Record]) -> str:
    """The page."""
    every, records = records, [r for r in records if r["part"] in USUAL]
    if not records:
        return HEAD + fresh.section(every) + dirty.section(every)
    parts = [HEAD, _made(records), _headline(records), fresh.section(every)]
    first = _first(records)
    words = {"single": OUTCOME_WORDS, "beyond": BEYOND_WORDS, "drawn": DRAWN_WORDS}
    titles = {
        "single": "Single causes",
        "double": "Two causes",
        "several": "One cause, two recordings",
        "beyond": "Single causes, effects that came later",
        "drawn": "Robots drawn at random",
    }
    for part, title in titles.items():
        these = [r for r in summary.of(records, part) if r["truth"]]
        if these:
            parts.append(f"\n## {title}\n{words.get(part, '')}")
            parts.append(_detection(these))
            parts.append(_breakdown(these))
            parts.append(_confusion(these))
    parts.append(_healthy(summary.of(records, "healthy"), "Healthy machines"))
    if drawn := summary.of(records, "drawn"):
        parts.append(_healthy([r for r in drawn if not r["truth"]], "Healthy machines drawn at random"))
    parts += [
        _struck(records),
        _reliability(first),
        _parameters(first),
        _fresh(first),
        _times(first),
        dirty.section(every),
    ]
    return "".join(parts)


def _made(records: Sequence[Record]) -> str:
    counts = ", ".join(f"{len(summary.of(records, p))} of {COUNTS[p]} {p}" for p in USUAL)
    joints = sorted({r["joints"] for r in records})
    return (
        f"Tables of {date.today().isoformat()}, code {code(records)}. Cases: {counts}; robots of"
        f" {', '.join(map(str, joints))} joints.\n"
    )


def _headline(records: Sequence[Record]) -> str:
    rows: list[Sequence[object]] = []
    for part in ("single", "double", "several", "beyond", "drawn"):
        goal = "90 %" if part == "double" else "97 %"
        seen = [r for r in summary.of(records, part) if r["truth"] and detectable(r)]
        if seen:
            what = f"{part} causes with excess above {DETECTABLE}"
            rows.append(
                (f"{what}: exact", rate_text(summary.rate(seen, lambda r: outcome(r) == "exact")), "")
            )
            rows.append((f"{what}: exact or tied", rate_text(summary.rate(seen, summary.named)), goal))
    seen = [r for r in summary.of(records, "double") if each_detectable(r)]
    if seen:
        what = f"double causes, each with excess above {DETECTABLE} beside the other: exact or tied"
        rows.append((what, rate_text(summary.rate(seen, summary.named)), "90 %"))
    for part, what in (("healthy", "healthy machines"), ("drawn", "healthy machines drawn at random")):
        healthy = [r for r in summary.of(records, part) if not r["truth"]]
        if healthy:
            rows.append((f"{what} alarmed", rate_text(summary.rate(healthy, summary.alarmed)), "1 %"))
    struck = summary.of(records, "struck")
    if struck:
        wrong = summary.rate(struck, lambda r: struck_outcome(r) == "wrong")
        rows.append(("true effect struck: confident wrong name", rate_text(wrong), "0"))
    errors = summary.relative_errors(_with_causes(records))
    if errors.size:
        rows.append(("error of the main parameter, median", percent(float(np.median(errors))), "2 %"))
    if first := _first(records):
        rows.append(("seconds a case, median", f"{summary.seconds(first)[1]:.2f}", "5"))
    return "\n## In short\n" + table(("what", "measured", "goal"), rows)


def _first(records: Sequence[Record]) -> list[Record]:
    """What the figures over several parts are of."""
    return [r for r in records if r["part"] not in APART]


def _with_causes(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if r["part"] in ("single", "double")]


def _detection(records: Sequence[Record]) -> str:
    rows = []
    for low, high, inside in summary.by_excess(records):
        if inside:
            counts = summary.outcomes(inside)
            between = f"{'below' if low == summary.EXCESS_EDGES[0] else f'{low:g} to'} {high:g}"
            between = f"above {low:g}" if math.isinf(high) else between
            named = rate_text(summary.rate(inside, summary.named))
            rows.append((between, len(inside), *(counts[o] or "" for o in OUTCOMES), named))
    return "\nBy excess:\n" + table(("excess", "cases", *OUTCOMES, "exact or tied"), rows)


def _breakdown(records: Sequence[Record]) -> str:
    seen = [r for r in records if detectable(r)]
    groups: dict[str, Callable[[Record], Any]] = {
        "sensors": lambda r: r["sensors"],
        "nominal model": _nominal,
        "excitation": lambda r: r["excitation"],
        "sampling [Hz]": lambda r: int(r["rate"]),
        "robot": _robot,
        "onset": lambda r: "late" if any(t["since"] is not None for t in r["truth"]) else "always on",
    }
    if any("second" in r for r in seen):
        groups["second recording"] = lambda r: r["second"].partition(", ")[2]
    rows = []
    for title, group in groups.items():
        for name, inside in summary.by(seen, group).items():
            exact = summary.rate(inside, lambda r: outcome(r) == "exact")
            rows.append((title, name, rate_text(exact), rate_text(summary.rate(inside, summary.named))))
    heads = ("", "", "exact", "exact or tied")
    return f"\nCases with excess above {DETECTABLE}, by what they are:\n" + table(heads, rows)


def _robot(record: Record) -> str:
    drawn = record["part"] == "drawn"
    return f"{record['joints']} joints" if drawn else record["robot"].removesuffix("_exact")


def _nominal(record: Record) -> str:
    if record["inexact"]:
        return f"off by {100 * record['inexact']:g} %"
    return "exact, says so" if record["robot"].endswith("_exact") else "exact, 2 % claimed"


def _confusion(records: Sequence[Record]) -> str:
    """The confusion matrix, a row an effect, empty cells left out."""
    seen = [r for r in records if detectable(r)]
    rows = []
    for effects, inside in summary.by(seen, lambda r: " + ".join(t["effect"] for t in r["truth"])).items():
        counts = summary.outcomes(inside)
        if len(inside[0]["truth"]) > 1 and counts["exact"] == len(inside):
            continue
        names = Counter(name for r in inside for name in instead(r))
        told = ", ".join(f"{name} {count}" for name, count in names.most_common())
        rows.append((effects, len(inside), *(counts[o] or "" for o in OUTCOMES), told))
    title = f"\nConfusion, excess above {DETECTABLE} (pairs that were all exact are left out):\n"
    return title + table(("planted", "cases", *OUTCOMES, "false names"), rows)


def _healthy(healthy: Sequence[Record], title: str) -> str:
    if not healthy:
        return ""
    groups = {
        "nominal model": _nominal,
        "sensors": lambda r: r["sensors"],
        "excitation": lambda r: r["excitation"],
    }
    rows: list[Sequence[object]] = [("all", "", rate_text(summary.rate(healthy, summary.alarmed)), "")]
    for kind, group in groups.items():
        for name, inside in summary.by(healthy, group).items():
            verdicts = Counter(r["verdict"] for r in inside if summary.alarmed(r))
            told = ", ".join(f"{v} {n}" for v, n in verdicts.most_common())
            rows.append((kind, name, rate_text(summary.rate(inside, summary.alarmed)), told))
    names = Counter(f["effect"] for r in healthy for f in r.get("findings", ()))
    told = ", ".join(f"{name} {count}" for name, count in names.most_common()) or "none"
    heads = ("", "", "called anything but healthy", "verdicts")
    return f"\n## {title}\n" + table(heads, rows) + f"\nNames of the false alarms: {told}.\n"


def _struck(records: Sequence[Record]) -> str:
    struck = summary.of(records, "struck")
    if not struck:
        return ""
    rows = []
    for effect, inside in summary.by(struck, lambda r: r["truth"][0]["effect"]).items():
        counts = summary.struck_outcomes(inside)
        names = Counter(n for r in inside if struck_outcome(r) == "wrong" for n in instead(r))
        told = ", ".join(f"{name} {count}" for name, count in names.most_common())
        rows.append((effect, len(inside), *(counts[o] or "" for o in STRUCK_OUTCOMES), told))
    total = summary.struck_outcomes(struck)
    rows.append(("all", len(struck), *(total[o] for o in STRUCK_OUTCOMES), ""))
    words = (
        "\n## The true effect struck from the catalogue\n\nWith it goes every effect that contains it."
        " *equivalent*: only what the effect amounts to in this recording; *unsure*: other names, all stated"
        " below 0.9; *wrong*: verdict `causes` with a confident other name.\n"
    )
    return words + table(("struck", "cases", *STRUCK_OUTCOMES, "wrong names"), rows)


def _reliability(records: Sequence[Record]) -> str:
    known = [r for r in records if r["part"] != "struck"]
    rows = [
        (f"{a:g} to {b:g}", count, f"{mean:.3f}" if count else "", rate_text(right) if count else "")
        for a, b, count, mean, right in summary.reliability(known)
    ]
    heads = ("stated probability", "findings", "mean stated", "name was the truth")
    score = f"\nBrier score {summary.brier(known):.4f}.\n"
    return (
        "\n## Stated probabilities\n\nEvery finding on single, double and healthy cases.\n"
        + table(heads, rows)
        + score
    )


def _parameters(records: Sequence[Record]) -> str:
    rows = []
    known = [r for r in _with_causes(records) if detectable(r)]
    for name, inside in summary.by(known, _nominal).items():
        errors, scaled = summary.relative_errors(inside), np.abs(summary.scaled_errors(inside))
        if errors.size and scaled.size:
            covers = [Rate(int(np.sum(scaled <= k)), scaled.size) for k in (1, 2)]
            middle, high = np.quantile(errors, [0.5, 0.9])
            rows.append((name, errors.size, percent(middle), percent(high), *map(rate_text, covers)))
    heads = (
        "nominal model",
        "causes",
        "median error",
        "90th percentile",
        "within 1 s.e. (68.3 %)",
        "2 s.e. (95.4 %)",
    )
    words = (
        "\n## Parameters\n\nCauses that were named, nothing false beside them. Errors are of the main"
        " parameter, relative; standard errors (s.e.) of all parameters, and what they should cover.\n"
    )
    return words + table(heads, rows)


def _fresh(records: Sequence[Record]) -> str:
    rows = []
    known = [r for r in _with_causes(records) if r.get("fresh") and detectable(r)]
    for name, inside in summary.by(known, _nominal).items():
        middle = (f"{x:.3g}" for x in np.median([r["fresh"] for r in inside], axis=0))
        close = summary.rate(inside, lambda r: r["fresh"][1] <= NEAR * r["fresh"][2])
        rows.append((name, len(inside), *middle, rate_text(close)))
    heads = (
        "nominal model",
        "cases",
        "nominal",
        "extended",
        "with what was planted",
        f"within {NEAR} of that",
    )
    words = (
        "\n## Simulation of fresh data\n\nAnother recording of the machine, simulated in windows of 0.5 s:"
        " RMS error of the positions in their noise, medians, every third case with findings. Start states"
        " and missed ticks leave an error with any model, so that the model with the very effects that were"
        " planted is the floor.\n"
    )
    return words + table(heads, rows) if rows else ""


def _times(records: Sequence[Record]) -> str:
    rows = []
    for joints, inside in summary.by(records, lambda r: r["joints"]).items():
        low, middle, high = summary.seconds(inside)
        rows.append((joints, len(inside), f"{low:.2f}", f"{middle:.2f}", f"{high:.2f}"))
    heads = ("joints", "cases", "5th percentile [s]", "median [s]", "95th [s]")
    return "\n## Time of a diagnosis\n\nWall time, one process a core.\n" + table(heads, rows)


# --- misses -----------------------------------------------------------------------------------------------
def misses(records: Sequence[Record]) -> str:
    """Every case that did not come out as it should, a paragraph each."""
    lines = []
    for r in records:
        if r["part"] in DIRTY:
            bad, said = dirty.missed(r), r["verdict"]
        elif not r["truth"]:
            bad, said = summary.alarmed(r), r["verdict"]
        elif r["excluded"]:
            said = struck_outcome(r)
            bad = said in ("wrong", "unsure", "healthy", "failed")
        else:
            said = outcome(r)
            bad = said not in ("exact", "tied")
        if bad:
            lines.append(f"{r['part']}-{r['number']:04d} {said}: {_told(r)}")
    return "\n".join(lines) + "\n"


def _told(r: Record) -> str:
    where = f"{r['robot']} {r['excitation']} {r['sensors']}, {r['seconds']:g} s at {r['rate']:g} Hz"
    off = ", nominal off 2 %" if r["inexact"] else ""
    truth = "; ".join(map(_planted, (*r["truth"], *r.get("unknown", ()), *r.get("background", ()))))
    found = "; ".join(
        f"{f['effect']}/{f['joint']} p={f['probability']} {_numbers(f['parameters'])}{_since(f)}"
        f" ~{[t[0] for t in f['ties']]}"
        for f in r.get("findings", ())
    )
    tail = f" error {r['error']}" if "error" in r else f" explained {r['explained']}"
    return (
        f"excess {r['excess']}, size {r['size']}, {where}{off}\n  planted {truth or 'nothing'}\n"
        f"  verdict {r['verdict']},{tail}; found {found or 'nothing'}; left {r.get('unexplained', [])}"
    )


def _planted(t: Record) -> str:
    share = f" {100 * t['share']:.1f} %" if "share" in t else ""
    return f"{t['effect']}/{t['joint']} {_numbers(t['parameters'])}{_since(t)}{share}"


def _since(entry: Record) -> str:
    return "" if entry["since"] is None else f" since {entry['since']:.2f}"


def _numbers(parameters: dict[str, Any]) -> str:
    def short(x: Any) -> str:
        if isinstance(x, dict):
            pairs = zip(x["value"], x["std"], strict=True)
            return ",".join(f"{v:.4g}±{s:.1g}" for v, s in pairs)
        return f"{x:.4g}" if isinstance(x, float) else str(x)

    return "(" + ", ".join(f"{k}={short(v)}" for k, v in parameters.items()) + ")"
