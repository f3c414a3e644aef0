"""A robot file as `flexjoint init` drafts it from a URDF: nobody stated friction or the inertia of rotors."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording, summary

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, Fitted
from flexjoint.robot import robot
from flexjoint.robot.draft import draft

JOINTS = ("shoulder", "elbow")
COULOMB = {"shoulder": 6.0, "elbow": 2.8}  # N m
SURE = 0.8  # probability from which a name is a claim


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The crane of the planting with rigid joints, beside its description."""
    folder = tmp_path_factory.mktemp("crane")
    data = yaml.safe_load((ROBOTS / "crane.yaml").read_text())
    for joint in JOINTS:
        data["joints"][joint] |= {"stiffness": float("inf"), "damping": 0.0}
    shutil.copyfile(ROBOTS / "crane.urdf", folder / "crane.urdf")
    path = folder / "crane.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def found(real: Path) -> Diagnosis:
    causes = [Planted("motor_coulomb_friction", joint, {"level": COULOMB[joint]}) for joint in JOINTS]
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(real, causes, "rich", 16.0, 5, sensors, rate=250.0)
    drafted = real.with_name("drafted.yaml")
    drafted.write_text(draft(str(real.with_name("crane.urdf")), drafted).text)
    return diagnose(robot.load(drafted), [as_recording(recorded)])


def test_what_a_description_leaves_out_is_found_at_every_joint(real: Path, found: Diagnosis) -> None:
    true = robot.load(real)
    wanted = {
        **{("motor_coulomb_friction", j): ("level", COULOMB[j]) for j in JOINTS},
        **{("motor_viscous_friction", j): ("coefficient", true.joint(j).drive.D_m) for j in JOINTS},
        **{("rotor_inertia", j): ("inertia", true.joint(j).drive.B) for j in JOINTS},
    }
    assert {(f.effect, f.joint) for f in found.findings} == set(wanted), summary(found)
    for f in found.findings:
        name, value = wanted[f.effect, f.joint]
        fitted = f.parameters[name]
        assert isinstance(fitted, Fitted)
        assert f.probability > SURE, summary(found)
        # the draft trusts masses and inertias to 10 %: an inertia at the rotor is known by that much
        assert fitted.value == pytest.approx(value, rel=0.1), summary(found)
        assert abs(fitted.value - value) < 4.0 * fitted.std, summary(found)


def test_a_scale_of_an_inertia_that_is_not_there_is_not_spoken_of(found: Diagnosis) -> None:
    said = {effect for effect, _ in found.not_excited}
    ties = {tie.effect for f in found.findings for tie in f.indistinguishable}
    assert "motor_inertia" not in said | ties
