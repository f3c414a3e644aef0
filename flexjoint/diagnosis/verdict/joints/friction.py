"""Ordinary friction of a joint: every machine has more or less Coulomb and viscous friction than its nominal
model, and rotors (`Effect.ordinary`), and what is left of a joint that has too little for a search may still
be that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.verdict.joints.by_itself import JointSet, Question, Stage, stands_out
from flexjoint.diagnosis.verdict.unseen.torques import Unseen, beyond_background, remaining
from flexjoint.effects import Planned

WHY = "it removes more than a background on data that its fit did not see"


def find(question: Question) -> JointSet | None:
    """The causes of a joint with ordinary friction beside them or, if that leaves no more, instead of them,
    without what of it does not stand out, the least of it first; None where none does. Causes of other joints
    are held. A law of two joints gives way to friction that leaves a twentieth less in its place."""
    seen, own, others = question.seen, question.own, question.others
    old = question.measured(own)
    joint = replace(question.joint, after=old.left)
    missing = _started(fit(seen, [*others, *own], held=others), question.candidates)
    if not missing:
        return None
    best = question.measured([*own, *missing])
    if own:
        alone = question.measured([*(e for e in own if e.effect.ordinary), *missing])
        less = alone.left <= seen.settings.verdict.better_without * old.left
        if less and _of_two_joints(own) and _alike(seen, joint, alone, old):
            return alone
        if _alike(seen, joint, alone, best):
            best = alone
    new = {one.key for one in missing}
    while stands_out(seen, joint, best.left):
        added = [e for e in best.effects if e.key in new]
        fewer = [question.measured([e for e in best.effects if e is not one]) for one in added]
        least = min(fewer, key=lambda one: one.left, default=None)
        if least is None:
            return None
        if stands_out(seen, replace(joint, after=least.left), best.left):
            return best
        best = least
    return None


def _of_two_joints(effects: Sequence[Planned]) -> bool:
    return any(e.effect.reaches_before for e in effects)


def _started(here: Fit, candidates: Sequence[Candidate]) -> list[Planned]:
    """Candidates that a set has not, at their best starts beside it. An onset is searched over the whole
    recording, and by chance one fits something small: here friction acts all the time."""
    taken = {e.key for e in here.effects}
    scanned = Scanner([c for c in candidates if c.key not in taken]).scan(here)
    return [replace(one, since=None).planned() for one in scanned]


def _alike(problem: Problem, joint: Remaining, one: JointSet, best: JointSet) -> bool:
    """Whether a set leaves more than another by less than a background, in any balance too: what moves torque
    from a motor to its link and back leaves their sum as it is."""
    usual = problem.settings.verdict.background_typical * joint.torque
    pairs = zip((one.left, *one.balances), (best.left, *best.balances), strict=True)
    return all(left**2 <= least**2 + min(usual, least) ** 2 for left, least in pairs)


def _ordinary(candidate: Candidate) -> bool:
    return candidate.effect.ordinary


def _open(data: Unseen) -> tuple[Remaining, ...]:
    """Joints of which much is left, and those whose friction is further off than a tolerance explains."""
    joints = remaining(data)
    much = beyond_background(joints, data.views[0].problem.settings.verdict)
    return (*much, *(one for one in joints if one.joint in data.doubted and one not in much))


def _holds(joint: Remaining, before: Unseen, after: Unseen) -> bool:
    """Whether friction stands out beside what was found of the other joints, too, or leaves no more than the
    law of two joints in whose place it is."""
    (left,) = [one.after for one in remaining(after) if one.joint == joint.joint]
    had, has = ([e for e in of.effects if e.joint == joint.joint] for of in (before, after))
    replaces = _of_two_joints(had) and not _of_two_joints(has)
    return stands_out(after.views[0].problem, joint, left) or (replaces and left <= joint.after)


FRICTION = Stage("friction", "friction", WHY, _ordinary, _open, find, _holds)
