"""What became of one case: a record of run.py against its truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from planting.catalogue import law

from flexjoint_benchmark.score import EQUIVALENT

Record = dict[str, Any]
Key = tuple[str, str | None]

DETECTABLE = 1.1  # whitened excess per sample, from which a cause is there to be named
PARAMETER = 0.1  # relative error up to which a main parameter counts as right ...
DEVIATIONS = 3.0  # ... or this many of its own standard errors, ...
DETERMINED = 0.3  # ... if those are below this share of the value
ONSET = 0.5  # s
SURE = 0.9  # probability from which a name is a confident claim

OUTCOMES = ("exact", "tied", "inaccurate", "partial", "wrong", "unexplained", "healthy", "refused", "failed")
"""exact: every cause named, its main parameter right, nothing else named. tied: as exact, but a cause stands
in a finding's list of equivalents. inaccurate: names right, a parameter or an onset not. partial: right
names beside missing or false ones, or an equivalent that was not listed as such. wrong: verdict `causes`
without any right name. unexplained, healthy, refused: that verdict, without a right name. failed: an
error."""

GROUPS = EQUIVALENT
"""The same to any experiment (docs/explained/diagnosis.md, "Ties"); payload and tilt on one joint."""

STRUCK_EQUIVALENTS: dict[str, frozenset[str]] = {
    # a Coulomb level and a constant torque make the two levels
    "asymmetric_friction": frozenset({"motor_coulomb_friction", "torque_offset"}),
    "torque_delay": frozenset({"sensor_delay"}),  # of all sensors: the same machine, seen later
    "sensor_delay": frozenset({"torque_delay"}),
    "friction_drift": frozenset({"motor_coulomb_friction"}),  # a time constant far above the recording
    "encoder_eccentricity": frozenset({"transmission_error"}),  # of one cycle
}
"""Besides the groups: what together is the struck effect, to within what this recording can show."""


@dataclass(frozen=True)
class Match:
    """How one planted cause fared: exact | tied | equivalent | missed."""

    truth: Record
    kind: str
    finding: Record | None


def key(entry: Record) -> Key:
    return entry["effect"], entry["joint"]


def matches(record: Record) -> list[Match]:
    """Every planted cause with the finding that stands for it, each for one of them where that can be."""
    found: Sequence[Record] = record.get("findings", ())
    out: list[Match] = []
    for truth in record["truth"]:
        own = [f for f in found if is_name_of(f, truth, record)]
        ties = [f for f in found if list(key(truth)) in f["ties"]]
        equal = [f for f in found if f["joint"] == truth["joint"] and _same(f["effect"], truth["effect"])]
        kinds = (("exact", own), ("tied", ties), ("equivalent", equal))
        taken = [id(m.finding) for m in out]
        kind, finding = next(
            ((k, min(fs, key=lambda f: id(f) in taken)) for k, fs in kinds if fs), ("missed", None)
        )
        out.append(Match(truth, kind, finding))
    return out


def is_name_of(finding: Record, truth: Record, record: Record) -> bool:
    """Whether a finding is a planted cause by name; one of the robot's only joint is one of the robot."""
    of_robot = record["joints"] == 1 and finding["effect"] == truth["effect"] and finding["joint"] is None
    return key(finding) == key(truth) or of_robot


def _same(one: str, other: str) -> bool:
    return any({one, other} <= group for group in GROUPS)


def false_names(record: Record) -> list[Record]:
    """Findings that stand for no planted cause."""
    used = [id(m.finding) for m in matches(record)]
    return [f for f in record.get("findings", ()) if id(f) not in used]


def outcome(record: Record) -> str:
    """One of OUTCOMES, for a case with causes whose effects were in the catalogue."""
    if record["verdict"] in ("error", "crash"):
        return "failed"
    fared = matches(record)
    kinds = {m.kind for m in fared}
    if kinds <= {"exact", "tied"} and record["verdict"] == "causes" and not false_names(record):
        if all(_accurate(m) for m in fared if m.kind == "exact"):
            return "exact" if kinds == {"exact"} else "tied"
        return "inaccurate"
    if kinds != {"missed"}:
        return "partial"
    return "wrong" if record["verdict"] == "causes" else str(record["verdict"])


def _accurate(match: Match) -> bool:
    assert match.finding is not None
    true, fitted = match.truth, match.finding
    if any(fitted["parameters"].get(name) != word for name, word in true.get("words", {}).items()):
        return False
    if true["since"] is not None:
        if fitted["since"] is None or abs(fitted["since"] - true["since"]) > ONSET:
            return False
    elif fitted["since"] is not None:
        return False
    error, std, size = main_error(match)
    return error <= PARAMETER * size or (error <= DEVIATIONS * std and std <= DETERMINED * size)


def main_parameter(truth: Record) -> str:
    """The parameter that tells an effect's size."""
    if truth["effect"] == "base_tilt":
        return max(("roll", "pitch"), key=lambda name: abs(truth["parameters"][name]))
    return law(truth["effect"]).required[0]


def main_error(match: Match) -> tuple[float, float, float]:
    """Error, standard error and true size of the main parameter."""
    assert match.finding is not None
    name = main_parameter(match.truth)
    fitted, true = match.finding["parameters"][name], float(match.truth["parameters"][name])
    return abs(fitted["value"][0] - true), fitted["std"][0], abs(true)


def deviations(match: Match) -> list[tuple[str, float]]:
    """(parameter, error in its standard errors) of every number of a cause that was named."""
    assert match.finding is not None
    out = []
    for name, true in match.truth["parameters"].items():
        fitted = match.finding["parameters"].get(name)
        if not isinstance(fitted, dict):
            continue
        error = np.array(fitted["value"]) - np.ravel(true)
        if name == "phase":
            error = (error + np.pi) % (2 * np.pi) - np.pi
        std = np.array(fitted["std"])
        out += [(name, float(e / s)) for e, s in zip(error, std, strict=True) if s > 0]
    return out


def detectable(record: Record) -> bool:
    return record["excess"] is not None and record["excess"] > DETECTABLE


def each_detectable(record: Record) -> bool:
    """Whether each of several causes is there to be named beside the others."""
    return (record.get("least_excess") or 0.0) > DETECTABLE


STRUCK_OUTCOMES = ("unexplained", "equivalent", "unsure", "wrong", "healthy", "refused", "failed")
"""unexplained: that verdict, without a confident name; equivalent: only what the struck effect amounts to;
unsure: names of a probability below SURE only; wrong: a confident wrong name; the rest: that verdict."""


def struck_outcome(record: Record) -> str:
    """One of STRUCK_OUTCOMES, for a case whose effect was taken out of the catalogue."""
    verdict = record["verdict"]
    if verdict in ("error", "crash"):
        return "failed"
    (truth,) = record["truth"]
    names = [f for f in record["findings"] if not equivalent(f, truth)]
    if any(f["probability"] >= SURE for f in names) and verdict == "causes":
        return "wrong"
    if verdict in ("unexplained", "healthy", "refused"):
        return str(verdict)
    return "unsure" if names else "equivalent"


def equivalent(finding: Record, truth: Record) -> bool:
    """Whether a finding is what a struck effect amounts to."""
    effect = finding["effect"]
    same = _same(effect, truth["effect"]) or effect in STRUCK_EQUIVALENTS.get(truth["effect"], ())
    return same and (finding["joint"] == truth["joint"] or None in (finding["joint"], truth["joint"]))


def instead(record: Record) -> list[str]:
    """What was named in place of the planted causes: effects, the joint told where it is another one."""
    planted = {t["joint"] for t in record["truth"]}
    return [
        f["effect"] + ("" if f["joint"] in planted or f["joint"] is None else " (other joint)")
        for f in false_names(record)
    ]
