"""From a selected set to named findings with their numbers: what is doubtful about a name takes it away, and
what is left is asked again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from flexjoint.diagnose import doubts, held_out, leftover, refined, verdict
from flexjoint.diagnose.fit import Fit
from flexjoint.diagnose.selection import Key, Selection
from flexjoint.diagnose.verdict import Errors
from flexjoint.diagnose.workspace import Workspace
from flexjoint.diagnosis import Estimation, Finding, Gain, ResidualView, Unexplained
from flexjoint.recording import Recording
from flexjoint.robot import Robot

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Named:
    """The findings of a selection, and what was measured with them."""

    selection: Selection
    found: tuple[Finding, ...]
    estimation: Estimation | None
    measured: Gain | None
    residuals: tuple[ResidualView, ...]
    left: tuple[Unexplained, ...]
    explained: float
    notes: tuple[str, ...]


def named(
    robot: Robot,
    recordings: Sequence[Recording],
    workspace: Workspace,
    selection: Selection,
    measured: Gain | None,
    spread: Mapping[Key, Errors],
    *,
    refine: bool,
    workers: int,
    report: Progress,
) -> Named:
    """What a selection can be said to be, and by which numbers.

    Args:
        measured: the gain of the selection on held-out data.
        spread: standard errors that replace those of the first recording.
        refine: whether the numbers are refined on the simulation.
        workers: processes that share that.
    """
    notes: tuple[str, ...] = ()
    while True:
        best = selection.best
        residuals = leftover.views(best, selection.nothing)
        left = leftover.unexplained(best, residuals)
        explained = leftover.explained(best, residuals)
        found = verdict.findings(selection, held_out.gains(workspace, best), explained, spread)
        doubtful, why = doubts.improbable(found), "something like {} would help, but others fit as well"
        if not doubtful:
            found, estimation, told = _estimated(robot, recordings, best, found, refine, workers, report)
            doubtful = doubts.vanishing(best, found, estimation)
            why = "the simulation does not tell {} from none"
        finer = () if doubtful else doubts.finer(best, found, estimation)
        if not doubtful and not finer:
            return Named(selection, found, estimation, measured, residuals, left, explained, notes + told)
        for finding in doubtful:
            selection = verdict.without(selection, finding.planned)
            notes += (f"{why.format(finding.planned)}: not named",)
        for finding in finer[:1]:  # in its place comes another, with which the others have other numbers
            selection = verdict.plainer(selection, finding.planned)
            notes += (f"{finding.planned} is a finer law than its numbers are known: a plainer one is named",)
        measured = held_out.comparison(robot, recordings[0], workspace, selection.best, measured)


def _estimated(
    robot: Robot,
    recordings: Sequence[Recording],
    best: Fit,
    found: tuple[Finding, ...],
    refine: bool,
    workers: int,
    report: Progress,
) -> tuple[tuple[Finding, ...], Estimation | None, tuple[str, ...]]:
    """The findings with their numbers refined on the simulation where that is asked for and can be done, how
    they were estimated, and notes."""
    if not found:
        return found, None, ()
    if not refine or len(recordings) > 1:
        why = "several recordings share their numbers" if refine else "no refinement was asked for"
        return found, refined.from_balances(best, why), ()
    report(0.95, "refining the numbers on the simulation")
    found, estimation = refined.refine(robot, recordings[0], best, found, workers)
    why = estimation.why
    return found, estimation, (f"numbers are those of the torque balances: {why}",) if why else ()
