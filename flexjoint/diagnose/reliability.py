"""How far to believe a name, from what is left beside it.

A cause that is the whole story of its balances leaves the sensors' noise in them; one that stands in for
another leaves a shape of its own. Counted on planted machines (`make study`), some of which hold an effect
that is in no catalogue: how often a name was right, by the variance that was left and by whether nominal
numbers had to be implausible beside it. A logistic curve through these counts; docs/diagnosis_study.md shows
what became of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.diagnose.fit import Fit
from flexjoint.diagnose.worth import torque_shares
from flexjoint.diagnosis import Finding

CLEAN = 3.2  # log-odds of a name that leaves the noise
PER_DECADE = 1.8  # less for every factor of ten in variance that is left
STRAIN = 1.5  # less where nominal numbers are implausible beside it
# less for each cause beyond two on its joint: what is in no catalogue is more likely than three. Not counted:
# no planted machine has more than two causes
CROWD = 3.0
LEAST = 0.2  # beyond which planted machines tell nothing of real ones, which always leave something
CLEARING = 1e-3  # share of a variance that filters and friction zones may leave of any cause
CLEARED = 0.3  # how often at least a name is right that leaves no more than that
# the same of a name with which the simulation follows the readings of one side to their noise: 4 of 8 that
# left 300 times the noise's variance in a balance, where half of the machines held an effect in no catalogue
FOLLOWED = 0.5


def left_by(best: Fit, nothing: Fit, k: int) -> tuple[float, float]:
    """Largest variance, in that of the noise, of what is left in the balances that effect k of a set touches,
    whitened alone or beside those before them, and its share of what was there with `nothing`; correlated
    leftovers count as the few independent samples that they are."""
    touched = torque_shares(best.workspace, best.effects, k) > 0.0
    if not np.any(touched):
        return 1.0, 1.0
    touched[_most_telling(best, k)] = True
    levels = best.workspace.levels(best.y)
    row = int(np.argmax(np.where(touched, levels, 0.0)))
    return float(levels[row]), float(levels[row] / nothing.workspace.temper[row])


def _most_telling(best: Fit, k: int) -> int:
    """The whitened balance in which effect k of a set leaves its largest mark: a friction of a motor may be
    lost in the noise of its spring, and known from the load of its link alone."""
    others = [e for i, e in enumerate(best.effects) if i != k]
    mark = best.workspace.moved(others, best.effects).reshape(len(best.workspace.temper), -1)
    return int(np.argmax(np.sum(mark**2, axis=1)))


def reliability(best: Fit, left: float, share: float, k: int = 0) -> float:
    """Probability that the name of effect k of a set is right which leaves so much, a share of what was
    there; LEAST where it need not be the story at all."""
    joint = best.effects[k].joint
    crowd = max(0, sum(e.joint == joint for e in best.effects) - 2)
    strained = STRAIN if best.workspace.strain > 1.0 else 0.0
    against = PER_DECADE * float(np.log10(max(1.0, left))) + strained + CROWD * crowd - CLEAN
    least = CLEARED if share < CLEARING else LEAST
    return max(least, float(1.0 / (1.0 + np.exp(against))))


def followed(finding: Finding) -> Finding:
    """A finding with whose numbers the simulation follows the readings to their noise: what it leaves in the
    balances may be their own error (a motion made of the nominal model). A near relative of the true effect
    may follow, too (a limit of the torque for one of the speed), so the name is even odds at most by this."""
    believed = max(finding.reliability, FOLLOWED)
    return replace(
        finding, reliability=believed, probability=finding.probability / finding.reliability * believed
    )
