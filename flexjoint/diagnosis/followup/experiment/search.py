"""The search for a motion: random draws within the limits, then changes of the best (seeded, a fixed number
of them, so that the same question gets the same answer)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import SimulationError
from flexjoint.diagnosis.followup.experiment import evidence
from flexjoint.diagnosis.followup.experiment.evidence import Evidence, Key, Odds
from flexjoint.diagnosis.followup.experiment.limits import Limits, exceeded
from flexjoint.diagnosis.followup.experiment.question import Question
from flexjoint.diagnosis.followup.experiment.trajectory import Wave, drawn, reference, timid, varied
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import Simulation

ROUNDS = 12  # of slowing down until a simulation keeps to the limits
SLOWER = 0.85

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Motion:
    """A motion that keeps to the limits with the causes found, and its value."""

    waves: tuple[Wave, ...]
    score: float
    odds: tuple[Odds, ...]  # per tie of the question
    shown: dict[Key, float]  # energy of every effect, where the catalogue is asked for


def best_motion(
    robot: Robot, question: Question, limits: Limits, seed: int, report: Progress
) -> tuple[Motion, tuple[Odds, ...]]:
    """The best motion found, and per tie the least odds among all that were tried, a timid motion among
    them: the rival as fitted there is the one that could pass for the cause.

    Raises SimulationError: no motion keeps to the limits.
    """
    random = np.random.default_rng(seed)
    tried: list[Motion] = []
    draws = USUAL.plan.drawn
    count = draws + USUAL.plan.changed
    for k in range(count):
        report(k / count, "trying motions")
        waves = drawn(len(robot.joints), random)
        if k >= draws and tried:
            waves = varied(max(tried, key=lambda motion: motion.score).waves, random)
        motion = _judged(robot, question, limits, waves, seed + k)
        if motion is not None:
            tried.append(motion)
    if not tried:
        raise SimulationError(
            "no motion keeps to the limits of position, speed and torque in simulation; raise --reach or"
            " --speed, or check the controller's gains"
        )
    best = max(tried, key=lambda motion: motion.score)
    if question.ties:
        poor = _judged(robot, question, limits, timid(best.waves), seed)
        tried += [poor] if poor is not None else []
    worst = tuple(
        min((motion.odds[k] for motion in tried), key=lambda odds: odds.log)
        for k in range(len(question.ties))
    )
    return best, worst


def within_limits(
    robot: Robot, hypotheses: Sequence[Sequence[Planned]], limits: Limits, waves: Sequence[Wave]
) -> tuple[Recording, tuple[Simulation, ...]] | None:
    """The reference of some waves, slowed down until the robot simulated under each hypothesis keeps to the
    limits, and those simulations; None where it does not come to that."""
    asked = limits
    for _ in range(ROUNDS):
        table = reference(robot, waves, asked)
        try:
            runs = tuple(evidence.simulated(robot, effects, table) for effects in hypotheses)
        except SimulationError:
            asked = asked.slower(np.ones(len(robot.joints), dtype=bool), SLOWER)
            continue
        over = {name for run in runs for name in exceeded(robot, limits, run.true)}
        if not over:
            return table, runs
        asked = asked.slower(np.array([name in over for name in robot.joint_names]), SLOWER)
    return None


def _judged(
    robot: Robot, question: Question, limits: Limits, waves: Sequence[Wave], seed: int
) -> Motion | None:
    """A motion and its value: the least odds of the question, or how much of the catalogue it shows."""
    kept = within_limits(robot, [question.found], limits, waves)
    if kept is None:
        return None
    _, (run,) = kept
    # what was found is part of the model when the question is what else there could be
    known = robot if question.ties else robot.extended(question.found)
    asked = Evidence(known, evidence.recorded(run, question.sensors, seed))
    if question.ties:
        odds = tuple(asked.odds(tie.beside, tie.truth, tie.rival) for tie in question.ties)
        # the least counts, and the others a little: a tie that nothing breaks must not hide progress
        logs = np.sort([o.log for o in odds])
        return Motion(tuple(waves), float(logs[0] + 0.1 * np.mean(np.minimum(logs, 100.0))), odds, {})
    shown = asked.shown()
    seen = np.array(list(shown.values())) / USUAL.verdict.detectable
    value = np.log1p(np.clip(seen, 0.0, USUAL.plan.saturated))
    return Motion(tuple(waves), float(np.sum(value)), (), shown)
