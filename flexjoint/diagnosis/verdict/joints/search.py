"""A joint's causes, searched by themselves: the usual search (selection.py) with the balances of one joint
counted only, at the noise level of this joint."""

from __future__ import annotations

from dataclasses import replace

from flexjoint.diagnosis.balances.balances import acts_within_a_joint
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.search.rivals import Rivals
from flexjoint.diagnosis.search.selection import select
from flexjoint.diagnosis.verdict import checks
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.diagnosis.verdict.joints.by_itself import JointSet, Question, Stage, clears
from flexjoint.diagnosis.verdict.residuals import residual_views
from flexjoint.diagnosis.verdict.review import reviewed
from flexjoint.diagnosis.verdict.transients import pushes
from flexjoint.diagnosis.verdict.unseen.torques import Unseen, lefts, missing_causes

WHY = "searched by itself, its joint is left less wrong by more than a background with it, on data not fitted"


def search(question: Question) -> JointSet | None:
    """The causes that a search of the joint by itself finds in the place of those that act within it. What
    the joint has in common with others stays as it is. None where it clears nothing (`Question.clears`), of
    the only joint, which the usual search has looked at by itself, and where what is left is a push on its
    link: a law of the joint could only imitate it."""
    joint, best = question.joint, question.best
    if len({row.joint for row in best.problem.balances.rows}) == 1 or _pushed(question):
        return None
    within = [e for e in question.own if acts_within_a_joint(e)]
    others = [e for e in best.effects if not any(e is one for one in within)]
    problem = best.problem.of_joint(joint.joint, others)
    case = Case(select(problem, question.candidates, lambda _share, _what: None), ())
    found = reviewed(reviewed(case, checks.BALANCES), checks.NAMES).selection
    if {e.key for e in found.best.effects} <= {e.key for e in within}:
        return None
    shared = [e for e in question.own if not acts_within_a_joint(e)]
    new = question.measured([*shared, *found.best.effects])
    if not question.clears(new):
        return None
    pairs = zip(found.best.effects, found.rivals, strict=True)
    rivals = {e.key: Rivals.known(found.best, e.key, fits).sets for e, fits in pairs}
    sets = tuple(tuple((*shared, *one) for one in rivals.get(e.key, ())) for e in new.effects)
    return replace(new, rivals=sets)


def _pushed(question: Question) -> bool:
    """Whether an outside force on the joint's link is nearly all that is left of it."""
    best = question.best
    own = [view for view in residual_views(best, best) if view.joint == question.joint.joint]
    return bool(pushes(own, best.settings.verdict))


def _holds(joint: Remaining, before: Unseen, after: Unseen) -> bool:
    then, now = (lefts(data, joint.joint) for data in (before, after))
    return clears(joint, then, now, after.views[0].problem.settings)


JOINT_SEARCH = Stage("joint by joint", "causes", WHY, acts_within_a_joint, missing_causes, search, _holds)
