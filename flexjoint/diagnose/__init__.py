"""Diagnosis: what a simulation gets wrong, and why.

recording -> readings -> motion -> balances -> whitening -> selection -> verdict
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flexjoint.diagnose import held_out, leftover, verdict
from flexjoint.diagnose.balances import Balances
from flexjoint.diagnose.candidates import enumerate_candidates
from flexjoint.diagnose.experiment import advice
from flexjoint.diagnose.selection import select
from flexjoint.diagnose.workspace import Workspace, balances_of
from flexjoint.diagnosis import Diagnosis
from flexjoint.effect import catalogue
from flexjoint.errors import RecordingError, unknown
from flexjoint.recording import Recording
from flexjoint.robot import Robot

EXPLAINED = 0.9  # of the error above noise, below which the causes found are not the whole story
SHORTEST = 1.0  # s of usable data
STILL = 20.0  # encoder noises that a joint must move, for anything to be said

Progress = Callable[[float, str], None]


def diagnose(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    progress: Progress | None = None,
    excluded: frozenset[str] = frozenset(),
) -> Diagnosis:
    """Name what the nominal model gets wrong on the first recording; measure the gain on held-out blocks.

    Args:
        robot: the nominal model with its tolerances.
        recordings: at least one; the first is diagnosed.
        progress: called with a share in [0, 1] and what is being done.
        excluded: names of effects that are left out of the catalogue.

    Raises:
        RecordingError: the recording cannot be used with this robot.
        UnknownNameError: an excluded name is no effect.
    """
    if not recordings:
        raise RecordingError("no recording given; expected at least one")
    for name in excluded:
        if name not in catalogue():
            raise unknown("effect", name, catalogue())
    report: Progress = progress or (lambda _share, _what: None)
    recording = recordings[0]
    report(0.0, "preparing the balances")
    balances = balances_of(robot, recording)
    refusal = _refusal(balances)
    if refusal:
        return Diagnosis("refused", refusal)
    workspace = Workspace(balances)
    candidates = enumerate_candidates(workspace, excluded)
    selection = select(workspace, candidates, report)
    report(0.92, "measuring the gain on held-out data")
    selection, measured, notes = held_out.confirmed(robot, recording, workspace, selection)
    best = selection.best
    residuals = leftover.views(best, selection.nothing)
    left = leftover.unexplained(best, residuals)
    explained = leftover.explained(best, residuals)
    found = verdict.findings(selection, held_out.gains(workspace, best, selection.nothing), explained)
    found = verdict.merged(found, candidates)
    kind, reason = _verdict(found, left, explained)
    blind = verdict.not_excited(selection, candidates)
    report(1.0, "done")
    return Diagnosis(
        verdict=kind,  # type: ignore[arg-type]
        reason=reason,
        findings=found,
        unexplained=left,
        not_excited=blind,
        within_tolerance=verdict.within_tolerance(best),
        comparison=measured,
        next_experiment=advice(robot, recording, found, left, blind),
        ranking=verdict.ranking(selection),
        residuals=residuals,
        explained=explained,
        notes=notes,
        energy=(
            float(np.mean(selection.nothing.workspace.temper)),
            float(np.mean(best.workspace.temper)),
        ),
    )


def extended_model(robot: Robot, diagnosis: Diagnosis) -> Robot:
    """The robot with the diagnosed causes in its model."""
    effects = [e for f in diagnosis.findings for e in (f.members or (f.planned,))]
    return robot.extended(effects)


def _refusal(balances: Balances) -> str:
    """Why the data cannot carry a verdict; empty when they can."""
    motion = balances.motion
    used = motion.readings.valid
    seconds = float(np.sum(used)) * motion.readings.period
    if seconds < SHORTEST:
        return f"only {seconds:.2g} s of usable data beside gaps and edges; record at least {SHORTEST:g} s"
    if not balances.rows:
        return (
            "no torque balance can be closed: neither motor torques nor both encoders of a joint are recorded"
        )
    travel = np.ptp(motion.theta[:, used], axis=1)
    noise = np.maximum(motion.readings.noise["theta"], motion.readings.noise["q"])
    if np.all(travel < STILL * np.maximum(noise, 1e-9)):
        return "the robot hardly moves in this recording; record a motion that uses its speed and load"
    return ""


def _verdict(found: Sequence[object], left: Sequence[object], explained: float) -> tuple[str, str]:
    if found and explained >= EXPLAINED:
        return "causes", f"the causes named explain {100.0 * explained:.0f} % of the error above sensor noise"
    if found:
        return (
            "unexplained",
            f"the causes named explain only {100.0 * explained:.0f} % of the error above noise",
        )
    if left:
        return (
            "unexplained",
            "the error is beyond noise and tolerances, but no effect in the catalogue explains it",
        )
    return "healthy", "nothing beats the sensors' noise and the model's own tolerances"
