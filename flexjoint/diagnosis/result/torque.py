"""The torque error of joints and what each cause removes of it, on data that the fit did not see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from flexjoint.diagnosis.result.values import Finding, Remaining, Result
from flexjoint.diagnosis.result.wording import Joints, clean, less, number, percent, ratio
from flexjoint.diagnosis.settings import USUAL

BALANCES = {
    "motor": "torque error",
    "link": "torque error of the link",
    "spring": "error of the spring's torque",
}
SHORT = {"link": "of the link", "spring": "spring's torque"}  # in a narrow column of torque errors


@dataclass(frozen=True)
class Row:
    """One joint of the table "Torque error by joint"; all in words."""

    joint: str
    torque: str
    before: str
    after: str
    of_before: str
    of_torque: str
    times_noise: str


@dataclass(frozen=True)
class Table:
    unit: str  # common to all rows; empty where each has its own
    rows: tuple[Row, ...]
    more: int


def table(diagnosis: Result, joints: Joints, most: int) -> Table | None:
    """The joints in the robot's order; where there are more than `most`, those of which most is left."""
    kept = sorted(diagnosis.remaining, key=of_torque, reverse=True)[:most]
    kept = [r for r in diagnosis.remaining if r in kept]
    if not kept:
        return None
    units = {joints.unit(r.joint) for r in kept}
    unit = units.pop() if len(units) == 1 else ""
    return Table(unit, tuple(_row(r, joints, bool(unit)) for r in kept), len(diagnosis.remaining) - len(kept))


def reading(diagnosis: Result) -> str:
    """How to read the table."""
    left = "Then what is left: as a share of before and of the torque, and in times the sensors' noise."
    if not diagnosis.findings:
        return f"Before: nominal model. Tolerances: its numbers anywhere within their tolerances. {left}"
    causes = "all causes listed, possible ones too, and the nominal numbers within their tolerances"
    return f"Before: nominal model. After: {causes}. {left}"


def _row(left: Remaining, joints: Joints, bare: bool) -> Row:
    sizes = (left.torque, left.before, left.after)
    torque, before, after = (number(x) if bare else joints.torque(left.joint, x) for x in sizes)
    return Row(
        clean(left.joint),
        torque,
        before,
        after,
        percent(ratio(left.after, left.before)),
        percent(ratio(left.after, left.torque)),
        number(ratio(left.after, left.noise), 2),
    )


def of_torque(left: Remaining) -> float:
    """What is left as a share of the joint's torque; 0 where the joint bears none."""
    return _finite(ratio(left.after, left.torque))


def most_wrong(remaining: Sequence[Remaining]) -> Remaining | None:
    """The joint whose torque the nominal model gets wrong by the largest share."""
    return max(remaining, key=lambda r: _finite(ratio(r.before, r.torque)), default=None)


def most_left(remaining: Sequence[Remaining]) -> Remaining | None:
    """The joint of whose torque the largest share is left."""
    return max(remaining, key=of_torque, default=None)


def shaped(remaining: Sequence[Remaining]) -> Remaining | None:
    """The joint of which a smooth law of one signal would still remove most, where that is a good part."""
    limits = USUAL.verdict
    telling = [
        r
        for r in remaining
        if r.structured >= limits.telling * r.after > 0.0 and r.after > limits.above_noise * r.noise
    ]
    return max(telling, key=lambda r: _finite(ratio(r.structured, r.torque)), default=None)


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


@dataclass(frozen=True)
class Removal:
    """What a cause removes, in words."""

    balance: str  # torque error, error of the spring's torque
    short: str  # the same under a heading "torque error"
    where: str  # the joint, where it is not the cause's own
    fall: str  # 53 → 2.2 N
    less: str  # 96 % less
    share: float  # in [0, 1], for a bar

    def __str__(self) -> str:
        where = f" at {self.where}" if self.where else ""
        part = f" ({self.less})" if self.less else ""
        return f"{self.balance}{where} {self.fall}{part}"


def balance(name: str, joints: Joints) -> str:
    """What is wrong in a balance, in words."""
    known = BALANCES.get(name, f"error of the {clean(name)} balance")
    return BALANCES["motor"] if joints.rigid else known


def by_size(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Causes as they are told: first the one that removes most torque error [N m, RMS], on data that the fit
    did not see. `Finding.gain` counts in noise, so that a friction of 1 % at a quiet joint may gain more than
    a load that is a tenth of the torque of others."""

    def size(finding: Finding) -> float:
        removed = finding.removed
        return 0.0 if removed is None else math.sqrt(max(0.0, removed.without**2 - removed.left**2))

    return tuple(sorted(findings, key=lambda f: (-size(f), -f.gain)))


def removal(finding: Finding, joints: Joints) -> Removal | None:
    """The error of the extended model without the cause and with it; None where it was not measured."""
    removed = finding.removed
    if removed is None:
        return None
    share = _finite(1.0 - ratio(removed.left, removed.without))
    return Removal(
        balance(removed.balance, joints),
        "" if joints.rigid else SHORT.get(removed.balance, ""),
        "" if removed.joint == finding.joint else clean(removed.joint),
        joints.fall(removed.joint, removed.without, removed.left),
        less(removed.without, removed.left),
        min(max(share, 0.0), 1.0),
    )
