"""A load that is picked and placed while the recording runs, as most industrial arms do: told with its mass,
its place and its times, on flexible and on rigid machines, and not as several loads one after the other."""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import Case, as_recording, found_in, nominal, summary
from support.thorough import exhaustive, sample, thorough

from flexjoint.diagnosis.followup.checking.check import check
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.values import to_json
from flexjoint.diagnosis.result.wording import when
from flexjoint.robot import robot

MASS = 2.0
PLACE = (0.0, 0.0, -0.4)
DATED = 0.05  # s


@cache
def lever(since: float | None, *switches: float) -> Diagnosis:
    load = Planted("payload", "swing", {"mass": MASS, "position": list(PLACE)}, since, switches)
    case = Case("lever", "rich", 71)
    return diagnose(nominal("lever"), as_recording(case.with_causes(load), case.name))


def only_load(found: Diagnosis) -> dict[str, object]:
    """The entry of the JSON."""
    likely = [f for f in found.findings if f.probability > 0.5]
    assert [f.effect for f in likely] == ["payload"], summary(found)
    assert likely[0].parameters["mass"].value == pytest.approx(MASS, rel=0.05)
    entry: dict[str, object] = to_json(found)["findings"][0]
    return entry


def test_picked_once_and_placed() -> None:
    entry = only_load(lever(4.0, 8.0))
    np.testing.assert_allclose(np.array(entry["during"], dtype=float), [[4.0, 8.0]], atol=DATED)
    assert entry["since"] == entry["during"][0][0]  # type: ignore[index]


def test_held_from_the_start_and_placed() -> None:
    found = lever(None, 5.0)
    entry = only_load(found)
    ((begin, end),) = entry["during"]  # type: ignore[misc]
    assert begin == entry["since"] == 0.0 and end == pytest.approx(5.0, abs=DATED)
    assert when(found.findings[0]).startswith("at t = 0 to ")


def test_the_machine_without_the_load_is_as_it_was() -> None:
    """A load is no part of the machine: a check of the next recording does not miss it."""
    case = Case("lever", "rich", 75)
    checked = check(nominal("lever"), as_recording(case.with_causes(), case.name), lever(4.0, 8.0))
    assert checked.verdict == "as_before", str(checked)
    assert not any(joint.causes for joint in checked.joints), str(checked)


@thorough
def test_a_rigid_machine_that_picks_again_and_again_beside_a_friction(tmp_path: Path) -> None:
    """Its log holds motor angles and torques only, as those of most arms."""
    data = yaml.safe_load((ROBOTS / "lever.yaml").read_text())
    data["joints"]["swing"] |= {"stiffness": float("inf"), "damping": 0.0, "kp": 600.0, "kd": 30.0}
    shutil.copyfile(ROBOTS / "lever.urdf", tmp_path / "lever.urdf")
    path = tmp_path / "rigid.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    spans = [[2.0, 4.5], [7.0, 10.0], [13.0, 18.0]]
    times = [t for span in spans for t in span]
    load = Planted("payload", "swing", {"mass": MASS, "position": list(PLACE)}, times[0], tuple(times[1:]))
    friction = Planted("motor_coulomb_friction", "swing", {"level": 3.0})
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(path, [load, friction], "rich", 20.0, 72, sensors, 250.0)
    found = diagnose(robot.load(path), as_recording(recorded, "picks"))

    likely = {f.effect: f for f in found.findings if f.probability > 0.5}
    assert set(likely) == {"payload", "motor_coulomb_friction"}, summary(found)
    np.testing.assert_allclose(np.array(likely["payload"].during, dtype=float), spans, atol=DATED)
    assert likely["motor_coulomb_friction"].parameters["level"].value == pytest.approx(3.0, rel=0.05)
    assert not likely["motor_coulomb_friction"].during


@thorough
def test_a_load_that_stays_is_not_put_down() -> None:
    """Neither one that was always there, nor one that is picked and kept."""
    for since in (None, 5.0):
        (finding,) = (f for f in lever(since).findings if f.probability > 0.5)
        assert (finding.effect, finding.during) == ("payload", ())
        assert (finding.since is None) == (since is None)


@pytest.mark.parametrize(
    "strange", sample(["cogging", "periodic_disturbance", "asymmetric_friction"], one_in=4, thorough_in=3)
)
def test_what_has_no_name_is_no_load_that_comes_and_goes(strange: str) -> None:
    """A load that could be switched at will would imitate anything."""
    cause = {
        "cogging": Planted("cogging", "swing", {"amplitude": 3.0, "cycles": 9.0, "phase": 0.4}),
        "periodic_disturbance": Planted(
            "periodic_disturbance", "swing", {"amplitude": 4.0, "frequency": 0.7, "phase": 0.2}
        ),
        "asymmetric_friction": Planted(
            "asymmetric_friction", "swing", {"level_positive": 5.0, "level_negative": 2.0}
        ),
    }[strange]
    struck = {"cogging", "periodic_disturbance", "asymmetric_friction", "motor_coulomb_friction"}
    found = found_in(Case("lever", "rich", 73), cause, excluded=frozenset(struck | {"torque_offset"}))
    assert not [f for f in found.findings if f.effect == "payload" and f.probability > 0.5], summary(found)


@exhaustive
def test_what_two_recordings_share_is_judged_beside_the_loads_of_each() -> None:
    """A friction is common to both; when a load was held is each one's own."""
    friction = Planted("motor_coulomb_friction", "swing", {"level": 3.0})
    recordings = []
    for seed, since, switches in ((101, 3.0, (6.0, 8.5)), (102, None, (4.0, 9.0))):
        load = Planted("payload", "swing", {"mass": MASS, "position": list(PLACE)}, since, switches)
        recordings.append(as_recording(Case("lever", "rich", seed).with_causes(load, friction), f"{seed}"))
    found = diagnose(nominal("lever"), recordings)

    likely = {f.effect: f for f in found.findings if f.probability > 0.5}
    assert set(likely) == {"payload", "motor_coulomb_friction"}, summary(found)
    assert "causes and numbers common to all 2 recordings" in found.notes
    assert likely["motor_coulomb_friction"].parameters["level"].value == pytest.approx(3.0, rel=0.01)
    ((first, _), _) = likely["payload"].during
    assert first == pytest.approx(3.0, abs=DATED)
