"""Rivals that explain a recording as well as a cause does, and the probability of the cause against the
others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.result import Remaining, Tie
from flexjoint.diagnosis.result.wording import percent
from flexjoint.diagnosis.search.criteria import score, unexplained_energy
from flexjoint.diagnosis.verdict.unseen.torques import lowered, small_errors
from flexjoint.effects import Kind, Planned


def ties(
    best: Fit, planned: Planned, rivals: Sequence[Fit], explained: float | None = None
) -> tuple[Tie, ...]:
    """Rivals that fit as well. One that contains the found effect as a special case is a rival only where its
    further numbers explain more than chance does, and less than would name it. `explained` is the energy that
    the effect explains; by default that in this recording."""
    limits = best.settings.verdict
    out: list[Tie] = []
    if not rivals:
        return ()
    if explained is None:
        explained = refit_without(best, planned).energy - best.energy
    for rival in rivals:
        other = rival.effects[-1]
        delays = [e.effect.kind is Kind.TIMING for e in (planned, other)]
        moved = any(delays)
        margin = (
            limits.tie
            + (limits.tie_moved if moved else 0.0)
            + best.settings.search.unexplained_share * unexplained_energy(best)
        )
        behind = score(rival) - score(best)
        wider = planned.effect.name in other.effect.contains
        hinted = best.energy - rival.energy > limits.sure**2
        if (wider and not hinted) or len(out) >= limits.most_ties:
            continue
        if any((tie.effect, tie.joint) == (other.effect.name, other.joint) for tie in out):
            continue  # from another start
        why = ""
        # a load along shifted angles is known to first order in the shift
        errors = best.settings.search
        share = errors.method_error if all(delays) else errors.finer_method_error
        little = rival.energy - best.energy < share * explained
        if wider and behind <= margin:
            better = best.energy - rival.energy
            text = (
                f"contains it as a special case and fits a little better (by {better:.1f} in chi-square): the"
                " data do not tell whether its further numbers are needed"
            )
            out.append(Tie(other.effect.name, other.joint, text))
        if wider:
            continue
        if behind <= margin:
            why = (
                f"fits these data as well (its score differs by {behind:+.1f}; up to {margin:.0f} is chance)"
            )
        elif little and all(delays):
            why = f"fits these data as well to first order in a delay (its score differs by {behind:+.1f})"
        elif little and not _worse_throughout(best, rival):
            why = f"fits these data as well except at single moments (its score differs by {behind:+.1f})"
        if why:
            out.append(Tie(other.effect.name, other.joint, why))
    return tuple(out)


def special_cases(best: Fit, planned: Planned, own: Remaining | None) -> tuple[Tie, ...]:
    """Simpler laws that the found one contains, where its further numbers remove no more of its joint's
    torque than the small errors do that are left there (`own`): these may be what the numbers describe.
    Their sum is no noise, so no chi-square tells how much of it a number takes up by chance."""
    if own is None or planned.since is not None:
        return ()
    out = []
    for name in planned.effect.contains:
        simpler = planned.special_cases(name)
        others = [e for e in best.effects if e is not planned]
        if any(e.key in {one.key for one in simpler} for e in others):
            continue
        more = lowered(best, [*others, *simpler], own.joint)
        if more < small_errors(own, best.settings.verdict):
            text = (
                f"is a special case of it, with which {percent(more / own.torque)} of the joint's torque are"
                " left: small errors that have no name make as much there"
            )
            out.append(Tie(name, planned.joint, text))
    return tuple(out)


def _worse_throughout(best: Fit, rival: Fit) -> bool:
    """Whether a rival leaves more energy all over the recording, and not only at single moments, as errors of
    the method do (a filter around an onset or a kink): then the differences of the time blocks scatter as
    much as their sum (Vuong 1989, with blocks for samples)."""
    differences = _by_block(rival) - _by_block(best)
    scatter = float(np.sqrt(np.sum(differences**2)))
    return float(np.sum(differences)) > best.settings.verdict.throughout * scatter


def _by_block(result: Fit) -> np.ndarray:
    """Energy that a fit leaves in each time block, the nominal numbers at their best."""
    problem, time = result.problem, result.problem.time
    settings = result.settings
    whole = float(time[-1] - time[0])
    length = min(settings.regression.time_block, whole / settings.verdict.time_blocks)
    blocks = np.tile(((time - time[0]) / length).astype(int), len(problem.balances.rows))
    return np.bincount(blocks, (problem.rest(result.y) * problem.weights) ** 2)


def preferred(best: Fit, planned: Planned, rivals: Sequence[Fit], tied: Sequence[Tie]) -> float:
    """Probability of a cause, or of one that fits as well, against its rivals: from the margin over the best
    rival that does not fit as well."""
    equal = {(tie.effect, tie.joint) for tie in tied}
    name = planned.effect.name  # a law that contains it as a special case is no rival
    others = [
        r for r in rivals if r.effects[-1].key not in equal and name not in r.effects[-1].effect.contains
    ]
    margin = min((score(r) - score(best) for r in others), default=40.0)
    against = 1.0 / (1.0 + np.exp(-0.5 * np.clip(margin, -40.0, 40.0)))
    return float(against)
