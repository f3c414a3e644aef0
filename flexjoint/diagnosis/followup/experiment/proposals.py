"""What else could break a tie that no motion breaks: a known payload on a second recording, or a sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.followup.experiment import evidence
from flexjoint.diagnosis.followup.experiment.evidence import Evidence, Sensors
from flexjoint.diagnosis.followup.experiment.limits import Limits, exceeded
from flexjoint.diagnosis.followup.experiment.question import Question, Tie, usual_noise
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, effect
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

SENSORS = ("q", "theta", "tau_t")


@dataclass(frozen=True)
class Proposal:
    """Something to add, in words, and the log odds that it brings on the planned motion."""

    what: str
    log_odds: float


def proposals(
    robot: Robot, tie: Tie, question: Question, reference: Recording, limits: Limits, seed: int
) -> tuple[Proposal, ...]:
    """Each with its odds for a tie, the best first."""
    found = [*_sensors(robot, tie, question, reference, seed)]
    loaded = _payload(robot, tie, question, reference, limits, seed)
    found += [loaded] if loaded is not None else []
    return tuple(sorted(found, key=lambda p: -p.log_odds))


def _sensors(robot: Robot, tie: Tie, question: Question, reference: Recording, seed: int) -> list[Proposal]:
    """Each position or torque sensor that the joints of the tie lack."""
    joints = {key[1] for key in (*tie.rival, *(e.key for e in tie.truth))} - {None}
    lacking = [
        (channel, joint.name)
        for joint in robot.joints
        for channel in SENSORS
        if (joint.name in joints or not joints)
        and not question.sensors.has(channel, joint.name)
        and not (joint.rigid and channel != "q")
    ]
    run = evidence.simulated(robot, [*tie.beside, *tie.truth], reference) if lacking else None
    out = []
    for channel, joint in lacking:
        assert run is not None
        noise = {**question.sensors.noise, (channel, joint): usual_noise(robot, channel, joint)}
        asked = Evidence(robot, evidence.recorded(run, Sensors(noise), seed))
        log = asked.odds(tie.beside, tie.truth, tie.rival).log
        out.append(Proposal(f"measure {channel}.{joint} too", log))
    return out


def _payload(
    robot: Robot, tie: Tie, question: Question, reference: Recording, limits: Limits, seed: int
) -> Proposal | None:
    """The motion once more with a known payload on the last link, beside the one without: the rival has to
    fit both with the same numbers. None where the robot lifts none, or cannot keep to its limits with it."""
    load = _known_payload(robot)
    keys = {*tie.rival, *(e.key for e in (*tie.truth, *tie.beside, *robot.effects))}
    if load is None or load.key in keys:
        return None
    heavier = robot.extended([load])
    try:
        run = evidence.simulated(heavier, [*tie.beside, *tie.truth], reference)
    except FlexJointError:
        return None
    if exceeded(robot, limits, run.true):
        return None
    plain = evidence.simulated(robot, [*tie.beside, *tie.truth], reference)
    odds = [
        Evidence(model, evidence.recorded(one, question.sensors, seed + k)).odds(
            tie.beside, tie.truth, tie.rival
        )
        for k, (model, one) in enumerate(((robot, plain), (heavier, run)))
    ]
    mass, (x, y, z) = load.values["mass"], load.values["position"]
    return Proposal(
        f"record the motion once more with a known payload of {mass:.3g} kg on {load.joint}, at"
        f" ({x:.3g}, {y:.3g}, {z:.3g}) m in its link's frame, and diagnose both recordings together",
        evidence.pair(*odds),
    )


def _known_payload(robot: Robot) -> Planned | None:
    """A point mass at the last link, of a weight that its joints hold with a quarter of their torque."""
    last = robot.joints[-1]
    inertia = robot.model.inertias[last.pin_id]
    position = (
        1.5 * np.array(inertia.lever)
        if np.linalg.norm(inertia.lever) > 0.01
        else np.array([0, 0, USUAL.plan.payload_arm])
    )
    gravity = float(np.linalg.norm(robot.gravity))
    reach = float(np.linalg.norm(position))
    heaviest = np.inf
    below = last.pin_id
    for joint in reversed(robot.joints):
        while below > joint.pin_id:
            reach += float(np.linalg.norm(robot.model.jointPlacements[below].translation))
            below = robot.model.parents[below]
        if np.isfinite(joint.torque_limit) and gravity > 0.0:
            heaviest = min(heaviest, USUAL.plan.payload_torque * joint.torque_limit / (gravity * reach))
    mass = float(f"{min(heaviest, float(inertia.mass)):.2g}")
    if not np.isfinite(mass) or mass < USUAL.plan.payload_least:
        return None
    place = tuple(float(f"{x:.3g}") for x in position)
    return effect("payload", last.name, nominal=True, mass=mass, position=place)
