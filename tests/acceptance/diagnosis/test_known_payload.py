"""A known payload in one of two recordings is part of that one's nominal model; the same recording twice says
what it says once."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from planting import ROBOTS, Planted, SensorSet, plant
from planting.machine.sensing import TOLD
from support.diagnose_cases import as_recording, nominal, summary
from support.thorough import thorough

from flexjoint.cli import main as cli
from flexjoint.core.errors import RecordingError, RobotError, UnknownNameError
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, Fitted
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.rigidbody.numeric import PinBody, inertial_of
from flexjoint.robot.payload import KnownPayload, parse
from flexjoint.robot.robot import Robot

# without q the torque sensor alone tells the deflection: its gain is the links' or the motor's
SENSORS = SensorSet(channels=("theta", "dtheta", "tau_t", "tau_m", *TOLD), noisy_feedback=False)
GAIN = Planted("torque_sensor_gain", "swing", {"gain": 0.05})
SMALL = Planted("torque_sensor_gain", "swing", {"gain": 0.02})
PLACE = (0.0, 0.0, -0.3)
LOAD = KnownPayload("swing", 2.0, PLACE)


@cache
def swung(seed: int, *causes_and_load: str) -> Recording:
    load = Planted("payload", "swing", {"mass": LOAD.mass, "position": list(PLACE)})
    planted = [{"gain": GAIN, "small": SMALL, "load": load}[name] for name in causes_and_load]
    path = ROBOTS / "lever.yaml"
    return as_recording(plant(path, planted, "slow", 8.0, seed, SENSORS), f"swing-{seed}")


def lever() -> Robot:
    """Its link is known to 8 %: a gain of 5 % lies well within."""
    robot = nominal("lever")
    return replace(robot, tolerance=robot.tolerance.model_copy(update={"inertial": 0.08}))


def tied(diagnosis: Diagnosis) -> set[str]:
    """Both gains, where either is named and the other listed beside it. (A cogging of one cycle is nearly a
    gain on this motion: whether it is listed, too, hangs on a few units of energy.)"""
    names = {"torque_gain", "torque_sensor_gain"}
    gains = [f for f in diagnosis.findings if f.effect in names]
    assert len(gains) == 1, summary(diagnosis)
    return names & {gains[0].effect, *(t.effect for t in gains[0].indistinguishable)}


@thorough
def test_the_same_recording_twice_names_what_it_names_once() -> None:
    """Twice the data count as twice the evidence. Of a gain of 2 % the scores differ by 1 to 3 of the 12 that
    are chance, of one of 4 % by 5 to more than 12."""
    once = diagnose(lever(), [swung(3, "small")], refine=False)
    twice = diagnose(lever(), [swung(3, "small"), swung(3, "small")])
    assert len(tied(once)) == 2, summary(once)
    assert tied(twice) == tied(once), summary(twice)


@thorough
def test_a_known_payload_in_one_recording_tells_the_gains_apart() -> None:
    pair = diagnose(lever(), [swung(3, "gain"), swung(4, "gain", "load")], payloads=(None, LOAD))
    assert [f.effect for f in pair.findings] == ["torque_sensor_gain"], summary(pair)
    assert tied(pair) == {"torque_sensor_gain"}
    assert pair.findings[0].probability > 0.9
    gain = pair.findings[0].parameters["gain"]
    assert isinstance(gain, Fitted) and isinstance(gain.value, float)
    # within the parameter's goal of 2 % of itself, which the link's 8 % would never give
    assert gain.value == pytest.approx(0.05, rel=0.03)
    assert any("swing-4 was recorded with a known payload of 2 kg on swing" in note for note in pair.notes)


@thorough
def test_a_known_payload_is_no_cause() -> None:
    loaded = diagnose(nominal("lever"), [swung(5, "load")], payloads=(LOAD,))
    assert loaded.verdict == "healthy", summary(loaded)
    blind = diagnose(nominal("lever"), [swung(5, "load")])
    assert blind.verdict != "healthy", summary(blind)


# --- the robot with it ------------------------------------------------------------------------------------
def test_a_payload_adds_its_weight_and_inertia() -> None:
    robot = nominal("crane")
    load = KnownPayload("elbow", 1.5, (0.1, 0.02, -0.3), (0.02, 0.0, 0.03, 0.0, 0.0, 0.04))
    body, q = PinBody(load.on(robot).model), np.array([0.3, -0.7])
    own = PinBody(robot.model)
    # the torques of a point mass are J^T m g; its height by finite differences of Pinocchio's placement
    index = robot.joint("elbow").pin_id

    def height(angles: np.ndarray) -> float:
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, angles)
        return float(data.oMi[index].act(np.array(load.position))[2])

    step = 1e-6
    slope = np.array([(height(q + step * e) - height(q - step * e)) / (2 * step) for e in np.eye(2)])
    added = body.gravity_torque(q) - own.gravity_torque(q)
    assert added == pytest.approx(1.5 * 9.81 * slope, rel=1e-6)
    assert load.on(robot).mass == pytest.approx(robot.mass + 1.5)
    own_numbers = load.on(robot).own_inertial
    assert own_numbers is not None and np.array_equal(own_numbers, inertial_of(robot.model))
    assert robot.own_inertial is None  # the robot itself is as it was


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("swing", -1.0, PLACE), "mass above 0 kg, got -1"),
        (("swing", float("nan"), PLACE), "finite"),
        (("swing", 1.0, PLACE, (0.1, 0.0, 0.1, 0.0, 0.0, -0.1)), "negative principal moment"),
        (("swing", 1.0, (0.0, 0.1)), "position of 3"),
    ],
)
def test_payloads_that_no_body_has_are_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        KnownPayload(*arguments)


def test_an_unknown_joint_and_a_wrong_number_of_payloads_are_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"'elbow'.*swing"):
        diagnose(lever(), [swung(3, "gain")], payloads=(KnownPayload("elbow", 1.0, PLACE),))
    with pytest.raises(RecordingError, match="each of 1 recordings, got 2"):
        diagnose(lever(), [swung(3, "gain")], payloads=(None, None))


def test_payloads_are_read_from_the_command_line() -> None:
    recordings = ["a.csv", "runs/b.csv"]
    assert parse(["runs/b.csv:elbow=12.5,0.1,0,0.2"], recordings) == [
        None,
        KnownPayload("elbow", 12.5, (0.1, 0.0, 0.2)),
    ]
    full = parse(["a.csv:elbow=1,0,0,0,1,0,1,0,0,1"], recordings)[0]
    assert full is not None and full.inertia == (1.0, 0.0, 1.0, 0.0, 0.0, 1.0)
    assert parse([], recordings) == [None, None]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("c.csv:elbow=1,0,0,0", r"recording of a known payload 'c.csv'"),
        ("a.csv=1,0,0,0", "expected REC:JOINT=MASS"),
        ("a.csv:elbow=1,0,0", "expected numbers"),
        ("a.csv:elbow=1,0,0,x", "expected numbers"),
        ("a.csv:elbow=1,0,0,0,1", "4 or 10 numbers"),
    ],
)
def test_unreadable_payloads_say_what_was_expected(entry: str, message: str) -> None:
    with pytest.raises((RobotError, UnknownNameError), match=message):
        parse([entry], ["a.csv"])
    with pytest.raises(RobotError, match="has one already"):
        parse(["a.csv:elbow=1,0,0,0", "a.csv:elbow=2,0,0,0"], ["a.csv"])


def test_the_command_takes_it(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.parquet"
    recording.write(swung(5, "load"), path)
    call = ["diagnose", str(path), "--robot", str(ROBOTS / "lever.yaml")]
    assert cli.main([*call, "--payload", f"{path}:swing=2,0,0,-0.3"]) == 0
    assert "Healthy" in capsys.readouterr().out
    assert cli.main([*call, "--payload", f"{path}:wrist=2,0,0,-0.3"]) == 2
    assert "swing" in capsys.readouterr().err
