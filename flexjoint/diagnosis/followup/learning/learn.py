"""Laws without a name: what the likely causes leave, followed by a smooth law of one signal or two.

A finished diagnosis is taken as it is, and never changed. At joints at which an error is left, laws of one
signal compete (splines.py), each foretelling parts of time that were left out of its own fit; the best of
them also over a half, a quarter and an eighth of its range at either end. All of that is then repeated
without one stretch of time after another, which is foretold and simulated, and a law is kept where that is
better (judge.py, simulation.py). Its numbers come from the whole of the recordings. Where no law of one
signal is kept, those of two are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, checkpoint, within
from flexjoint.core.running.progress import Report, silent
from flexjoint.core.running.worker_pool import one_thread
from flexjoint.diagnosis.followup.learning.advice import advice
from flexjoint.diagnosis.followup.learning.evidence import Evidence, Part
from flexjoint.diagnosis.followup.learning.judge import Verdict, foretold, judged
from flexjoint.diagnosis.followup.learning.likeness import likenesses
from flexjoint.diagnosis.followup.learning.simulation import held
from flexjoint.diagnosis.followup.learning.splines import (
    PARTS,
    POINTS,
    SECTIONS,
    Choice,
    Fitted,
    Shape,
    chosen,
    coefficients,
    coefficients_of,
    fitted,
    followed,
    part_of,
    ranges_of,
    shape_of,
)
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import LEAST, Diagnosis, Learned, LearnedLaw, Likeness, Section
from flexjoint.diagnosis.search.candidates import Candidate, visible
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.effects import Planned, catalogue
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording, expect_several
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot, expect

UNITS = {  # of signals; rad else
    **dict.fromkeys(("tau_t", "tau_m", "tau_m_before", "tau_m_after"), "N m"),
    **dict.fromkeys(("dtheta", "dq"), "rad/s"),
}


@one_thread
def learn(
    robot: Robot,
    recordings: Recording | Sequence[Recording],
    diagnosis: Diagnosis,
    *,
    payloads: Sequence[KnownPayload | None] = (),
    settings: Settings = USUAL,
    budget: Budget = UNLIMITED,
    progress: Report = silent,
) -> Diagnosis:
    """The diagnosis with what was `learned`: laws of one or two signals of a joint through what its likely
    causes leave, each kept only where it holds on data that it did not see. Nothing else of it changes;
    `Diagnosis.extend` then puts the laws into the model, too.

    Args:
        robot: the nominal model.
        recordings: those that were diagnosed, one or several; a law holds in all of them.
        diagnosis: what `diagnose` said of them.
        payloads: as in `diagnose`.
        settings: the numbers that decide (docs/reference/settings.md).
        budget: the time that it may take; joints that are not looked at in it are named in the notes.
        progress: called with a share in [0, 1] and what is being done.

    Raises:
        RecordingError: a recording cannot be used with this robot, or not one payload for each.
        FlexJointError: the diagnosis is of another robot.
    """
    robot = expect(robot, "learn")
    recordings = expect_several(recordings, "learn")
    if not isinstance(diagnosis, Diagnosis):
        raise FlexJointError(
            f"learn: expected what diagnose returns, got a {type(diagnosis).__name__}; diagnose first"
        )
    if payloads and len(payloads) != len(recordings):
        raise RecordingError(f"expected {len(recordings)} payloads, got {len(payloads)}")
    joints = _left(robot, diagnosis, settings)
    if not joints:
        return replace(diagnosis, learned=Learned())
    base = replace(diagnosis, learned=None).extend(robot)  # which checks the names
    causes = [e for e in base.effects if e not in robot.effects]
    robots = [robot if load is None else load.on(robot) for load in payloads or [None] * len(recordings)]
    parts, _ = excerpts(robots[0], [of_robot(robot, one) for one in recordings], budget.seconds)
    evidence = Evidence.of(robots, parts, causes, settings)
    if evidence.too_short:
        note = f"no law was learned: that takes {evidence.too_short:g} s of motion in each recording"
        return replace(diagnosis, learned=Learned(notes=(note,)))
    found, notes = _learned(evidence, joints, budget, progress)
    try:
        with within(budget):
            kept, simulation = held(evidence, [one.verdict for one in found])
        dropped = "the simulation was not surely better with it"
    except OutOfTimeError:
        kept, simulation = [], None
        dropped = "the time allowed was over before the simulation could confirm it"
    notes += tuple(
        f"a law of {one.choice.shape.law} was dropped: {dropped}" for one in found if one.verdict not in kept
    )
    laws = _stated(evidence, [one for one in found if one.verdict in kept])
    return replace(diagnosis, learned=Learned(laws, simulation, notes))


def _left(robot: Robot, diagnosis: Diagnosis, settings: Settings) -> list[str]:
    """Joints at which the model with the likely causes leaves an error beyond noise and tolerance, and those
    of causes that are not likely enough to be in the model; none of a healthy machine."""
    if diagnosis.verdict in ("healthy", "refused"):
        return []
    likely, limits = diagnosis.likely(LEAST), settings.verdict
    names = [u.joint for u in diagnosis.unexplained]
    floor = settings.learn.size * robot.tolerance.torque
    for left in diagnosis.remaining:
        if left.after > max(limits.above_noise * left.noise, floor * left.torque):
            names.append(left.joint)
    for finding in diagnosis.findings:
        if finding not in likely:
            names += [one.joint for one in finding.members or (finding.planned,) if one.joint is not None]
            names += [finding.removed.joint] if finding.removed is not None else []
    return list(dict.fromkeys(names))


@dataclass(frozen=True)
class _Kept:
    """A law as it was chosen from everything, and what it does to data that it does not see."""

    choice: Choice
    law: Planned
    verdict: Verdict


def _learned(
    evidence: Evidence, joints: Sequence[str], budget: Budget, progress: Report
) -> tuple[list[_Kept], tuple[str, ...]]:
    found: list[_Kept] = []
    late = []
    for k, joint in enumerate(joints):
        progress(k / len(joints), f"learning what is left of {joint}")
        try:
            with within(budget):
                for _ in range(evidence.limits.most):
                    checkpoint()
                    law = _Search(evidence, joint, [one.law for one in found]).law()
                    if law is None:
                        break
                    found.append(law)
        except OutOfTimeError:
            late.append(joint)
    return found, (f"the time allowed was over before {', '.join(late)} could be learned",) if late else ()


@dataclass(frozen=True)
class _Search:
    """The laws that a joint could have beside causes and other laws."""

    evidence: Evidence
    joint: str
    laws: Sequence[Planned]
    nearer: dict[str, list[Shape]] = field(default_factory=dict)  # by signal: shapes over parts of its range

    @property
    def base(self) -> list[Planned]:
        return [*self.evidence.causes, *self.laws]

    def law(self) -> _Kept | None:
        """The best law of one signal, if it is good enough; else the best of two, if that is."""
        return self._best(1) or self._best(2)

    def _best(self, signals: int) -> _Kept | None:
        problems = self.evidence.problems
        taken = {e.key for e in problems[0].with_nominal(self.base)}
        ys = self.evidence.residuals(self.base)
        shapes = [
            shape
            for candidate in _candidates(problems[0], self.joint, signals)
            if candidate.key not in taken
            if (shape := shape_of(problems, candidate, self.base, self.evidence.limits)) is not None
        ]
        evidence, choice = self._at_what_is_left(shapes, ys)
        if choice is None:
            return None
        own = [s for s in shapes if _follows(s.law) == _follows(choice.shape.law)]
        known: dict[Part, np.ndarray] = {}
        centred, other = (
            self._tried(evidence, own, replace(choice, centred=c), ys, known) for c in (True, False)
        )
        if centred is None or other is None:
            return centred or other
        limit = evidence.limits.worse_place
        return centred if centred.verdict.removed.left <= limit * other.verdict.removed.left else other

    def _at_what_is_left(
        self, shapes: Sequence[Shape], ys: Sequence[np.ndarray]
    ) -> tuple[Evidence, Choice | None]:
        """The best law, and the evidence at the noise level that it leaves: an error without a cause counts
        as noise, and hides the law that explains it."""
        evidence, choice = self.evidence, self._chosen(self.evidence, shapes, ys)
        for _ in range(evidence.limits.rounds):
            if choice is None:
                break
            c = np.array(coefficients(fitted(evidence.problems, choice, ys).law))
            left = [y + c @ columns for y, columns in zip(ys, choice.shape.columns, strict=True)]
            evidence = evidence.at(
                [p.plausible_level(rest) for p, rest in zip(evidence.problems, left, strict=True)]
            )
            choice = self._chosen(evidence, shapes, ys)
        return evidence, choice

    def _chosen(self, evidence: Evidence, shapes: Sequence[Shape], ys: Sequence[np.ndarray]) -> Choice | None:
        """The law and the smoothness that foretell best what is left out of their fit; None where none
        foretells anything."""
        choices = [chosen(evidence.problems, shape, ys, evidence.folds) for shape in shapes]
        best = min(choices, key=lambda choice: choice.foretold, default=None)
        if best is None:
            return None
        nearer = [chosen(evidence.problems, shape, ys, evidence.folds) for shape in self._nearer(best.shape)]
        near = min(nearer, key=lambda choice: choice.foretold, default=best)
        if near.foretold <= evidence.limits.part * best.foretold:
            best = near
        return best if best.foretold < 1.0 else None

    def _nearer(self, shape: Shape) -> list[Shape]:
        if len(shape.law.effect.words) > 1:
            return []
        name = " ".join(_follows(shape.law))
        if name not in self.nearer:
            parts = [part_of(self.evidence.problems, shape, part, self.base) for part in PARTS]
            self.nearer[name] = [part for part in parts if part is not None]
        return self.nearer[name]

    def _tried(
        self,
        evidence: Evidence,
        shapes: Sequence[Shape],
        choice: Choice,
        ys: Sequence[np.ndarray],
        known: dict[Part, np.ndarray],
    ) -> _Kept | None:
        """The law, if it is worth having."""
        limits = evidence.limits
        law = fitted(evidence.problems, choice, ys).law

        def make(others: Evidence) -> Planned | None:
            own = self._chosen(others, shapes, ys)
            if own is None:
                return None
            one = fitted(others.problems, replace(own, centred=choice.centred), ys)
            return one.law if one.certainty >= limits.sure else None

        verdict = judged(evidence, law, foretold(self.evidence, evidence, self.base, law, make, known))
        removed, robot = verdict.removed, evidence.robots[0]
        size = np.sqrt(max(0.0, removed.without**2 - removed.left**2))
        scale = float(evidence.problems[0].torque_scale[robot.joint_names.index(self.joint)])
        if size < limits.size * robot.tolerance.torque * scale:
            return None
        if verdict.share < limits.share or verdict.sure < limits.sure:
            return None
        if verdict.place > limits.worse_place or verdict.stretch > limits.worse_stretch:
            return None
        return _Kept(choice, law, verdict)


def _follows(law: Planned) -> tuple[str, ...]:
    """What sort of law it is: an effect, and its signals."""
    return law.effect.name, *followed(law)


# ------------------------------------------------------------------ what is said
def _stated(evidence: Evidence, kept: Sequence[_Kept]) -> tuple[LearnedLaw, ...]:
    """The laws with their numbers beside those laws that were kept before them."""
    out: list[LearnedLaw] = []
    for one in kept:
        base = [*evidence.causes, *(law.planned for law in out)]
        ys = evidence.residuals(base)
        own = fitted(evidence.problems, one.choice, ys)
        c = np.array(coefficients(own.law))
        left = [y + c @ columns for y, columns in zip(ys, one.choice.shape.columns, strict=True)]
        levels = [p.plausible_level(rest) for p, rest in zip(evidence.problems, left, strict=True)]
        final = fitted(evidence.at(levels).problems, one.choice, ys)
        alike = likenesses(evidence.problems[0], base, final.law)
        out.append(_law(evidence, one, final, alike))
    return tuple(out)


def _law(evidence: Evidence, one: _Kept, final: Fitted, alike: tuple[Likeness, ...]) -> LearnedLaw:
    law = final.law
    joint, (signal, *others) = law.joint or "", followed(law)
    at, value, std = final.curve(POINTS)
    size = coefficients_of(law)
    sliding = joint in evidence.robots[0].prismatic

    def unit(of: str) -> str:
        return replace(size, unit=UNITS.get(of, "rad")).unit_at(sliding)

    return LearnedLaw(
        law.effect.name,
        joint,
        signal,
        law,
        tuple(at.tolist()),
        unit(signal),
        tuple(value.tolist()),
        tuple(std.tolist()),
        size.unit_at(sliding),
        final.freedom,
        one.verdict.removed,
        one.verdict.share,
        alike,
        advice(law.effect.name, signal, *others),
        "".join(others),
        "".join(unit(other) for other in others),
        tuple(_section(final, share) for share in SECTIONS) if others else (),
    )


def _section(final: Fitted, share: float) -> Section:
    """A law of two signals where the other is at a share of its range."""
    _, (start, span) = ranges_of(final.law)
    _, value, std = final.curve(POINTS, share)
    return Section(start + share * span, tuple(value.tolist()), tuple(std.tolist()))


def _candidates(problem: Problem, joint: str, signals: int) -> list[Candidate]:
    """Every learned law of so many signals that the sensors of this recording could show at a joint."""
    rigid = problem.robot.joint(joint).rigid
    out = []
    for effect in catalogue().values():
        if effect.is_cause or len(effect.words) != signals:
            continue
        names = [word.name for word in effect.words]
        for chosen_ones in combinations(effect.words[0].choices, signals):
            if rigid and "tau_t" in chosen_ones:  # a rigid joint's model has no spring that tells it
                continue
            candidate = Candidate(effect, joint, tuple(zip(names, chosen_ones, strict=True)))
            if visible(problem, candidate):
                out.append(candidate)
    return out
