"""What became of the part `fresh`, held against its goals, and its section of the page.

The machines of this part were seen by no rule. It may be run at any commit, but its outcome is only counted:
it must never lead to a rule, a setting or a size. A miss is looked at in the parts that may lead to rules.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .cases import COUNTS, FRESH_KINDS
from .score import (
    DETECTABLE,
    OUTCOMES,
    STRUCK_OUTCOMES,
    Record,
    detectable,
    each_detectable,
    outcome,
    struck_outcome,
)
from .summary import (
    Rate,
    alarmed,
    brier,
    by,
    named,
    of,
    outcomes,
    rate,
    reliability,
    seconds,
    struck_outcomes,
)
from .text import code, rate_text, table

WORDS = """
## Machines that no rule has seen

Part *fresh*: a robot of one to seven joints for every case, drawn with its controller, encoders, noise and
rates from numbers that nothing else uses (`tests/study/cases.py`), with one, two or three causes, none, or
one that is struck. It is counted, and its outcome must never lead to a rule. No figure of the other sections
counts it.
"""
NOT_RUN = "\nNot run with the code of this page. `study run --part fresh` runs it.\n"
BY_COUNT = {0: "healthy", 1: "single", 2: "double", 3: "triple"}  # of causes


def kind(record: Record) -> str:
    """One of FRESH_KINDS."""
    return "struck" if record["excluded"] else BY_COUNT[len(record["truth"])]


def counted(records: Sequence[Record]) -> list[Record]:
    """Those of the part that count: not the trials."""
    return [r for r in of(records, "fresh") if r["number"] < COUNTS["fresh"]]


def measured(records: Sequence[Record]) -> list[tuple[str, Rate, str]]:
    """What is counted, how often it was so, and the goal; empty where there is none."""
    groups = {name: [r for r in counted(records) if kind(r) == name] for name in FRESH_KINDS}
    seen = {name: [r for r in inside if detectable(r)] for name, inside in groups.items()}
    each = {name: [r for r in seen[name] if each_detectable(r)] for name in ("double", "triple")}
    above = f"excess above {DETECTABLE}"
    return [
        (f"single causes, {above}: exact", rate(seen["single"], lambda r: outcome(r) == "exact"), ""),
        (f"single causes, {above}: exact or tied", rate(seen["single"], named), "97 %"),
        (f"two causes, {above}: exact or tied", rate(seen["double"], named), ""),
        (f"two causes, each {above} beside the other: exact or tied", rate(each["double"], named), "95 %"),
        (f"three causes, {above}: exact or tied", rate(seen["triple"], named), ""),
        (f"three causes, each {above} beside the others: exact or tied", rate(each["triple"], named), "85 %"),
        ("healthy machines alarmed", rate(groups["healthy"], alarmed), "at most 0.5 %"),
        (
            "true effect struck: confident wrong name",
            rate(groups["struck"], lambda r: struck_outcome(r) == "wrong"),
            "0",
        ),
    ]


def section(records: Sequence[Record]) -> str:
    """The page's section."""
    held = counted(records)
    if not held:
        return WORDS + NOT_RUN
    count = f"\nCode {code(held)}. Cases: {len(held)} of {COUNTS['fresh']}.\n"
    rows = [(what, rate_text(found) if found.cases else "", goal) for what, found, goal in measured(held)]
    goals = table(("what", "measured", "goal"), rows)
    return WORDS + count + goals + _outcomes(held) + _groups(held) + _stated(held)


def _outcomes(held: Sequence[Record]) -> str:
    rows = []
    for name in ("single", "double", "triple"):
        inside = [r for r in held if kind(r) == name and detectable(r)]
        found = outcomes(inside)
        rows.append((name, len(inside), *(found[o] or "" for o in OUTCOMES)))
    struck = [r for r in held if kind(r) == "struck"]
    found = struck_outcomes(struck)
    return (
        f"\nCauses with excess above {DETECTABLE}:\n"
        + table(("causes", "cases", *OUTCOMES), rows)
        + "\nThe true effect struck:\n"
        + table(("cases", *STRUCK_OUTCOMES), [(len(struck), *(found[o] or "" for o in STRUCK_OUTCOMES))])
    )


def _groups(held: Sequence[Record]) -> str:
    groups: dict[str, Callable[[Record], object]] = {
        "joints": lambda r: r["joints"],
        "sensors": lambda r: r["sensors"],
        "nominal model off by [%]": lambda r: round(100 * r["inexact"]),
        "sampling [Hz]": lambda r: int(r["rate"]),
        "excitation": lambda r: r["excitation"],
    }
    rows = []
    for title, group in groups.items():
        for name, inside in by(held, group).items():
            causes = [r for r in inside if kind(r) in ("single", "double", "triple") and detectable(r)]
            healthy = [r for r in inside if kind(r) == "healthy"]
            alarms = f"{rate(healthy, alarmed).hits}/{len(healthy)}"
            found = rate_text(rate(causes, named)) if causes else ""
            rows.append((title, name, found, alarms, f"{seconds(inside)[1]:.1f}"))
    heads = ("", "", "causes: exact or tied", "healthy: alarmed", "seconds, median")
    return "\nBy what they are, causes of all counts together:\n" + table(heads, rows)


def _stated(held: Sequence[Record]) -> str:
    """The reliability table: a bin is right where its mean stated probability lies in the interval."""
    known = [r for r in held if kind(r) != "struck"]
    rows = []
    for low, high, count, mean, right in reliability(known):
        if count:
            first, last = right.wilson
            inside = "inside" if first <= mean <= last else "too modest" if mean < first else "too sure"
            rows.append(
                (f"{low:g} to {high:g}", count, f"{mean:.3f}", rate_text(right, right.wilson), inside)
            )
    heads = ("stated probability", "findings", "mean stated", "name was the truth (Wilson 1927)", "mean")
    return (
        "\nStated probabilities, every finding but those on struck causes; a mean is to lie inside its"
        " interval:\n" + table(heads, rows) + f"\nBrier score {brier(known):.4f}.\n"
    )
