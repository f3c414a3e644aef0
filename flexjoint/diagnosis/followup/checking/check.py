"""Is the machine as it was? What was known of it is refitted to a new recording: no search, so it takes a
small part of the time that the recording lasts.

recording -> are the data right? -> a part of it -> balances -> one fit of the known causes -> what moved, and
what is left
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.core.errors import RecordingError
from flexjoint.core.running.worker_pool import one_thread
from flexjoint.diagnosis.balances.balances import TwinBalances, balances_of
from flexjoint.diagnosis.balances.usable import refusal
from flexjoint.diagnosis.data.check import check_data
from flexjoint.diagnosis.followup.checking import left, numbers
from flexjoint.diagnosis.followup.checking.values import Check, CheckedCause, CheckedJoint
from flexjoint.diagnosis.regression.deviations import about_likely_links
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.recorded import Recorded
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.result.known import Against, Known, known_of
from flexjoint.diagnosis.search.candidates import Candidate, visible
from flexjoint.diagnosis.search.robust_search import blunted
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.effects import Planned
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording
from flexjoint.recording.table import expect as expect_recording
from flexjoint.robot.robot import Robot, expect


@one_thread
def check(
    robot: Robot,
    recording: Recording,
    against: Against | None = None,
    *,
    settings: Settings = USUAL,
) -> Check:
    """Whether a machine is as it was: are the same causes there, have their numbers moved beyond their
    errors, is what is left still as small and as free of a shape?

    Args:
        robot: the nominal model with its tolerances; without `against` the extended robot.
        recording: a new one of this machine. Of a long or fast one a part is looked at; the result says
            which.
        against: a diagnosis, or the path of its JSON: numbers with errors, and what was left. Or an
            extended robot, or the path of its YAML, which states neither: a number's error is then taken to
            be as large as this recording's, and what is left is judged by itself. None: the robot itself.
        settings: the numbers that decide (docs/reference/settings.md).

    Raises:
        RecordingError: the recording cannot be used with this robot, or its data cannot be right.
        FlexJointError: `against` is none of these, or is of another robot.
    """
    known = known_of(expect(robot, "check"), against)
    part, notes = _looked_at(known.robot, expect_recording(recording, "check"), settings)
    balances = balances_of(known.robot, part, settings)
    unusable = refusal(balances)
    if unusable:
        raise RecordingError(f"{recording.name} cannot be checked: {unusable}")
    problem = _problem(known, part, balances)
    shown = replace(known, causes=tuple(e for e in known.causes if shows(problem, e)))
    best = refitted(problem, shown)
    without = None if known.measured else left.without(best)
    now = left.left_by(best, without)
    causes = numbers.checked(known, best)
    hidden = numbers.unseen(causes)
    if hidden:
        names = ", ".join(str(c.effect) + (f" on {c.joint}" if c.joint else "") for c in hidden)
        notes = (*notes, f"this motion does not show: {names}")
    return Check(
        known.robot.name,
        recording.name,
        known.source,
        _joints(known, causes, now, left.grown(known, best, now)),
        (float(part.time[0]), float(part.time[-1])),
        1.0 / part.period,
        notes,
        known.robot.prismatic,
    )


def _looked_at(robot: Robot, recording: Recording, settings: Settings) -> tuple[Recording, tuple[str, ...]]:
    """The part of the recording that is looked at. Raises RecordingError where its data cannot be right."""
    recording = of_robot(robot, recording)
    wrong = check_data(robot, recording, settings=settings.data).findings
    if wrong:
        more = f", and {len(wrong) - 1} more errors of the data" if len(wrong) > 1 else ""
        raise RecordingError(
            f"{recording.name}: the data cannot be right: {wrong[0].text}{more}; see `flexjoint check-data`"
        )
    most = int(min(settings.check.samples, settings.check.samples_a_second * recording.duration))
    (part,), notes = excerpts(robot, [recording], largest=most, work="a check")
    return part, notes


def _problem(known: Known, recording: Recording, balances: TwinBalances) -> Problem:
    """What the known causes are fitted to: the balances in which they were found."""
    if not known.robust:
        return about_likely_links(Problem(balances))
    return blunted(known.robot, recording, Recorded(balances), known.causes)


def shows(problem: Problem, cause: Planned) -> bool:
    """Whether a cause acts on something that the recording balances or measures."""
    words = tuple((word.name, cause.values[word.name]) for word in cause.effect.words)
    return visible(problem, Candidate(cause.effect, cause.joint, words))


def refitted(problem: Problem, known: Known) -> Fit:
    """The known causes, their numbers fitted from their known values, at the noise level that this leaves."""
    limits = problem.settings.check
    about = problem.about(known.causes)
    level = problem.plausible_level(about.residual(known.causes))
    best = fit(problem.at(level), known.causes, iterations=limits.iterations)
    after = best.problem.plausible_level(best.y)
    lower = level.inflation / after.inflation
    # on machines with errors of their own a level may rise, by nominal numbers that look less plausible
    if np.max(lower) <= limits.same_level or np.mean(np.log(lower)) <= 0.0:
        return best
    return fit(problem.at(after), best.effects, iterations=limits.iterations)


def _joints(
    known: Known, causes: tuple[CheckedCause, ...], now: tuple[Remaining, ...], why: dict[str, str]
) -> tuple[CheckedJoint, ...]:
    by_joint = {one.joint: one for one in now}
    names: list[str | None] = [None] if any(c.joint is None for c in causes) else []
    out = []
    for name in [*names, *known.robot.joint_names]:
        own = tuple(c for c in causes if c.joint == name)
        left_now, was = (by_joint.get(name), known.remaining.get(name)) if name is not None else (None, None)
        out.append(CheckedJoint(name, own, left_now, was, why.get(name, "") if name is not None else ""))
    return tuple(out)
