"""The robust search of several recordings: what it finds in the first must hold in all others.

It looks at the first recording alone, whose balances and simulation decide. Each of its causes is then put
into the simulation of every other recording with the numbers of the first, which these have not seen: there,
too, it must lower the error of its own joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnosis.regression.fit import refit_without
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.robust_search import RobustFinding, simulated_errors
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.effects import Planned
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot


def confirmed(
    found: RobustFinding, usual: Selection, robots: Sequence[Robot], recordings: Sequence[Recording]
) -> RobustFinding | None:
    """What the robust search found in a first recording, without causes that the simulation of another one
    does not confirm: the joint's error there must not be larger with them, and over all of them smaller by as
    much as a cause beside another one must lower it. `robots` and `recordings` are the others. None: nothing
    is left of it, or they cannot be simulated."""
    known = {e.key for e in usual.best.effects}
    clocked = [on_regular_clock(recording) for recording in recordings]
    best, dropped = found.selection.best, []
    for joint in dict.fromkeys(e.joint for e in best.effects if e.key not in known):
        new = [e for e in best.effects if e.key not in known and e.joint == joint]
        lowered = _lowered(robots, clocked, best.effects, new)
        if lowered is None:
            return None
        if (
            min(lowered) >= 1.0
            and np.exp(np.mean(np.log(lowered))) >= best.settings.robust_search.lowered_beside
        ):
            continue
        for e in new:
            at = next(k for k, one in enumerate(best.effects) if one.key == e.key)
            best = at_own_level(refit_without(best, best.effects[at]))
            dropped.append(e)
    left = [e for e in best.effects if e.key not in known]
    if not left:
        return None
    count = len(recordings) + 1
    note = (
        f"named because the simulation of the joint needs it in all {count} recordings, with the numbers of"
    )
    notes = [f"{', '.join(map(str, left))} {note} the first"]
    if dropped:
        notes.append(f"not confirmed by the other recordings: {', '.join(map(str, dropped))}")
    return RobustFinding(
        found.problem,
        replace(found.selection, best=best, rivals=found.selection.rivals_beside(best)),
        tuple(notes),
    )


def _lowered(
    robots: Sequence[Robot],
    recordings: Sequence[Recording],
    effects: Sequence[Planned],
    new: Sequence[Planned],
) -> list[float] | None:
    """By recording, the factor by which new causes of one joint lower its simulated error."""
    out = []
    for robot, recording in zip(robots, recordings, strict=True):
        less = [e for e in effects if all(e is not one for one in new)]
        before, after = (simulated_errors(robot, recording, own) for own in (less, effects))
        if before is None or after is None:
            return None
        k = robot.joint_names.index(str(new[0].joint))
        out.append(float(before[k] / after[k]) if np.isfinite(before[k]) and after[k] > 0.0 else 1.0)
    return out
