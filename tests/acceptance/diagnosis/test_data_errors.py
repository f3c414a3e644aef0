"""Wrong data are named as what they are: on logs of a UR5, each error in turn, and none on machines that are
only imperfect."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from planting import Planted, SensorSet, plant, robot_file
from study.cases import make as study_case
from support.diagnose_cases import as_recording
from support.robots.robot_files import URDF as ARM2
from support.robots.ur5_logs import ELBOW, LIFT, NAMES, PAN, WRIST_1, WRIST_2, WRIST_3, log, ur5
from support.thorough import sample, thorough

import flexjoint as fj
from flexjoint.cli.main import main
from flexjoint.diagnosis.data.bodies import impossible
from flexjoint.diagnosis.data.check import DataCheck, check_data
from flexjoint.diagnosis.result import DataFinding
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.checks import check
from flexjoint.recording.table import Recording, read
from flexjoint.robot import schema
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot, build, load, robots_folder, shipped_robots

Columns = dict[tuple[str, str], np.ndarray]
GEAR, CONSTANT = 80.0, 0.11
FRICTIONS = (0.0, 0.5)  # of the joint's torque, unknown to the model


def wrong(change: Callable[[Columns], None], friction: float = 0.5) -> Recording:
    whole = log(friction=friction)
    columns = {key: values.copy() for key, values in whole.columns.items()}
    change(columns)
    return replace(whole, columns=columns)


def only(found: DataCheck, error: str, joint: str | None) -> DataFinding:
    """The only finding, of this kind and joint; its repair leaves none."""
    assert [(f.error, f.joint) for f in found.findings] == [(error, joint)], str(found)
    return found.findings[0]


def scaled(channel: str, *joints: str, by: float = -1.0) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        for joint in joints:
            columns[channel, joint] *= by

    return change


def swapped(one: str, other: str, *channels: str) -> Callable[[Columns], None]:
    def change(columns: Columns) -> None:
        for channel in channels:
            columns[channel, one], columns[channel, other] = columns[channel, other], columns[channel, one]

    return change


# --- nothing is wrong -----------------------------------------------------------------------------------
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_right_log_passes(friction: float) -> None:
    assert not check_data(ur5(), log(friction=friction)).findings


@pytest.mark.parametrize("gain", [0.8, 1.2])
def test_a_torque_constant_off_by_a_fifth_is_no_error_of_the_data(gain: float) -> None:
    assert not check_data(ur5(), wrong(scaled("tau_motor", *NAMES, by=gain))).findings


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.1), (0.1, 0.05, 0.05)])
@pytest.mark.parametrize("mass", [0.5, 5.0])
def test_a_load_is_no_error_of_the_data(mass: float, place: tuple[float, float, float]) -> None:
    """Unknown and carried, or claimed and not there: a wrist's torque is many times what it should be, or the
    other way round."""
    assert not check_data(ur5(), log(mass=mass, place=place)).findings
    assert not check_data(KnownPayload(WRIST_3, mass, place).on(ur5()), log()).findings


@pytest.mark.parametrize("name", ["rec_A", "rec_B", "rec_C"])
def test_the_shipped_recordings_are_right(name: str) -> None:
    table = read(robots_folder() / "kr300" / "recordings" / f"{name}.parquet")
    assert not check_data(load("kr300"), table).findings


LARGE = [  # of the study, the largest size of the effect each
    *(("single", 12 * k) for k in range(0, 30, 4)),  # 288 is a hard stop
    ("single", 228),
    ("beyond", 12),
    ("beyond", 120),  # a shake by fourteen times a wrist's torque
    ("double", 2),
    ("drawn", 5),
]


@pytest.mark.parametrize(("part", "number"), sample(LARGE, one_in=6, several=True), ids=str)
def test_a_large_cause_is_no_error_of_the_data(part: str, number: int) -> None:
    case = study_case(part, number).case
    robot = load(robot_file(case.robot))
    assert not check_data(robot, as_recording(case.train())).findings


# --- signs ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("joint", NAMES)
@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_turned_torque(joint: str, friction: float) -> None:
    found = check_data(ur5(), wrong(scaled("tau_motor", joint), friction))
    finding = only(found, "turned_torque", joint)
    assert finding.factor is not None and finding.factor > 10.0
    assert f"tau_motor.{joint} has the wrong sign: the torque balance of {joint} is " in finding.text
    assert np.array_equal(
        found.repaired.get("tau_motor", joint), log(friction=friction).get("tau_motor", joint)
    )


@pytest.mark.parametrize("joint", NAMES[:-1])
def test_turned_positions(joint: str) -> None:
    finding = only(check_data(ur5(), wrong(scaled("q", joint))), "turned_position", joint)
    assert [str(column) for column in finding.columns] == [f"q.{joint} = -1 * q.{joint}"]


def test_an_axis_that_points_the_other_way() -> None:
    def change(columns: Columns) -> None:
        scaled("q", LIFT)(columns)
        scaled("tau_motor", LIFT)(columns)

    finding = only(check_data(ur5(), wrong(change)), "turned_joint", LIFT)
    assert {column.name for column in finding.columns} == {f"q.{LIFT}", f"tau_motor.{LIFT}"}


def test_all_torques_turned_are_one_error() -> None:
    finding = only(check_data(ur5(), wrong(scaled("tau_motor", *NAMES))), "turned_torque", None)
    assert len(finding.columns) == len(NAMES)


def test_two_errors_are_both_named() -> None:
    def change(columns: Columns) -> None:
        scaled("q", LIFT)(columns)
        scaled("tau_motor", ELBOW)(columns)

    found = check_data(ur5(), wrong(change))
    assert {(f.error, f.joint) for f in found.findings} == {
        ("turned_position", LIFT),
        ("turned_torque", ELBOW),
    }
    assert not check_data(ur5(), found.repaired).findings


def with_motor_side(columns: Columns) -> None:
    columns["theta", ELBOW] = columns["q", ELBOW].copy()
    columns["dtheta", ELBOW] = np.gradient(columns["theta", ELBOW], 1.0 / 250.0)


def test_a_turned_motor_encoder_and_its_velocity() -> None:
    def change(columns: Columns) -> None:
        with_motor_side(columns)
        scaled("theta", ELBOW)(columns)
        scaled("dtheta", ELBOW)(columns)

    found = check_data(ur5(), wrong(change))
    finding = only(found, "turned_motor_encoder", ELBOW)
    assert [column.name for column in finding.columns] == [f"theta.{ELBOW}", f"dtheta.{ELBOW}"]
    assert not check_data(ur5(), found.repaired).findings


def test_a_turned_link_encoder_beside_a_right_motor() -> None:
    def change(columns: Columns) -> None:
        with_motor_side(columns)
        scaled("q", ELBOW)(columns)

    finding = only(check_data(ur5(), wrong(change)), "turned_link_encoder", ELBOW)
    assert [column.name for column in finding.columns] == [f"q.{ELBOW}"]


def test_a_turned_velocity() -> None:
    def change(columns: Columns) -> None:
        columns["dq", ELBOW] = -np.gradient(columns["q", ELBOW], 1.0 / 250.0)

    assert only(check_data(ur5(), wrong(change)), "turned_velocity", ELBOW).columns[0].scale == -1.0


# --- zeros, names, units --------------------------------------------------------------------------------
@pytest.mark.parametrize(("joint", "degrees"), [(ELBOW, 90.0), (ELBOW, -90.0), (ELBOW, 180.0), (LIFT, -60.0)])
def test_a_zero_that_is_far_off(joint: str, degrees: float) -> None:
    def change(columns: Columns) -> None:
        columns["q", joint] += math.radians(degrees)

    finding = only(check_data(ur5(), wrong(change)), "zero", joint)
    # 1 degree: friction, which is not known, bends the best angle where no eighth of a turn is near
    off = math.remainder(finding.columns[0].offset + math.radians(degrees), 2.0 * math.pi)
    assert abs(off) < math.radians(1.0)
    assert f"the zero of the positions of {joint} is off by" in finding.text


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.parametrize("degrees", [90.0, 180.0])
def test_the_zero_of_an_elbow_that_moves_little(seed: int, degrees: float) -> None:
    """A spring with an offset would explain the elbow's torque, a load the elbow's alone: neither explains
    the shoulder's and the wrist's with it."""
    whole = log(seed=seed, size=0.35)
    columns = {**whole.columns, ("q", ELBOW): whole.get("q", ELBOW) + math.radians(degrees)}
    assert not check_data(ur5(), whole).findings
    only(check_data(ur5(), replace(whole, columns=columns)), "zero", ELBOW)


def test_a_motor_encoder_whose_zero_lies_beside_the_links() -> None:
    def change(columns: Columns) -> None:
        with_motor_side(columns)
        columns["theta", ELBOW] += 1.0

    finding = only(check_data(ur5(), wrong(change)), "zero", ELBOW)
    assert [(c.name, round(c.offset, 3)) for c in finding.columns] == [
        (f"theta.{ELBOW}", -1.0),
        (f"dtheta.{ELBOW}", 0.0),
    ]


@pytest.mark.parametrize(
    ("one", "other", "channels", "error"),
    [
        (PAN, ELBOW, ("q", "tau_motor"), "swapped_joints"),  # as an alphabetical order has them
        (ELBOW, WRIST_1, ("q", "tau_motor"), "swapped_joints"),
        (LIFT, ELBOW, ("q",), "swapped_positions"),
        (PAN, ELBOW, ("tau_motor",), "swapped_torques"),
        (WRIST_1, WRIST_2, ("tau_motor",), "swapped_torques"),
    ],
)
def test_swapped_joints(one: str, other: str, channels: tuple[str, ...], error: str) -> None:
    found = check_data(ur5(), wrong(swapped(one, other, *channels)))
    finding = only(found, error, None)
    assert one in finding.text and other in finding.text
    for key, values in log().columns.items():
        assert np.array_equal(found.repaired.columns[key], values), key


@pytest.mark.parametrize(
    ("factor", "robot", "says"),
    [
        (1.0 / (GEAR * CONSTANT), ur5(GEAR, CONSTANT), "looks like amperes"),
        (1.0 / GEAR, ur5(GEAR), "looks like the torque of the motor"),
        (1000.0, ur5(), "looks like mN m"),
    ],
)
def test_torques_in_another_unit(factor: float, robot: Robot, says: str) -> None:
    found = check_data(robot, wrong(scaled("tau_motor", *NAMES, by=factor)))
    finding = only(found, "unit", None)
    assert says in finding.text
    for name in NAMES:
        assert found.repaired.get("tau_motor", name) == pytest.approx(log().get("tau_motor", name))


def test_torques_in_a_unit_that_nothing_tells() -> None:
    found = check_data(ur5(), wrong(scaled("tau_motor", *NAMES, by=1.0 / (GEAR * CONSTANT))))
    assert {f.error for f in found.findings} == {"unit"} and ELBOW in {f.joint for f in found.findings}
    assert "gear_ratio and torque_constant in the robot file would tell" in found.findings[0].text
    (of_elbow,) = (f.columns[0].scale for f in found.findings if f.joint == ELBOW)
    assert of_elbow == pytest.approx(
        GEAR * CONSTANT, rel=0.1
    )  # to the two digits that are stated, and friction


@pytest.mark.parametrize("gear", [51.0, 57.0, 100.0])
@pytest.mark.parametrize("known", [True, False])
def test_a_motor_angle_before_its_gear_is_not_called_degrees(gear: float, known: bool) -> None:
    def change(columns: Columns) -> None:
        columns["theta", ELBOW] = gear * columns["q", ELBOW]

    robot, table = ur5(gear if known else None), wrong(change)
    if not known and gear == 57.0:
        return  # 57.3 times is degrees to anybody who does not know the gear
    check(robot, table)
    finding = only(check_data(robot, table), "gear", ELBOW)
    assert finding.columns[0].scale == pytest.approx(1.0 / gear, rel=1e-3)


def test_motor_angles_before_their_gears_without_a_link_encoder() -> None:
    def change(columns: Columns) -> None:
        for name in NAMES:
            columns["theta", name] = GEAR * columns.pop(("q", name))

    found = check_data(ur5(GEAR), wrong(change))
    finding = only(found, "gear", None)
    assert {column.scale for column in finding.columns} == {1.0 / GEAR}


def test_a_robot_that_hangs_and_a_file_that_says_it_stands() -> None:
    model = ur5().model.copy()
    model.gravity.linear = np.array([0.0, 0.0, 9.81])
    hanging = Robot.from_model(model, NAMES, motor_inertia=0.2)
    finding = only(check_data(hanging, log()), "gravity", None)
    assert finding.robot_file == "gravity: [0, 0, -9.81]" and not finding.columns


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('ixx="0.02"', 'ixx="-0.02"', "has a principal moment of inertia of -0.0"),
        ('ixx="0.02" iyy="0.02" izz="0.02"', 'ixx="2e4" iyy="2e4" izz="2e4"', "inertias are in kg m^2"),
    ],
)
def test_bodies_that_cannot_exist(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "arm2.urdf"
    path.write_text(ARM2.replace(old, new))
    swing = 0.3 * np.sin(np.arange(500) / 100.0)
    table = fj.make_recording(
        np.arange(500) / 250.0, {("q", name): swing for name in ("shoulder", "elbow", "wrist")}
    )
    found = check_data(load(path), table)
    assert found.findings and {f.error for f in found.findings} == {"impossible_body"}
    assert says in found.findings[0].text


def test_a_body_of_negative_mass_that_was_made_in_memory() -> None:
    model = ur5().model.copy()
    model.inertias[2].mass = -1.0
    found = check_data(Robot.from_model(model, NAMES, motor_inertia=0.2), log())
    assert {f.error for f in found.findings} == {"impossible_body"}
    assert "has a mass of -1 kg" in found.findings[0].text


def test_shipped_robots_have_possible_bodies() -> None:
    assert [name for name in shipped_robots() if list(impossible(load(name), USUAL.data))] == []


# --- what a user meets ----------------------------------------------------------------------------------
def test_a_diagnosis_ends_with_what_is_wrong_and_the_repair(tmp_path: Path) -> None:
    table = wrong(scaled("tau_motor", ELBOW))
    diagnosis = fj.diagnose(ur5(), table)
    assert diagnosis.verdict == "refused" and not diagnosis.findings
    assert diagnosis.reason.startswith(f"the data cannot be right: tau_motor.{ELBOW} has the wrong sign")
    said = str(diagnosis)
    assert "Are the data right?" in said and f"tau_motor.{ELBOW} = -1 * tau_motor.{ELBOW}" in said
    diagnosis.write(tmp_path / "d.json")
    (data,) = json.loads((tmp_path / "d.json").read_text())["data"]
    assert (data["kind"], data["error"], data["joint"]) == ("data", "turned_torque", ELBOW)
    assert data["repair"]["columns"] == [
        {"column": f"tau_motor.{ELBOW}", "from": f"tau_motor.{ELBOW}", "scale": -1.0, "offset": 0.0}
    ]


def test_the_command_says_it_repairs_it_and_is_content(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ur5().write("ur5.yaml")
    replace(wrong(scaled("tau_motor", ELBOW)), name="log").write("log.parquet")
    assert main(["check-data", "log.parquet", "--robot", "ur5.yaml", "--json", "found.json"]) == 2
    printed = capsys.readouterr()
    assert f"tau_motor.{ELBOW} has the wrong sign" in printed.out and printed.err.count("\n") == 1
    assert json.loads(Path("found.json").read_text())["data"][0]["error"] == "turned_torque"
    (command,) = (line.split(": ", 1)[1] for line in printed.out.splitlines() if line.startswith("All of it"))
    assert main(command.split()[1:]) == 0
    assert main(["check-data", "repaired.parquet", "--robot", "ur5.yaml"]) == 0
    assert "no error of the data found" in capsys.readouterr().out


@thorough
def test_a_diagnosis_goes_on_where_it_is_told_to() -> None:
    """On one joint of a rigid lever, for the time that it takes."""
    path = robot_file("lever_exact")
    raw = yaml.safe_load(path.read_text())
    raw["joints"]["swing"]["stiffness"] = math.inf
    robot = build(schema.parse(raw, "lever"), path)
    causes = [Planted("motor_coulomb_friction", "swing", {"level": 3.0})]
    recorded = as_recording(plant(path, causes, "rich", 6.0, 5, SensorSet(channels=("theta", "tau_motor"))))
    turned = replace(
        recorded,
        columns={k: -v if k[0] == "tau_motor" else v for k, v in recorded.columns.items()},
    )
    told = fj.diagnose(robot, turned, workers=1, refine=False)
    assert told.verdict == "refused" and [f.error for f in told.data] == ["turned_torque"]
    on = fj.diagnose(robot, turned, workers=1, refine=False, check_data=False)
    assert on.verdict != "refused" and [f.error for f in on.data] == ["turned_torque"]
