"""What a tool's answers are worth: names, sizes, and silence where there is nothing to name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from flexjoint_benchmark import SCHEMA, BenchmarkError
from flexjoint_benchmark.cases import PARTS
from flexjoint_benchmark.folder import cases, read_json, truth
from flexjoint_benchmark.planting.catalogue import law

Entry = Mapping[str, Any]

NAMED = 0.5  # probability from which a finding is a name: more likely there than not
AS_LARGE = 3.0  # times a small error's size, within which a name stands for it and not in for something else
AS_OFF = 0.5  # a wrong number is named where a finding is off by at most this share of it

EQUIVALENT: tuple[frozenset[str], ...] = (
    frozenset({"link_encoder_offset", "motor_encoder_offset", "spring_preload"}),
    frozenset({"torque_delay", "current_lag", "current_loop_lag"}),
    frozenset({"payload", "base_tilt"}),
    frozenset({"torque_offset", "constant_torque"}),
    frozenset({"magnetic_saturation", "torque_droop"}),
)
"""The same to any experiment, on one joint: either name is right."""

ON_RIGID = (
    frozenset({"motor_coulomb_friction", "link_coulomb_friction"}),
    frozenset({"motor_viscous_friction", "link_viscous_friction"}),
)
"""The same on a joint without a spring."""


@dataclass(frozen=True)
class Row:
    """The figures of one part. `size_error` is the median relative error of the main parameter over the
    causes that were named by their own name; NaN where none was. `right` counts the cases in which every
    cause was named and nothing else; of `unknown` and `healthy`, those in which nothing was named that is not
    there."""

    part: str
    cases: int
    answered: int
    right: int
    causes: int
    found: int
    names: int
    false_names: int
    size_error: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Score:
    """A tool's rows, one for each part, and how far the names agree that it gives to several recordings of
    one real machine."""

    tool: str
    rows: tuple[Row, ...]
    agreement: Mapping[str, float]  # machine: names in all of its recordings over names in any

    def to_json(self) -> dict[str, Any]:
        rows = [row.to_json() for row in self.rows]
        return {"schema": SCHEMA, "tool": self.tool, "parts": rows, "agreement": dict(self.agreement)}

    def __str__(self) -> str:
        heads = ("part", "right", "causes found", "false names", "size error", "seconds")
        lines = [heads, *(_cells(row) for row in self.rows)]
        widths = [max(len(line[k]) for line in lines) for k in range(len(heads))]
        table = [
            "  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines
        ]
        real = [
            f"{machine}: {100 * share:.0f} % of its names agree" for machine, share in self.agreement.items()
        ]
        return "\n".join([self.tool, *table, *real])


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.part,
        f"{row.right}/{row.cases}",
        f"{row.found}/{row.causes}" if row.causes else "-",
        f"{row.false_names}/{row.names}",
        "-" if math.isnan(row.size_error) else f"{100 * row.size_error:.1f} %",
        "-" if math.isnan(row.seconds) else f"{row.seconds:.1f}",
    )


def score(folder: Path, answers: Path) -> Score:
    """The score of a file of answers (docs/studies/benchmark.md).

    Raises BenchmarkError for one that cannot be read.

    A case without an answer is one in which nothing was named.
    """
    listed = cases(folder)
    tool, said = read_answers(answers, listed)
    true = truth(folder)
    parts = [part for part in PARTS if any(t["part"] == part for t in true.values())]
    rows = [_row(part, {name: t for name, t in true.items() if t["part"] == part}, said) for part in parts]
    machines = sorted({t["machine"] for t in true.values() if t["part"] == "real"})
    agreement = {}
    for machine in machines:
        names = [n for n, t in true.items() if t.get("machine") == machine]
        if len(names) > 1 and all(name in said for name in names):
            agreement[machine] = _agreement([said[name] for name in names])
    return Score(tool, tuple(rows), agreement)


# --- answers ----------------------------------------------------------------------------------------------
def read_answers(path: Path, listed: Mapping[str, Any]) -> tuple[str, dict[str, Entry]]:
    """The tool's name and its answers by case, checked against the cases that there are."""
    content = read_json(path)
    if content.get("schema") != SCHEMA or not isinstance(content.get("answers"), dict):
        raise BenchmarkError(
            f'{path}: expected {{"schema": {SCHEMA}, "tool": ..., "answers": {{case: ...}}}}'
        )
    for name, answer in content["answers"].items():
        if name not in listed["cases"]:
            raise BenchmarkError(f"{path}: there is no case {name!r}; cases.json lists them")
        if not isinstance(answer, dict) or not isinstance(answer.get("findings"), list):
            raise BenchmarkError(
                f'{path}: {name} has no list "findings"; give an empty one where nothing is wrong'
            )
        for finding in answer["findings"]:
            _check(f"{path}: {name}", finding, listed["cases"][name]["joints"], listed["effects"])
    return str(content.get("tool", path.stem)), content["answers"]


def _check(where: str, finding: Any, joints: Sequence[str], effects: Mapping[str, Any]) -> None:
    if not isinstance(finding, dict) or not isinstance(finding.get("effect"), str):
        raise BenchmarkError(f'{where}: a finding needs "effect" and "joint"')
    if finding["effect"] not in effects:
        known = f"expected one of {', '.join(effects)}"
        raise BenchmarkError(f"{where}: unknown effect {finding['effect']!r}; {known}")
    if finding.get("joint") not in (None, *joints):
        raise BenchmarkError(f"{where}: unknown joint {finding['joint']!r}; it has {', '.join(joints)}")
    probability = finding.get("probability", 1.0)
    if isinstance(probability, bool) or not isinstance(probability, int | float) or not 0 <= probability <= 1:
        raise BenchmarkError(f"{where}: a probability lies between 0 and 1, got {probability!r}")
    if not isinstance(finding.get("parameters", {}), dict):
        raise BenchmarkError(f'{where}: "parameters" are an object of names and {{"value": ..., "std": ...}}')
    tied = finding.get("indistinguishable", [])
    if not isinstance(tied, list) or not all(isinstance(one, dict) for one in tied):
        raise BenchmarkError(f'{where}: "indistinguishable" is a list of {{"effect": ..., "joint": ...}}')


def _names(answer: Entry) -> list[Entry]:
    return [f for f in answer["findings"] if f.get("probability", 1.0) >= NAMED]


# --- one part ---------------------------------------------------------------------------------------------
def _row(part: str, true: Mapping[str, Entry], said: Mapping[str, Entry]) -> Row:
    right = found = causes = names = false = answered = 0
    errors: list[float] = []
    seconds: list[float] = []
    for name, t in true.items():
        answer = said.get(name, {"findings": []})
        answered += name in said
        told = _finite(answer.get("seconds"))
        seconds += [] if told is None else [told]
        wanted = [entry for entry in t["truth"] if entry.get("large", True)]
        named = _names(answer)
        wrong = [f for f in named if not _stands(f, t)]
        met = [entry for entry in wanted if any(_same(f, entry, t) for f in named)]
        errors += [e for entry in met for f in named if (e := _size_error(f, entry)) is not None]
        right += len(met) == len(wanted) and not wrong
        found, causes = found + len(met), causes + len(wanted)
        names, false = names + len(named), false + len(wrong)
    return Row(
        part, len(true), answered, right, causes, found, names, false,
        median(errors) if errors else math.nan, median(seconds) if seconds else math.nan,
    )  # fmt: skip


def _stands(finding: Entry, true: Entry) -> bool:
    """Whether a name stands for something that is there: a cause, a small error or a wrong number."""
    if any(_same(finding, entry, true) for entry in true["truth"]):
        return True
    small = any(
        _same(finding, entry, true) and _as_large(finding, entry) for entry in true.get("background", ())
    )
    return small or _is_off(finding, true)


def _same(finding: Entry, planted: Entry, true: Entry) -> bool:
    """Whether a finding names a planted effect, or lists it among those that it cannot tell from its own."""
    place = planted["effect"], planted["joint"]
    alone = len(true["joints"]) == 1 and finding.get("joint") is None
    if (finding["effect"], finding.get("joint")) == place or (
        alone and finding["effect"] == planted["effect"]
    ):
        return True
    tied = finding.get("indistinguishable", ())
    if any((tie.get("effect"), tie.get("joint")) == place for tie in tied):
        return True
    sprung = {entry["joint"] for entry in true.get("off", ()) if entry["effect"] == "spring_stiffness"}
    rigid = "off" in true and planted["joint"] not in sprung
    groups = (*EQUIVALENT, *(ON_RIGID if rigid else ()))
    return finding.get("joint") == planted["joint"] and any(
        {finding["effect"], planted["effect"]} <= group for group in groups
    )


def _main(planted: Entry) -> str:
    """The parameter that tells an effect's size."""
    if planted["effect"] == "base_tilt":
        return max(("roll", "pitch"), key=lambda name: abs(planted["parameters"][name]))
    return law(planted["effect"]).required[0]


def _value(finding: Entry, name: str) -> float | None:
    told = finding.get("parameters", {}).get(name)
    return _finite(told.get("value") if isinstance(told, dict) else told)


def _finite(value: Any) -> float | None:
    try:
        number = float(value) if isinstance(value, int | float) else math.nan
    except OverflowError:  # a whole number of hundreds of digits
        return None
    return number if math.isfinite(number) else None


def _size_error(finding: Entry, planted: Entry) -> float | None:
    """Relative error of the main parameter, where the finding has it under the planted name."""
    if (finding["effect"], finding.get("joint")) != (planted["effect"], planted["joint"]):
        return None
    name = _main(planted)
    value, true = _value(finding, name), planted["parameters"].get(name)
    return None if value is None or not true else abs(value - float(true)) / abs(float(true))


def _as_large(finding: Entry, planted: Entry) -> bool:
    if finding["effect"] != planted["effect"]:
        return True  # an equivalent has a size of its own
    value, true = _value(finding, _main(planted)), planted["parameters"].get(_main(planted))
    return value is None or not true or 1 / AS_LARGE <= value / float(true) <= AS_LARGE


def _is_off(finding: Entry, true: Entry) -> bool:
    """Whether a finding tells how far a nominal number is off."""
    for entry in true.get("off", ()):
        if (entry["effect"], entry["joint"]) == (finding["effect"], finding.get("joint")):
            scale = _value(finding, "scale")
            told, is_ = (
                (scale, entry["scale"])
                if scale is not None
                else (_value(finding, "coefficient"), entry["change"])
            )
            return told is not None and abs(told - is_) <= AS_OFF * abs(is_)
    return False


def _agreement(answers: Sequence[Entry]) -> float:
    """Names in all answers over names in any; 1 where nothing is named in any."""
    sets = [{(f["effect"], f.get("joint")) for f in _names(answer)} for answer in answers]
    every, any_ = set.intersection(*sets), set.union(*sets)
    return len(every) / len(any_) if any_ else 1.0
