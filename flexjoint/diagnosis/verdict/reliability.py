"""How reliable the name of a cause is, from what is left beside it.

A cause that explains all that is wrong in its balances leaves only the sensors' noise in them; a wrong one,
named instead of another, leaves more, and more of what it found: the model of a friction that sticks is right
to some share of what it explains only. On planted machines, some of which have an effect that is in no
catalogue, it was counted how often a name was right, by the variance that was left, and by its share of what
was there. A logistic curve through these counts gives the probability; docs/studies/unseen_machines.md shows
how well it holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, refit_without
from flexjoint.diagnosis.result import Estimation, Finding, Gain, Remaining, Removed
from flexjoint.diagnosis.search.criteria import changed_balances, torque_shares
from flexjoint.diagnosis.settings import VerdictSettings
from flexjoint.diagnosis.verdict.unseen.torques import background
from flexjoint.effects import Planned

LEAST_SHARE = 1e-7  # of a variance: what is less is rounding
CERTAINLY_NOT = -40.0  # log odds below which a probability is 0 to rounding


def left_by(best: Fit, k: int) -> tuple[float, float]:
    """The largest variance, in that of the noise, that is left in the balances that effect k of a set changes
    (before or after whitening), and its share of what is left without this effect; correlated samples count
    as the few independent ones that they are."""
    touched = changed_balances(best.problem, best.effects, k)
    if not np.any(touched):
        return 1.0, 1.0
    variances = best.problem.variances(best.y)
    row = int(np.argmax(np.where(touched, variances, 0.0)))
    without = best.problem.variances(refit_without(best, best.effects[k]).y)
    return float(variances[row]), float(min(1.0, variances[row] / without[row]))


def reliability(best: Fit, left: float, share: float, k: int = 0) -> float:
    """Probability that the name of effect k of a set is right, from the variance that is left and its share
    of what is left without it, on a machine that has no other small errors: nothing but the sensors'
    noise."""
    limits = best.settings.verdict
    joint = best.effects[k].joint
    crowd = max(0, sum(e.joint == joint for e in best.effects) - limits.crowd)
    raised = np.broadcast_to(best.problem.level.implausibility, len(best.problem.balances.rows)) > 1.0
    there = torque_shares(best.problem, best.effects, k) > 0.0
    implausible = limits.belief_implausible if np.any(raised & there) else 0.0
    odds = limits.belief + limits.belief_removed * _decades(1.0 / max(share, LEAST_SHARE))
    odds -= limits.belief_left * _decades(left) + implausible + limits.belief_crowd * crowd
    return float(1.0 / (1.0 + np.exp(-max(odds, CERTAINLY_NOT))))


def on_background(
    removed: Removed,
    joints: Sequence[Remaining],
    settings: VerdictSettings,
    beside: int = 1,
    friction: float | None = None,
) -> float:
    """Probability that a name is right on a machine that also has a background: many small errors that nobody
    names. It grows with the torque that the cause removes over what a background is at most: the usual one,
    or what is left of the joint's torque beyond the sensors' noise where that is less, down to the least
    one. It is lower where more is left than a usual background and the sensors' noise, or so much with a
    shape in the cause's own balance, where a smooth law of one signal would remove much of that, and where
    many causes are needed on one joint:
    `beside` counts the convincing ones there, this one included. Ordinary friction every machine has:
    whatever else is left, or acts beside it, says nothing against it, and a shape that is left is held
    against all friction of its joint, which removes `friction` [N m] together."""
    own = next((j for j in joints if j.joint == removed.joint), None)
    if own is None or own.torque <= 0.0:
        return 0.0
    size = float(np.sqrt(max(removed.without**2 - removed.left**2, 1e-300)))
    usual = settings.background_typical * own.torque
    most = max(background(own, settings), settings.background_least * own.torque)
    odds = settings.background_size * float(np.log10(size / (settings.background_even * most)))
    shaped = settings.background_shaped * max(size, friction or 0.0)
    odds -= settings.background_shape * _decades(removed.structured / shaped)
    if friction is None:
        # the joint's torque does not show what is left of its spring's, which acts on both sides
        odds -= settings.background_more * _decades(max(own.beyond_noise, removed.structured) / usual)
        odds -= settings.belief_crowd * max(0, beside - settings.crowd)
    return float(1.0 / (1.0 + np.exp(-max(odds, CERTAINLY_NOT))))


def where_held(believed: float, removed: Removed, settings: VerdictSettings) -> float:
    """The probability of a name, lower by what unseen data lack of the torque that the cause makes
    (`Removed.held`), beyond its standard error: a wrong law that fits where noise is low, as beside
    reversals, makes torque elsewhere that is not there."""
    lacking = 0.0 if removed.held is None else 1.0 - removed.held - (removed.held_std or 0.0)
    if lacking <= 0.0 or not 0.0 < believed < 1.0:
        return believed
    odds = float(np.log(believed / (1.0 - believed))) - settings.belief_held * lacking
    return float(1.0 / (1.0 + np.exp(-max(odds, CERTAINLY_NOT))))


def by_simulation(
    measured: Gain, without: Gain | None, planned: Planned, settings: VerdictSettings, beside: int = 1
) -> float:
    """Probability that a name is right, from the factor by which the set lowers the simulated error of its
    joint on held-out data: a wrong cause may make a balance smaller, but rarely the error of the simulation.
    What others gain is not credited to it: without this one (`without`) the simulation must be worse.
    0 where that is not so or not known, and for a cause of the whole robot."""
    if without is None or planned.joint is None:
        return 0.0
    keys = [f"{c}.{planned.joint}" for c in ("q", "theta", "phi")]
    after = measured.after["nrmse"]
    if settings.better_without * _lowered(without.after["nrmse"], after, keys) < 1.0:
        return 0.0
    factor = _lowered(measured.before["nrmse"], after, keys)
    odds = settings.simulated_belief * float(np.log10(max(factor, 1e-6) / settings.simulated_factor))
    odds -= settings.belief_crowd * max(0, beside - settings.crowd)
    return float(1.0 / (1.0 + np.exp(-max(odds, CERTAINLY_NOT))))


def _lowered(before: Mapping[str, float], after: Mapping[str, float], keys: Sequence[str]) -> float:
    """The largest factor by which errors are lower; 0 where none is known."""
    known = [key for key in keys if key in before and key in after]
    return max((before[key] / max(after[key], 1e-300) for key in known), default=0.0)


def _decades(ratio: float) -> float:
    """Factors of ten by which a ratio is above 1."""
    return float(np.log10(max(1.0, ratio)))


def followed(best: Fit, found: Sequence[Finding], estimation: Estimation | None) -> tuple[Finding, ...]:
    """The findings, with a higher reliability where a position was not measured and the simulation follows
    the readings up to their noise: what is left in the balances may then come from the missing position,
    which was computed from the nominal model. An effect similar to the true one (a torque limit instead of a
    speed limit) may follow the readings, too, so the reliability is raised to one half at most."""
    if estimation is None or not estimation.follows or not best.problem.motion.missing:
        return tuple(found)
    return tuple(_at_least(f, best.settings.verdict.followed_belief) for f in found)


def _at_least(finding: Finding, belief: float) -> Finding:
    believed = max(finding.reliability, belief)
    return replace(
        finding, reliability=believed, probability=finding.probability / finding.reliability * believed
    )
