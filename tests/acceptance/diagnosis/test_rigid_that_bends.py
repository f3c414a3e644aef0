"""Robot files that take a joint as rigid, of machines whose joints bend: the commonest nominal model.

A rigid model that is fitted to a joint that bends turns the flexibility into a delay, an inertia, or nothing;
here it has its name, its stiffness, and the friction beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import exhaustive, thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

SURE = 0.9  # probability from which a name is a claim
TOLERANCE = 0.05  # of a number: what nominal tolerances of 2 % take for themselves, and noise


def taken_as_rigid(name: str, *joints: str) -> Robot:
    robot = nominal(name)
    rigid = [replace(j, drive=replace(j.drive, K=math.inf, D=0.0)) for j in robot.joints]
    return replace(
        robot,
        joints=tuple(r if j.name in joints else j for j, r in zip(robot.joints, rigid, strict=True)),
    )


def motors_alone(case: Case, *causes: Planted) -> Recording:
    recording = as_recording(case.with_causes(*causes), case.name)
    kept = {key: x for key, x in recording.columns.items() if key[0] in ("theta", "dtheta", "tau_m")}
    return replace(recording, columns=kept)


@cache
def lever() -> Diagnosis:
    return diagnose(taken_as_rigid("lever", "swing"), motors_alone(Case("lever", "rich", 61)))


def test_a_joint_that_bends_has_its_name_and_its_stiffness() -> None:
    (found,) = lever().findings
    assert (found.effect, found.joint) == ("joint_compliance", "swing")
    assert lever().verdict == "causes" and found.probability > SURE and found.since is None
    compliance = found.parameters["compliance"].value
    assert compliance == pytest.approx(1.0 / nominal("lever").joint("swing").drive.K, rel=TOLERANCE)


def test_the_extended_model_simulates_what_the_rigid_one_gets_wrong() -> None:
    """On data that the fit did not see."""
    compared = lever().comparison
    assert compared is not None
    before, after = (side["nrmse"]["theta.swing"] for side in (compared.before, compared.after))
    assert after < 0.2 * before


@exhaustive
def test_friction_beside_it_is_found_too() -> None:
    friction = Planted("motor_coulomb_friction", "swing", {"level": 4.0})
    found = diagnose(taken_as_rigid("lever", "swing"), motors_alone(Case("lever", "rich", 62), friction))
    named = {f.effect: f for f in found.findings if f.probability > 0.5}
    assert set(named) == {"joint_compliance", "motor_coulomb_friction"}
    level = named["motor_coulomb_friction"].parameters["level"].value
    assert level == pytest.approx(4.0, rel=TOLERANCE)


@thorough
def test_one_of_two_joints() -> None:
    """The shoulder of a crane is known to be flexible, its elbow is taken as rigid."""
    found = diagnose(taken_as_rigid("crane", "elbow"), motors_alone(Case("crane", "rich", 63)))
    (cause,) = (f for f in found.findings if f.probability > 0.5)
    assert (cause.effect, cause.joint) == ("joint_compliance", "elbow")
    compliance = cause.parameters["compliance"].value
    assert compliance == pytest.approx(1.0 / nominal("crane").joint("elbow").drive.K, rel=0.1)
