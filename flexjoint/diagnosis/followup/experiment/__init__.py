"""The next experiment: a motion that distinguishes causes which the last recording could not.

question (a diagnosis's ties, or the whole catalogue) -> search over motions within the limits, each simulated
and asked for its evidence -> a reference, the odds to expect, and what to add where no motion decides.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import SimulationError
from flexjoint.core.running.worker_pool import one_thread
from flexjoint.diagnosis.followup.experiment import evidence
from flexjoint.diagnosis.followup.experiment.evidence import Evidence, Key
from flexjoint.diagnosis.followup.experiment.limits import Limits, limits_of
from flexjoint.diagnosis.followup.experiment.proposals import Proposal, proposals
from flexjoint.diagnosis.followup.experiment.question import (
    Question,
    Tie,
    question_of,
    read,
    without_diagnosis,
)
from flexjoint.diagnosis.followup.experiment.search import best_motion, within_limits
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, expect
from flexjoint.simulation.simulate import Simulation

# log odds, from which a diagnosis no longer calls two causes tied: chi-square is twice their logarithm
DECISIVE = 0.5 * USUAL.verdict.tie

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Outlook:
    """What the planned recording is expected to say about one tie: log odds for the cause as found if it is
    the true one, and for its rival if that is; and what to add where neither is decisive."""

    tie: Tie
    if_found: float
    if_rival: float
    proposals: tuple[Proposal, ...] = ()

    @property
    def decided(self) -> bool:
        return min(self.if_found, self.if_rival) >= DECISIVE


@dataclass(frozen=True)
class Plan:
    """The next experiment. `reference` holds q_ref at f_c; `peaks` per joint the largest travel from the
    centre [rad], speed [rad/s] and motor torque [N m] over the simulations; `shown` and `hidden` are the
    effects of the catalogue that it excites or not (where no tie was to be broken)."""

    reference: Recording
    limits: Limits
    outlooks: tuple[Outlook, ...]
    peaks: dict[str, tuple[float, float, float]]
    shown: tuple[Key, ...]
    hidden: tuple[Key, ...]


@one_thread
def plan(
    robot: Robot,
    question: Question | Diagnosis | str | os.PathLike[str] | None = None,
    limits: Limits | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Design the recording that best answers the question; the same seed gives the same plan.

    Args:
        question: a diagnosis, or the JSON that it was written to: its ties are to be broken. None: nothing is
            known, and the whole catalogue is to be excited.
        limits: of the motion; default: `limits_of` the robot.
        progress: called with a share in [0, 1] and what is being done.

    Raises:
        SimulationError: no motion keeps to the limits in simulation.
        RecordingError: the question's sensors allow no diagnosis of this robot.
    """
    report: Progress = progress or (lambda _share, _what: None)
    robot, question = expect(robot, "plan"), question_of(question, robot)
    limits = limits or limits_of(robot)
    motion, closest = best_motion(robot, question, limits, seed, lambda x, what: report(0.7 * x, what))
    rivals = [
        (*tie.beside, *odds.rival) for tie, odds in zip(question.ties, closest, strict=True) if odds.rival
    ]
    kept = within_limits(robot, [question.found, *rivals], limits, motion.waves)
    if kept is None:
        raise SimulationError("the planned motion leaves the limits under a rival cause; lower --reach")
    reference, runs = kept
    outlooks, other = [], iter(runs[1:])
    for k, (tie, odds) in enumerate(zip(question.ties, closest, strict=True)):
        report(0.7 + 0.3 * k / len(question.ties), "weighing the hypotheses")
        forward = backward = _least(robot, question, runs[0], tie.beside, tie.truth, tie.rival, seed)
        if odds.rival:
            keys = tuple(e.key for e in tie.truth)
            backward = _least(robot, question, next(other), tie.beside, odds.rival, keys, seed)
        outlook = Outlook(tie, forward, backward)
        if not outlook.decided:
            more = proposals(robot, tie, question, reference, limits, seed)
            outlook = Outlook(tie, forward, backward, more)
        outlooks.append(outlook)
    report(1.0, "done")
    shown = tuple(key for key, energy in motion.shown.items() if energy >= USUAL.verdict.detectable)
    hidden = tuple(key for key, energy in motion.shown.items() if energy < USUAL.verdict.detectable)
    return Plan(reference, limits, tuple(outlooks), _peaks(robot, limits, runs), shown, hidden)


def _least(
    robot: Robot,
    question: Question,
    run: Simulation,
    beside: Sequence[Planned],
    truth: Sequence[Planned],
    rival: Sequence[Key],
    seed: int,
) -> float:
    """Log odds of a simulated run, the least over some draws of the sensors' noise."""
    draws = (evidence.recorded(run, question.sensors, seed + k) for k in range(USUAL.plan.noise_draws))
    return min(Evidence(robot, draw).odds(beside, truth, rival).log for draw in draws)


def _peaks(
    robot: Robot, limits: Limits, runs: tuple[Simulation, ...]
) -> dict[str, tuple[float, float, float]]:
    out = {}
    for i, name in enumerate(robot.joint_names):
        tables = [run.true for run in runs]
        travel = max(float(np.max(np.abs(t.get("q", name) - limits.centre[i]))) for t in tables)
        speed, torque = (
            max(float(np.max(np.abs(t.get(channel, name)))) for t in tables) for channel in ("dq", "tau_m")
        )
        out[name] = (travel, speed, torque)
    return out


__all__ = [
    "DECISIVE",
    "Limits",
    "Outlook",
    "Plan",
    "Question",
    "limits_of",
    "plan",
    "read",
    "without_diagnosis",
]
