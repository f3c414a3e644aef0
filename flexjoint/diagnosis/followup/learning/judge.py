"""Whether a law is worth having: what it removes of data that it was not made of.

Every stretch of time is left out in turn, and foretold by a law of the same signal that was smoothed and
fitted on all others. A law is kept if these remove enough of the joint's torque error, surely; if no stretch,
and no place of its signal, has a larger error with them than without; and if the simulation of the stretches,
each with its own law, is not worse (`simulation.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.followup.learning.evidence import Evidence, Part, read_time
from flexjoint.diagnosis.followup.learning.places import worst_place
from flexjoint.diagnosis.followup.learning.splines import followed, signals_of
from flexjoint.diagnosis.result import Removed
from flexjoint.diagnosis.verdict.unseen.torques import left_beside
from flexjoint.effects import Planned

Make = Callable[[Evidence], Planned | None]  # a law of some evidence; None where that supports none


@dataclass(frozen=True)
class Foretold:
    """What is left of the joint's balances [N m] on a stretch, without a law and with the one of the others;
    (balances, N)."""

    part: Part
    law: Planned | None
    without: np.ndarray
    left: np.ndarray
    signals: np.ndarray  # (signals, N) what the law of the whole follows
    block: np.ndarray  # (N,) number of a block of time


@dataclass(frozen=True)
class Verdict:
    """What a law removes of data that it was not made of. `removed` in the balance that it clears most, and
    `share` of the squared error of that, noise included; `sure`: in all balances, in standard errors;
    `stretch`, `place`: times the error (RMS) on the stretch, and at the place of the signal, where that is
    most."""

    removed: Removed
    share: float
    sure: float
    stretch: float
    place: float
    laws: tuple[tuple[Part, Planned | None], ...]


def foretold(
    before: Evidence,
    after: Evidence,
    base: Sequence[Planned],
    law: Planned,
    make: Make,
    known: dict[Part, np.ndarray],
) -> list[Foretold]:
    """All stretches, without the law at the noise level `before` it, and with it at the one that it leaves;
    `known` remembers what is left without it."""
    out = []
    for (part, bare), (_, others) in zip(before.without(), after.without(), strict=True):
        problem = others.problems[part.recording]
        own = [problem.robot.joints[row.joint].name == law.joint for row in problem.balances.rows]
        time = read_time(problem)
        here = part.holds(time)
        if part not in known:
            known[part] = left_beside(bare.problems[part.recording], base)
        made = make(others)
        left = known[part] if made is None else left_beside(problem, [*base, made])
        block = (time[here] / problem.settings.regression.time_block).astype(int)
        signals = signals_of(problem, law)[:, here]
        out.append(Foretold(part, made, known[part][own][:, here], left[own][:, here], signals, block))
    return out


def judged(evidence: Evidence, law: Planned, stretches: Sequence[Foretold]) -> Verdict:
    """The squared errors of a joint's balances count in those of each balance's noise level."""
    problem = evidence.problems[0]
    own = [
        k for k, row in enumerate(problem.balances.rows) if problem.robot.joints[row.joint].name == law.joint
    ]
    deviation = np.array([[p.deviation[k] for k in own] for p in evidence.problems])
    level = np.array([[p.level.inflation[k] for k in own] for p in evidence.problems])
    weight = 1.0 / np.maximum(deviation**2 * level, 1e-300)

    def squares(series: np.ndarray, one: Foretold) -> np.ndarray:
        return np.asarray(weight[one.part.recording] @ series**2)

    before = np.concatenate([_by_block(squares(s.without, s), s.block) for s in stretches])
    after = np.concatenate([_by_block(squares(s.left, s), s.block) for s in stretches])
    first, last = (
        np.sqrt(np.mean(np.concatenate([x for x in series], axis=1) ** 2, axis=1))
        for series in ([s.without for s in stretches], [s.left for s in stretches])
    )
    usual = np.sqrt(np.mean(deviation**2, axis=0))
    at = int(np.argmax((first - last) / np.maximum(last, usual)))
    without, left = (
        np.concatenate(series, axis=1)
        for series in ([s.without for s in stretches], [s.left for s in stretches])
    )
    signals = np.concatenate([s.signals for s in stretches], axis=1)
    place = max(worst_place(signal, without, left, usual) for signal in signals)
    stretch = max(
        float(np.sqrt(_over(squares(s.left, s), squares(s.without, s), weight[s.part.recording] @ usual**2)))
        for s in stretches
    )
    where = problem.balances.rows[own[at]]
    return Verdict(
        Removed(law.joint or "", where.balance, float(first[at]), float(last[at]), 0.0, followed(law)[0]),
        1.0 - float(last[at]) ** 2 / max(float(first[at]) ** 2, 1e-300),
        gained(before, after).sure,
        stretch,
        place,
        tuple((s.part, s.law) for s in stretches),
    )


@dataclass(frozen=True)
class Gained:
    """The share of a squared error that is removed, with its standard error."""

    share: float
    std: float

    @property
    def sure(self) -> float:
        """The share in its standard errors."""
        return self.share / max(self.std, 1e-300)


def gained(before: np.ndarray, after: np.ndarray) -> Gained:
    """What becomes of squared errors (blocks,), summed over blocks of time. The standard error is that of a
    ratio of sums over blocks that differ in size (Cochran 1977, section 2.11)."""
    whole = max(float(np.sum(before)), 1e-300)
    share = float(np.sum(before - after)) / whole
    rest = before - after - share * before
    spread = float(np.sqrt(before.size / max(1.0, before.size - 1.0) * np.sum(rest**2)))
    return Gained(share, spread / whole)


def _by_block(squares: np.ndarray, block: np.ndarray) -> np.ndarray:
    return np.bincount(block - block[0], squares)


def _over(last: np.ndarray, first: np.ndarray, noise: float) -> float:
    """Mean square over mean square; an error below noise counts as noise."""
    return float(np.mean(last)) / max(float(np.mean(first)), noise, 1e-300)
