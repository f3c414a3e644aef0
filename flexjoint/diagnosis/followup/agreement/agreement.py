"""Several recordings beside each other: the causes of a finished diagnosis, fitted to each by itself.

Of every number a table (spread.py); of every cause which recordings show it; and each recording is simulated
with the numbers that all others give (leaving one out), which says how far the extended model carries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.running.budget import UNLIMITED, Budget, OutOfTimeError, checkpoint, within
from flexjoint.core.running.worker_pool import one_thread
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.comparison.compare import HORIZON, Comparison, compared
from flexjoint.diagnosis.followup.agreement.spread import Series, repeated
from flexjoint.diagnosis.regression.deviations import about_likely_links
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.shared_numbers import SharedNumbers
from flexjoint.diagnosis.regression.uncertainty import Errors, certainty, standard_errors
from flexjoint.diagnosis.result import Agreement, Diagnosis, Gain, LeftOut, Shown
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.diagnosis.verdict.unseen.noise_floor import noise_floor
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording, expect_several
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot, expect

LATE = "the time allowed was over before the recordings were compared with each other"
UNSEEN = 1e100  # what a pseudo-inverse makes of a number without a trace is larger


@dataclass(frozen=True)
class _Own:
    """A recording's own fit of the causes."""

    robot: Robot  # nominal, with what is known to hang on it
    recording: Recording
    fit: Fit
    errors: list[Errors]  # infinite where it does not show a number


@one_thread
def agreement(
    robot: Robot,
    recordings: Sequence[Recording],
    diagnosis: Diagnosis,
    *,
    payloads: Sequence[KnownPayload | None] = (),
    settings: Settings = USUAL,
    budget: Budget = UNLIMITED,
) -> Diagnosis:
    """The diagnosis of several recordings with its `agreement`: every number by recording, its spread beyond
    the standard errors, which recording is odd, which show a cause at all, and each recording simulated with
    the numbers of all others.

    Args:
        robot: the nominal model.
        recordings: those that were diagnosed together, in that order.
        diagnosis: what `diagnose` said of them. One of a single recording, or a refused one, is handed back.
        payloads: as in `diagnose`.
        settings: the numbers that decide (docs/reference/settings.md).
        budget: the time that it may take; where that is too short, the diagnosis is handed back with a note.

    Raises RecordingError where a recording cannot be used with this robot.
    """
    robot, recordings = expect(robot, "agreement"), expect_several(recordings, "agreement")
    if len(recordings) < 2 or diagnosis.verdict == "refused":
        return diagnosis
    if payloads and len(payloads) != len(recordings):
        raise RecordingError(f"expected {len(recordings)} payloads, got {len(payloads)}")
    loads = payloads or [None] * len(recordings)
    robots = [robot if load is None else load.on(robot) for load in loads]
    names = _names(recordings)
    torques = [of_robot(robot, recording) for recording in recordings]
    parts, _ = excerpts(robots[0], torques, budget.seconds)
    try:
        with within(budget):
            found = _agreement(robots, parts, names, _lasting(diagnosis), settings)
    except OutOfTimeError:
        return replace(diagnosis, notes=(*diagnosis.notes, LATE))
    return replace(diagnosis, agreement=found)


def _agreement(
    robots: Sequence[Robot],
    parts: Sequence[Recording],
    names: tuple[str, ...],
    causes: Sequence[Planned],
    settings: Settings,
) -> Agreement:
    checkpoint()
    own = [_own(r, part, causes, settings) for r, part in zip(robots, parts, strict=True)]
    series = _series(own)
    numbers = repeated(series, settings.agreement.chance)
    left_out = tuple(_left_out(own, k) for k in range(len(own)))
    return Agreement(names, numbers, _shown(own), left_out)


def _names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    return tuple(recording.name for recording in recordings)


def _lasting(diagnosis: Diagnosis) -> tuple[Planned, ...]:
    """The causes of all recordings; one that set in during the first belongs to that alone."""
    return tuple(
        replace(effect, since=None)
        for finding in diagnosis.findings
        if finding.since is None
        for effect in (finding.members or (finding.planned,))
    )


def _own(robot: Robot, recording: Recording, causes: Sequence[Planned], settings: Settings) -> _Own:
    problem = about_likely_links(Problem(balances_of(robot, recording, settings)))
    rounds = settings.agreement.iterations
    first = problem.plausible_level(problem.about(causes).residual(causes))
    best = fit(problem.at(first), causes, iterations=rounds)
    best = fit(problem.at(best.problem.plausible_level(best.y)), best.effects, iterations=rounds)
    with np.errstate(over="ignore", invalid="ignore"):
        errors = standard_errors(best)
    known = [
        {name: [x if 0.0 < x < UNSEEN else np.inf for x in std] for name, std in one.items()}
        for one in errors
    ]
    return _Own(robot, recording, best, known)


# ------------------------------------------------------------------ numbers
def _series(own: Sequence[_Own]) -> list[Series]:
    """Every number over the recordings; where the nominal model lists the same effect, the change."""
    out = []
    for slot in own[0].fit.slots:
        effect = own[0].fit.effects[slot.effect]
        sliding = effect.joint in own[0].robot.prismatic
        listed = next((e for e in own[0].robot.effects if e.key == effect.key), None)
        single = slot.param.size == 1
        less = float(listed.values[slot.param.name]) if listed is not None and single else 0.0
        name = slot.param.name if single else f"{slot.param.name}[{slot.component}]"
        out.append(
            Series(
                effect.effect.name,
                effect.joint,
                name,
                slot.param.unit_at(sliding),
                np.array([slot.get(o.fit.effects) - less for o in own]),
                np.array([o.errors[slot.effect][slot.param.name][slot.component] for o in own]),
                slot.param.wraps,
            )
        )
    return out


def _shown(own: Sequence[_Own]) -> tuple[Shown, ...]:
    """Which recordings show a cause: its size differs from none by enough of its standard errors. One in
    which it does not, though its errors are small enough to have shown the size that the clearest other one
    gives, has it not."""
    out = []
    for k, effect in enumerate(own[0].fit.effects):
        sure = own[0].fit.settings.verdict.sure
        sizes = [certainty(o.fit, o.fit.effects[k], o.errors[k]) for o in own]
        clearest = own[int(np.argmax(sizes))].fit.effects[k]
        there = tuple(i for i, size in enumerate(sizes) if size >= sure)
        absent = tuple(
            i
            for i, o in enumerate(own)
            if i not in there and certainty(o.fit, clearest, o.errors[k]) >= 2.0 * sure
        )
        out.append(Shown(effect.effect.name, effect.joint, there, absent if there else ()))
    return tuple(out)


# ------------------------------------------------------------------ leaving one out
def _left_out(own: Sequence[_Own], k: int) -> LeftOut:
    """A recording simulated with the nominal model, and with the numbers that all others have in common."""
    others, here = [o for i, o in enumerate(own) if i != k], own[k]
    effects = _from_others(others)
    try:
        before = _errors(compared(FlexibleJointModel(here.robot), _clocked(here)))
        after, extended = before, here.robot.extended(effects)
        if effects:
            after = _errors(compared(FlexibleJointModel(extended), _clocked(here)))
        floor = noise_floor(extended, _clocked(here))
    except OutOfTimeError:
        raise
    except FlexJointError:  # it lacks what a simulation needs, or diverges
        return LeftOut(k, None)
    return LeftOut(k, Gain(True, HORIZON, before, after, floor))


def _from_others(others: Sequence[_Own]) -> list[Planned]:
    fits = [o.fit for o in others]
    slots = fits[0].slots
    if not slots:
        return []
    own = [np.array([slot.get(f.effects) for slot in slots]) for f in fits]
    for j, slot in enumerate(slots):
        if slot.param.wraps:
            for numbers in own[1:]:
                numbers[j] += 2.0 * np.pi * np.round((own[0][j] - numbers[j]) / (2.0 * np.pi))
    common = own[0]
    if len(fits) > 1:
        common, _ = SharedNumbers([f.problem for f in fits]).solve(fits, own)
    effects = list(fits[0].effects)
    for slot, number in zip(slots, common, strict=True):
        slot.put(effects, float(np.clip(number, slot.param.low, slot.param.high)))
    return effects


def _clocked(own: _Own) -> Recording:
    return own.fit.problem.readings.recording


def _errors(run: Comparison) -> dict[str, dict[str, float]]:
    return {"rms": dict(run.rms), "nrmse": dict(run.nrmse)}
