"""What became of dirty machines: the four goals, counted, and their section of the page.

A name is right that stands for a large cause, for a small error of the background that the catalogue knows
(with about its size), or for a nominal number that is off as it says; the tie list of a finding counts as
in the other parts. On a rigid joint friction of the motor and of the link are one thing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from .cases import DIRTY, SEALED
from .score import GROUPS, Record, main_parameter
from .summary import Rate, by, of, rate, seconds
from .text import table

NAMED = 0.8  # probability from which a large cause counts as named
SURER = 0.95  # two bands of stated probability: NAMED to SURER, and above
BELIEVED = 0.5  # probability from which a stand-in does harm
REMOVES = 0.15  # share of an error that a name on a background may not take away
AS_LARGE = 3.0  # times a small error's size, within which a name stands for it and not in for something else
AS_OFF = 0.5  # a wrong number is named where the finding is off by at most this share of it

SAME_ON_RIGID = (
    frozenset({"motor_coulomb_friction", "link_coulomb_friction"}),
    frozenset({"motor_viscous_friction", "link_viscous_friction"}),
)
GOALS = {
    "causes": f"large causes named with at least {NAMED}",
    "sure": f"names stated at {NAMED} to {SURER}: right",
    "surer": f"names stated above {SURER}: right",
    "background": f"background alone: names above {BELIEVED} that remove more than {REMOVES:.0%} of an error",
    "unknown": f"a large unknown: machines with a wrong name above {BELIEVED}",
}
WANTED = {"causes": "95 %", "sure": "85 %", "surer": "97 %", "background": "0", "unknown": "0"}


ONE_SIDED = {"motor_coulomb_friction", "torque_offset"}
"""Together they are an asymmetric friction, number for number."""


@dataclass(frozen=True)
class Name:
    """A finding of a record, and what it stands for: cause, background, number or nothing."""

    record: Record
    finding: Record
    stands_for: str

    @property
    def right(self) -> bool:
        return self.stands_for != "nothing"


def rigid(record: Record, joint: str | None) -> bool:
    """Whether a joint of a dirty machine is rigid: it has no stiffness that could be off."""
    sprung = {entry["joint"] for entry in record["off"] if entry["effect"] == "spring_stiffness"}
    return joint is not None and joint not in sprung


def same(finding: Record, planted: Record, record: Record) -> bool:
    """Whether a finding names a planted effect, or lists it among its ties."""
    key = [planted["effect"], planted["joint"]]
    named = [finding["effect"], finding["joint"]]
    alone = record["joints"] == 1 and finding["joint"] is None
    if named == key or key in finding["ties"] or (alone and finding["effect"] == planted["effect"]):
        return True
    there = {t["effect"] for t in record["truth"] if t["joint"] == planted["joint"]}
    if named == ["asymmetric_friction", planted["joint"]] and {planted["effect"]} <= ONE_SIDED <= there:
        return True
    groups = (*GROUPS, *(SAME_ON_RIGID if rigid(record, planted["joint"]) else ()))
    alike = any({finding["effect"], planted["effect"]} <= group for group in groups)
    return alike and finding["joint"] == planted["joint"]


def as_large(finding: Record, planted: Record) -> bool:
    """Whether a finding of a small error's own name has about its size, and its sign; ties have no sizes."""
    if finding["effect"] != planted["effect"]:
        return True
    name = main_parameter(planted)
    ratio = finding["parameters"][name]["value"][0] / planted["parameters"][name]
    return 1 / AS_LARGE <= ratio <= AS_LARGE


def is_off(finding: Record, record: Record) -> bool:
    """Whether a finding tells how far a nominal number is off."""
    for entry in record["off"]:
        if (entry["effect"], entry["joint"]) != (finding["effect"], finding["joint"]):
            continue
        told = finding["parameters"].get("scale") or finding["parameters"]["coefficient"]
        true = entry["scale"] if "scale" in finding["parameters"] else entry["change"]
        return abs(told["value"][0] - true) <= AS_OFF * abs(true)
    return False


def names(records: Sequence[Record]) -> Iterator[Name]:
    """Every finding with what it stands for."""
    for record in records:
        for finding in record.get("findings", ()):
            if any(same(finding, t, record) for t in record["truth"]):
                stands_for = "cause"
            elif any(same(finding, b, record) and as_large(finding, b) for b in record["background"]):
                stands_for = "background"
            else:
                stands_for = "number" if is_off(finding, record) else "nothing"
            yield Name(record, finding, stands_for)


def large_causes(records: Sequence[Record]) -> list[tuple[Record, Record]]:
    """(record, cause) of every cause that stands out of its background."""
    return [(r, t) for r in of(records, "dirty") for t in r["truth"] if t["large"]]


def belief(record: Record, cause: Record) -> float:
    """The largest probability of a finding that names a cause, 0 without one."""
    said = [f["probability"] for f in record.get("findings", ()) if same(f, cause, record)]
    return max(said, default=0.0)


def measured(records: Sequence[Record]) -> dict[str, Rate]:
    """The figures of GOALS, by their keys."""
    causes = large_causes(records)
    stated = list(names([r for r in records if r["part"] in DIRTY]))
    bands = {
        "sure": [n for n in stated if NAMED <= n.finding["probability"] <= SURER],
        "surer": [n for n in stated if n.finding["probability"] > SURER],
    }
    return {
        "causes": Rate(sum(belief(r, t) >= NAMED for r, t in causes), len(causes)),
        **{band: Rate(sum(n.right for n in held), len(held)) for band, held in bands.items()},
        "background": Rate(len(on_background(records)), len(of(records, "background"))),
        "unknown": rate(of(records, "unknown"), stands_in),
    }


def on_background(records: Sequence[Record]) -> list[Name]:
    """Names on the background alone that are believed and remove much; right ones, too."""
    found = names(of(records, "background"))
    return [n for n in found if n.finding["probability"] > BELIEVED and n.finding["gain"] > REMOVES]


def stands_in(record: Record) -> bool:
    """Whether a wrong name is believed."""
    return any(n.finding["probability"] > BELIEVED and not n.right for n in names([record]))


def missed(record: Record) -> bool:
    """Whether a dirty machine is a miss by any of the goals."""
    unnamed = any(belief(r, t) < NAMED for r, t in large_causes([record]))
    wrong = any(n.finding["probability"] >= NAMED and not n.right for n in names([record]))
    return (
        unnamed
        or wrong
        or bool(on_background([record]))
        or (record["part"] == "unknown" and stands_in(record))
    )


# --- text -------------------------------------------------------------------------------------------------
def goals(records: Sequence[Record]) -> str:
    """The four figures with counts, of the numbers for development and of the sealed ones."""
    lines: list[str] = []
    halves = {
        "development": [r for r in records if r["number"] < SEALED],
        "sealed": [r for r in records if r["number"] >= SEALED],
    }
    for half, inside in halves.items():
        held = [r for r in inside if r["part"] in DIRTY]
        if not held:
            continue
        counts = ", ".join(f"{len(of(held, part))} {part}" for part in DIRTY)
        lines.append(f"{half}: {counts}")
        for key, found in measured(held).items():
            lines.append(f"  {GOALS[key]}: {told(key, held, found)} (goal {WANTED[key]})")
        lines += [f"  verdicts of {part}: {verdicts(of(held, part))}" for part in DIRTY]
    return "\n".join(lines or ["no dirty machines here; run the parts dirty, background and unknown"]) + "\n"


def verdicts(records: Sequence[Record]) -> str:
    """Verdicts with their counts; a large unknown is not to be called healthy."""
    return ", ".join(f"{v} {n}" for v, n in Counter(r["verdict"] for r in records).most_common()) or "none"


def told(key: str, records: Sequence[Record], found: Rate) -> str:
    """A figure with its counts."""
    if key == "background":
        right = Counter(n.stands_for for n in on_background(records))
        share = f"{found.hits} on {found.cases} machines"
        return f"{share}, of them {right['nothing']} wrong, {right['background']} small errors that are there"
    share = f" = {100 * found.share:.0f} %" if found.cases else ""
    return f"{found.hits}/{found.cases}{share}"


def section(records: Sequence[Record]) -> str:
    """The page's section, empty where no dirty machine was run."""
    held = [r for r in records if r["part"] in DIRTY]
    if not held:
        return ""
    figures = measured(held)
    rows = [(GOALS[key], told(key, held, found), WANTED[key]) for key, found in figures.items()]
    words = (
        "\n## Dirty machines\n\nMachines with wrong numbers and a background of small errors, half of them of"
        " laws that the catalogue lacks (`tests/planting/dirty`): under one to three large causes, alone,"
        " and under a large law that the catalogue lacks. A cause is large from a tenth of the joint's torque"
        f" on, or where it stands out. Numbers from {SEALED} on are sealed: no rule comes from them.\n"
    )
    rows += [(f"verdicts of {part}", verdicts(of(held, part)), "") for part in DIRTY]
    parts = [words, table(("what", "measured", "goal"), rows)]
    groups: dict[str, Callable[[Record], object]] = {
        "robot": lambda r: r["robot_family"],
        "background": lambda r: r["background_family"],
        "sensors": lambda r: r["sensors"],
        "sampling [Hz]": lambda r: int(r["rate"]),
        "joints": lambda r: r["joints"],
    }
    rows = []
    for title, group in groups.items():
        for name, inside in by(held, group).items():
            found = measured(inside)
            taken = f"{seconds(inside)[1]:.0f} of {sum(r['seconds'] for r in inside) / len(inside):.0f}"
            rows.append((title, name, *(told(key, inside, found[key]) for key in GOALS), taken))
    heads = (
        "",
        "",
        "causes",
        "0.8 to 0.95",
        "above 0.95",
        "background",
        "unknown",
        "seconds, of a recording",
    )
    parts.append("\nBy what they are, each to be held out:\n" + table(heads, rows))
    effects: dict[str, list[float]] = {}
    for record, cause in large_causes(held):
        effects.setdefault(cause["effect"], []).append(belief(record, cause))
    rows = [
        (effect, len(said), sum(b > 0 for b in said), sum(b >= NAMED for b in said))
        for effect, said in sorted(effects.items())
    ]
    parts.append("\nLarge causes:\n" + table(("planted", "cases", "named", f"with {NAMED} or more"), rows))
    wrong = Counter(
        n.finding["effect"] for n in names(held) if not n.right and n.finding["probability"] > BELIEVED
    )
    listed = ", ".join(f"{name} {count}" for name, count in wrong.most_common()) or "none"
    parts.append(f"\nWrong names above {BELIEVED}: {listed}.\n")
    return "".join(parts)
