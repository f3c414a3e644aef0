"""A wrist of two motors that bend it together and turn it against each other, which the robot file does not
say: its friction is on both motors' shafts. Planted by the generator, whose shafts creep where ours stick."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording, summary
from support.thorough import thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, Fitted
from flexjoint.robot import robot

MOTOR = SensorSet(channels=("theta", "tau_motor"))
LEVELS, COEFFICIENTS = {"sum": 2.2, "difference": 3.1}, {"sum": 3.0, "difference": 4.2}  # N m, N m s/rad
DIFFERENTIAL = {
    **{f"level_{way}": level for way, level in LEVELS.items()},
    **{f"coefficient_{way}": coefficient for way, coefficient in COEFFICIENTS.items()},
}


def wrist(folder: Path, rigid: bool) -> Path:
    """The generator's crane; rigid: without its springs."""
    data = yaml.safe_load((ROBOTS / "crane.yaml").read_text())
    for joint in data["joints"].values() if rigid else ():
        joint |= {"stiffness": float("inf"), "damping": 0.0}
    shutil.copyfile(ROBOTS / "crane.urdf", folder / "crane.urdf")
    path = folder / "crane.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


def diagnosed(folder: Path, rigid: bool, causes: list[Planted]) -> Diagnosis:
    path = wrist(folder, rigid)
    sensors = MOTOR if rigid else SensorSet()
    recorded = plant(path, causes, "rich", 8.0, 11, sensors, rate=250.0)
    return diagnose(robot.load(path), [as_recording(recorded)], refine=False)


@thorough
@pytest.mark.parametrize("rigid", [True, False])
def test_it_is_named_and_measured(tmp_path: Path, rigid: bool) -> None:
    found = diagnosed(tmp_path, rigid, [Planted("differential_friction", "elbow", {**DIFFERENTIAL})])
    assert [(f.effect, f.joint) for f in found.findings] == [("differential_friction", "elbow")], summary(
        found
    )
    assert any("joints: [shoulder, elbow], matrix: [[1, 1], [-1, 1]]" in note for note in found.notes), (
        found.notes
    )
    (finding,) = found.findings
    assert found.verdict == "causes" and finding.probability > 0.9, summary(found)
    for name, true in DIFFERENTIAL.items():
        fitted = finding.parameters[name]
        assert isinstance(fitted, Fitted) and fitted.value == pytest.approx(true, rel=0.05), name


@thorough
@pytest.mark.parametrize(("speed", "matrix"), [("sum", "[1, 0], [1, 1]"), ("difference", "[1, 0], [-1, 1]")])
def test_one_motor_on_both_joints_is_no_differential(tmp_path: Path, speed: str, matrix: str) -> None:
    shared = Planted("coupled_friction", "elbow", {"level": 2.2, "coefficient": 3.0, "speed": speed})
    found = diagnosed(tmp_path, True, [shared])
    assert [(f.effect, f.joint) for f in found.findings] == [("coupled_friction", "elbow")], summary(found)
    assert any(f"joints: [shoulder, elbow], matrix: [{matrix}]" in note for note in found.notes), found.notes


@thorough
def test_friction_of_two_joints_is_no_differential(tmp_path: Path) -> None:
    causes = [Planted("motor_coulomb_friction", joint, {"level": 2.5}) for joint in ("shoulder", "elbow")]
    found = diagnosed(tmp_path, True, causes)
    named = {(f.effect, f.joint) for f in found.findings}
    assert named == {(cause.effect, cause.joint) for cause in causes}, summary(found)
