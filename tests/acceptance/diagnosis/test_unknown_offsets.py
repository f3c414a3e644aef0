"""Encoder offsets that nobody knows, and that are others in each recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import ROBOTS, Planted, plant
from support.diagnose_cases import SENSORS, as_recording, nominal, summary
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.signals.signals import centred, prepare
from flexjoint.effects import effect
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

OFFSETS = (
    Planted("link_encoder_offset", "swing", {"offset": -0.018}),
    Planted("motor_encoder_offset", "swing", {"offset": 0.009}),
)
GAP = Planted("backlash", "swing", {"gap": 0.004})  # a seventh of what the offsets make of the deflection
LEVELS = {"level_positive": 2.0, "level_negative": 1.0}


def lever(excitation: str, *causes: Planted) -> tuple[Robot, Recording]:
    known = nominal("lever")
    recorded = plant(
        ROBOTS / "lever.yaml", [*causes, *OFFSETS], excitation, 8.0, 3, SENSORS["full"], inexact=0.02
    )
    return replace(known, file=known.file.model_copy(update={"offsets": "per_recording"})), as_recording(
        recorded
    )


def test_springs_are_centred_by_the_torque_sensor() -> None:
    robot, recording = lever("rich")
    readings = prepare(robot, recording)
    moved = centred(robot, readings).theta - readings.theta

    # the true offset of the deflection is 27 mrad; a spring 2 % off errs by 2 % of the mean deflection
    assert np.ptp(moved) == pytest.approx(0.0, abs=1e-12)
    assert moved[0, 0] == pytest.approx(-0.027, abs=1e-3)
    assert centred(nominal("lever"), readings) is readings  # of encoders that are known nothing is moved


@pytest.mark.parametrize("scale", [0.05, 0.22])
def test_a_stiffness_beside_unknown_offsets_leaves_the_noise(scale: float) -> None:
    """The torque that an offset makes grows with the stiffness, so that each step towards the offset leaves
    that share of it: three steps left four times the noise of a spring 22 % stiffer."""
    robot, recording = lever("rich", Planted("spring_stiffness", "swing", {"scale": scale}))
    problem = Problem(balances_of(robot, recording))
    right = fit(problem, [effect("spring_stiffness", "swing", scale=scale)])

    assert right.energy < 1.3 * problem.noise_energy


@thorough
@pytest.mark.parametrize(
    ("excitation", "cause"),
    [
        ("steps", GAP),
        pytest.param("steps", Planted("asymmetric_friction", "swing", LEVELS), marks=thorough),
        ("rich", Planted("spring_stiffness", "swing", {"scale": 0.22})),
    ],
    ids=lambda value: value if isinstance(value, str) else value.effect,
)
def test_causes_are_named_beside_them(excitation: str, cause: Planted) -> None:
    robot, recording = lever(excitation, cause)
    result = diagnose(robot, [recording], workers=1)

    assert [(f.effect, f.joint) for f in result.findings] == [(cause.effect, cause.joint)], summary(result)
    assert result.verdict == "causes", summary(result)
