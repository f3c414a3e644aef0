"""What a check says: each joint as it was or changed, with its numbers before and now."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from flexjoint.core.files import check_suffix, write_json
from flexjoint.core.text import EMPTY, Block, Line, Table, as_html, plain
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.result.wording import (
    NOTHING,
    Joints,
    capital,
    clean,
    effect_name,
    sentence,
    with_error,
    with_unit,
)

State = Literal["there", "moved", "gone", "not seen", "not tested"]
Verdict = Literal["as_before", "changed"]
WHOLE = "whole robot"


@dataclass(frozen=True)
class CheckedNumber:
    """A number of a cause as it was and as it is, with standard errors, all in `unit`; `distance` is how far
    it went in the standard errors of both."""

    parameter: str
    was: float
    was_std: float
    now: float
    now_std: float
    unit: str
    distance: float
    moved: bool = False

    def as_moved(self, moved: bool) -> CheckedNumber:
        return replace(self, moved=moved)

    def __str__(self) -> str:
        """gap 0.0112 ± 0.0002 rad, was 0.0150 ± 0.0003"""
        now = with_unit(with_error(self.now, self.now_std), self.unit)
        return f"{clean(self.parameter)} {now}, was {with_error(self.was, self.was_std)}"


@dataclass(frozen=True)
class CheckedCause:
    """A known cause: `there` with the numbers that it had, `moved`, `gone`; `not seen` where this recording
    cannot tell it from none; `not tested` where it was not believed to be there to begin with."""

    effect: str
    joint: str | None
    state: State
    numbers: tuple[CheckedNumber, ...]

    def __str__(self) -> str:
        """backlash moved (gap 0.0112 ± 0.0002 rad, was 0.0150 ± 0.0003)"""
        shown = [n for n in self.numbers if n.moved] or list(self.numbers[:1])
        return f"{effect_name(self.effect)} {self.state} ({'; '.join(str(n) for n in shown)})"


@dataclass(frozen=True)
class CheckedJoint:
    """A joint (None: causes of the whole robot). `left` is its torque error now, `was` as it was left before;
    None where no torque tells, or where it is not known. `grown` says why more is left, or is empty."""

    joint: str | None
    causes: tuple[CheckedCause, ...]
    left: Remaining | None
    was: Remaining | None
    grown: str = ""

    @property
    def changed(self) -> bool:
        return bool(self.grown) or any(c.state in ("moved", "gone") for c in self.causes)


@dataclass(frozen=True)
class Check:
    """What `check` found. `span` [s] and `rate` [Hz] are of the part of the recording that was looked at."""

    robot: str
    recording: str
    against: str
    joints: tuple[CheckedJoint, ...]
    span: tuple[float, float]
    rate: float
    notes: tuple[str, ...] = ()
    prismatic: frozenset[str] = frozenset()

    @property
    def verdict(self) -> Verdict:
        return "changed" if self.changed else "as_before"

    @property
    def changed(self) -> tuple[CheckedJoint, ...]:
        """The joints that are not as they were."""
        return tuple(joint for joint in self.joints if joint.changed)

    def __str__(self) -> str:
        return plain(self.summary())

    def _repr_html_(self) -> str:
        return as_html(self.summary())

    def summary(self) -> tuple[Block, ...]:
        """One line a joint, as blocks of text."""
        return tuple(_blocks(self))

    def to_json(self) -> dict[str, Any]:
        """The JSON form of `flexjoint check` (docs/reference/formats.md)."""
        return {
            "schema": 1,
            "verdict": self.verdict,
            "robot": self.robot,
            "recording": self.recording,
            "against": self.against,
            "span": list(self.span),
            "rate": self.rate,
            "joints": [_joint(joint) for joint in self.joints],
            "notes": list(self.notes),
        }

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the check as JSON, whole or not at all."""
        out = Path(path)
        check_suffix(out, (".json",))
        write_json(out, self.to_json())


def _joint(joint: CheckedJoint) -> dict[str, Any]:
    return {
        "joint": joint.joint,
        "state": "changed" if joint.changed else "as_before",
        "grown": joint.grown,
        "left": _left(joint.left),
        "was": _left(joint.was),
        "causes": [
            {
                "effect": cause.effect,
                "state": cause.state.replace(" ", "_"),
                "parameters": {
                    n.parameter: {k: v for k, v in asdict(n).items() if k != "parameter"}
                    for n in cause.numbers
                },
            }
            for cause in joint.causes
        ],
    }


def _left(left: Remaining | None) -> Mapping[str, Any] | None:
    if left is None:
        return None
    keys = ("torque", "after", "noise", "structured", "against")
    return {key: getattr(left, key) for key in keys}


def _blocks(check: Check) -> Iterator[Block]:
    words = "as before" if check.verdict == "as_before" else "changed"
    yield Line(
        f"{clean(check.robot)} {words}: {clean(check.recording)} against {clean(check.against)}", "bold"
    )
    joints = Joints(check.prismatic)
    rows = []
    for one in check.joints:
        name = clean(one.joint) if one.joint is not None else WHOLE
        left = _torque(joints, one.joint, one.left)
        was = _torque(joints, one.joint, one.was)
        causes = "; ".join(str(c) for c in one.causes if c.state != "not tested") or NOTHING
        rows.append((name, "changed" if one.changed else "as before", left, was, causes))
    heads = (("joint", False), ("", False), ("torque error", True), ("was", True), ("causes", False))
    yield Table(heads, tuple(rows))
    for one in check.joints:
        if one.grown and one.joint is not None:
            unit = joints.unit(one.joint)
            yield Line(sentence(f"{clean(one.joint)}: {one.grown}" + (f" [{unit}]" if unit else "")))
    begin, end = check.span
    yield EMPTY
    yield Line(f"Looked at {begin:.4g} to {end:.4g} s at {check.rate:.4g} Hz.", "dim")
    for note in check.notes:
        yield Line(sentence(capital(note)), "dim")


def _torque(joints: Joints, joint: str | None, left: Remaining | None) -> str:
    return NOTHING if left is None or joint is None else joints.torque(joint, left.after)
