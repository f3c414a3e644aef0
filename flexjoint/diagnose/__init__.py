"""Diagnosis: what a simulation gets wrong, and why.

recording -> readings -> motion -> balances -> whitening -> selection -> verdict
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flexjoint.diagnose import held_out, leftover, verdict
from flexjoint.diagnose.balances import Balances, balances_of
from flexjoint.diagnose.candidates import STILL, enumerate_candidates
from flexjoint.diagnose.crew import workers_of
from flexjoint.diagnose.excerpt import excerpts
from flexjoint.diagnose.experiment import advice
from flexjoint.diagnose.naming import named
from flexjoint.diagnose.reliability import LEAST
from flexjoint.diagnose.second_look import look_again
from flexjoint.diagnose.selection import Key, Selection, select
from flexjoint.diagnose.together import combine
from flexjoint.diagnose.verdict import Errors
from flexjoint.diagnose.workspace import Workspace
from flexjoint.diagnosis import Diagnosis, Finding, Unexplained
from flexjoint.effect import catalogue
from flexjoint.errors import RecordingError, unknown
from flexjoint.known_payload import KnownPayload
from flexjoint.recording import Recording
from flexjoint.robot import Robot

EXPLAINED = 0.9  # of the error above noise, below which the causes found are not the whole story
SHORTEST = 1.0  # s of usable data

Progress = Callable[[float, str], None]


def diagnose(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    progress: Progress | None = None,
    excluded: frozenset[str] = frozenset(),
    payloads: Sequence[KnownPayload | None] = (),
    refine: bool = True,
    workers: int | None = None,
) -> Diagnosis:
    """Name what the nominal model gets wrong on the recordings; measure the gain on held-out blocks of the
    first, whose residuals and onsets are the ones reported.

    Args:
        robot: the nominal model with its tolerances.
        recordings: at least one; several are explained together, by one set of causes and numbers.
        progress: called with a share in [0, 1] and what is being done.
        excluded: names of effects that are left out of the catalogue.
        payloads: what was added to the robot in each recording and is known (None: nothing); empty: nothing
            in any. It is part of that recording's nominal model; the causes are common to all.
        refine: whether the numbers of the causes are refined on the simulation itself (one recording).
        workers: processes that share the search, FLEXJOINT_WORKERS or one per core by default; the bits are
            the same for any number.

    Raises:
        ModelError: fewer than one worker.
        RecordingError: the recording cannot be used with this robot, or not one payload for each.
        UnknownNameError: an excluded name is no effect, or a payload's joint is none of the robot's.
    """
    if not recordings:
        raise RecordingError("no recording given; expected at least one")
    _check_names(excluded)
    workers = workers_of(workers)
    report: Progress = progress or (lambda _share, _what: None)
    robots = _loaded(robot, recordings, payloads)
    recordings, cut = excerpts(robot, recordings)
    recording, robot = recordings[0], robots[0]
    report(0.0, "preparing the balances")
    balances = balances_of(robot, recording)
    refusal = _refusal(balances)
    if refusal:
        return Diagnosis("refused", refusal)
    workspace, spread = Workspace(balances), dict[Key, Errors]()
    candidates = enumerate_candidates(workspace, excluded)
    share = 0.92 / len(recordings)
    selection = select(workspace, candidates, _part(report, 0.0, share), workers=workers)
    selection, notes = verdict.sure(selection)
    if len(recordings) > 1:
        others = [
            _searched(robots[k], other, excluded, _part(report, k * share, share), workers)
            for k, other in enumerate(recordings[1:], start=1)
        ]
        together = combine([selection, *others])
        selection, spread, notes = together.selection, together.errors, notes + together.notes
    report(0.92, "measuring the gain on held-out data")
    selection, measured, worse = held_out.confirmed(robot, recording, workspace, selection)
    notes += (*cut, *_known(recordings, payloads), *worse)
    if len(recordings) == 1 and measured is not None and _doubtful(selection):
        again = look_again(robot, recording, workspace, selection, candidates, _part(report, 0.92, 0.02))
        if again is not None:
            workspace, selection, notes = again.workspace, again.selection, (*notes, *again.notes)
            measured = held_out.comparison(robot, recording, workspace, selection.best, measured)
    result = named(
        robot,
        recordings,
        workspace,
        selection,
        measured,
        spread,
        refine=refine,
        workers=workers,
        report=report,
    )
    selection, best, left, explained = result.selection, result.selection.best, result.left, result.explained
    notes += (*result.notes, *verdict.not_believed(best))
    found = verdict.merged(result.found, candidates)
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
        comparison=result.measured,
        next_experiment=advice(robot, recording, found, left, blind),
        ranking=verdict.ranking(selection),
        residuals=result.residuals,
        explained=explained,
        notes=notes,
        energy=(
            float(np.mean(selection.nothing.workspace.temper)),
            float(np.mean(best.workspace.temper)),
        ),
        estimation=result.estimation,
    )


def _check_names(excluded: frozenset[str]) -> None:
    for name in excluded:
        if name not in catalogue():
            raise unknown("effect", name, catalogue())


def _loaded(
    robot: Robot, recordings: Sequence[Recording], payloads: Sequence[KnownPayload | None]
) -> list[Robot]:
    """The nominal robot of each recording."""
    if payloads and len(payloads) != len(recordings):
        raise RecordingError(
            f"expected a known payload, or None, for each of {len(recordings)} recordings,"
            f" got {len(payloads)}"
        )
    return [robot if load is None else load.on(robot) for load in payloads or [None] * len(recordings)]


def _known(recordings: Sequence[Recording], payloads: Sequence[KnownPayload | None]) -> tuple[str, ...]:
    return tuple(
        f"{recording.name} was recorded with a known payload of {payload}"
        for recording, payload in zip(recordings, payloads, strict=False)
        if payload is not None
    )


def _searched(
    robot: Robot, recording: Recording, excluded: frozenset[str], report: Progress, workers: int
) -> Selection:
    """What another recording of the same robot says by itself."""
    balances = balances_of(robot, recording)
    refusal = _refusal(balances)
    if refusal:
        raise RecordingError(f"{recording.name} cannot be diagnosed together with the others: {refusal}")
    workspace = Workspace(balances)
    selection = select(workspace, enumerate_candidates(workspace, excluded), report, workers=workers)
    return verdict.sure(selection)[0]


def _doubtful(selection: Selection) -> bool:
    """Whether an error is left and only implausible nominal numbers would explain it."""
    best = selection.best
    if best.workspace.strain <= leftover.STRAINED:
        return False
    residuals = leftover.views(best, selection.nothing)
    left = leftover.unexplained(best, residuals)
    return bool(left) and (not best.effects or leftover.explained(best, residuals) < EXPLAINED)


def _part(report: Progress, begin: float, share: float) -> Progress:
    """Progress of a part of the work."""
    return lambda done, what: report(begin + share * done, what)


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


def _verdict(found: Sequence[Finding], left: Sequence[Unexplained], explained: float) -> tuple[str, str]:
    unlikely = [f for f in found if f.reliability <= LEAST]
    if explained >= EXPLAINED and unlikely:
        most = max(f.left for f in unlikely)
        return (
            "unexplained",
            f"the causes named explain {100.0 * explained:.0f} % of the error above noise, but leave"
            f" {most:.2g} times the noise's variance in their balances: something else may stand behind them",
        )
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
