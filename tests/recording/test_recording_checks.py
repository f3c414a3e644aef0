"""A recording against its robot: wrong units are found in whatever columns they are, right ones never."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, make

from flexjoint.core.errors import RecordingError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.checks import DEGREES, all_joints, check, check_joints
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, load, robots_folder
from flexjoint.simulation.simulate import simulate

NOISE = {"q": 2e-5, "theta": 2e-5, "dq": 4e-3, "dtheta": 4e-3, "tau_t": 0.05}
JOINTS = ("hip", "knee")
ANGLES = ("q", "theta", "q_ref", "theta_ref")
VELOCITIES = ("dq", "dtheta", "dtheta_ref")


def reference(joints: tuple[str, ...] = JOINTS, size: float = 0.4, rate: float = 0.7) -> Recording:
    time = np.arange(4000) / 1000
    columns = {}
    for k, joint in enumerate(joints):
        columns["q_ref", joint] = (
            size * np.sin(2 * np.pi * rate * (1 + 0.4 * k) * time) * (1 - np.exp(-4 * time))
        )
        columns["dtheta_ref", joint] = np.gradient(columns["q_ref", joint], time)
    return recording.make(time, columns, "rec")


@cache
def arm(**top: float) -> Robot:
    return make(PLANAR, **top)


@cache
def measured() -> Recording:
    """All channels of a healthy planar arm, 4 s at 500 Hz."""
    return run(arm(), reference())


def run(robot: Robot, told: Recording, *effects: Planned, drive: str = "controller") -> Recording:
    model = FlexibleJointModel(robot, effects)
    return simulate(model, told, drive=drive, sample_rate=500, noise=NOISE, seed=1).measured  # type: ignore[arg-type]


def only(table: Recording, *channels: str) -> Recording:
    return Recording(table.time, {k: v for k, v in table.columns.items() if k[0] in channels}, table.name)


def scaled(
    table: Recording, channels: tuple[str, ...], joints: tuple[str, ...] = JOINTS, factor: float = DEGREES
) -> Recording:
    columns = {k: v * factor if k[0] in channels and k[1] in joints else v for k, v in table.columns.items()}
    return Recording(table.time, columns, table.name)


def refusal(robot: Robot, table: Recording) -> str:
    with pytest.raises(RecordingError) as error:
        check(robot, table)
    text = str(error.value)
    assert text.startswith(f"{table.name}: ") and "\n" not in text
    return text


def found(said: str) -> float:
    """The factor that the message names."""
    (factor,) = re.findall(r"is ([\d.]+) times", said)
    return float(factor)


# --- what is right ----------------------------------------------------------------------------------------
def test_a_healthy_recording_passes() -> None:
    check(arm(), measured())


@pytest.mark.parametrize("name", ["rec_A", "rec_B", "rec_C"])
def test_the_shipped_recordings_pass(name: str) -> None:
    check(load("kr300"), recording.read(robots_folder() / "kr300" / "recordings" / f"{name}.parquet"))


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("spring_stiffness", {"scale": -0.6}),
        ("backlash", {"gap": 0.05}),
        ("motor_coulomb_friction", {"level": 20.0}),
        ("torque_gain", {"gain": -0.4}),
        ("link_encoder_offset", {"offset": 0.2}),
        ("encoder_eccentricity", {"amplitude": 0.05}),
        ("sensor_delay", {"delay": 0.02}),
        ("torque_sensor_gain", {"gain": 0.8}),
        ("end_stop", {"position": 0.1, "stiffness": 5e3}),
        ("payload", {"mass": 5.0, "position": (0.0, 0.0, -0.3)}),
    ],
)
def test_a_fault_is_no_wrong_unit(effect: str, values: dict[str, float]) -> None:
    """Far beyond what real machines show, and still no factor of 57."""
    check(arm(), run(arm(), reference(), Planned.of(effect, "knee", values)))


def test_a_link_pressed_against_a_stop_is_no_wrong_unit() -> None:
    """The stop is 57 times as stiff as the spring, so that theta moves about 57 times as far as q does."""
    robot = make(PENDULUM)
    stop = effect("end_stop", "joint", position=0.6, stiffness=DEGREES * 340.0)
    time = np.arange(4000) / 1000
    press = 8.0 * 0.26 * 2.4 + 25.0 + 10.0 * np.sin(4 * time)
    told = recording.make(time, {("tau_m", "joint"): press, ("q_ref", "joint"): np.full(4000, 0.601)})
    pressed = run(robot, told, stop, drive="torque").between(2.0, 4.0)
    q, theta = pressed.get("q", "joint"), pressed.get("theta", "joint")
    assert np.std(theta) / np.std(q) == pytest.approx(DEGREES + 1, rel=0.15)  # the case is what it claims
    check(robot, pressed)


def test_many_turns_of_a_joint_without_limits_are_no_wrong_unit() -> None:
    robot = make(PENDULUM)
    time = np.arange(4000) / 1000
    told = recording.make(time, {("q_ref", "joint"): 20.0 * time})
    check(robot, run(robot, told))


def test_a_joint_that_stands_still_says_nothing() -> None:
    robot = make(PENDULUM)
    told = recording.make(np.arange(4000) / 1000, {("q_ref", "joint"): np.full(4000, 0.5)})
    check(robot, run(robot, told))


def test_gaps_are_no_wrong_unit() -> None:
    table = measured()
    holes = np.arange(len(table.time)) % 7 == 0
    holes[500:700] = True
    check(arm(), Recording(table.time, {k: np.where(holes, np.nan, v) for k, v in table.columns.items()}))


# --- joints and rates -------------------------------------------------------------------------------------
def test_an_unknown_joint_lists_the_valid_ones() -> None:
    table = measured()
    renamed = {(c, j.replace("knee", "nee")): v for (c, j), v in table.columns.items()}
    wrong = Recording(table.time, renamed, "monday.csv")
    said = refusal(arm(), wrong)
    assert "column q.nee: unknown joint 'nee' (did you mean 'knee'?); valid: hip, knee" in said
    with pytest.raises(RecordingError, match="unknown joint 'nee'"):
        check_joints(arm(), wrong)


def test_passive_and_locked_joints_may_be_recorded() -> None:
    passive = make(PLANAR, {"knee": None})
    locked = make(PLANAR, {"knee": None}, lock=["knee"])
    assert set(all_joints(passive)) == set(all_joints(locked)) == set(JOINTS)
    for robot in (passive, locked):
        check(robot, only(measured(), "q", "theta"))


def test_a_recording_without_positions_is_refused() -> None:
    said = refusal(arm(), only(measured(), "tau_m", "dq", "q_ref"))
    assert "no position of any actuated joint; expected q.<joint> or theta.<joint> of hip, knee" in said


@pytest.mark.parametrize(("factor", "said"), [(25.0, "every 0.05 s is too coarse"), (1e3, "every 2 s")])
def test_a_coarse_clock_is_refused(factor: float, said: str) -> None:
    """25: 20 Hz; 1000: milliseconds for seconds."""
    table = measured()
    text = refusal(arm(), Recording(factor * table.time, table.columns, "rec"))
    assert said in text and "50 Hz or faster, and give time in seconds" in text


def test_a_clock_in_the_wrong_unit_is_refused() -> None:
    table = measured()
    assert "too fine; give time in seconds" in refusal(arm(), Recording(1e-3 * table.time, table.columns))


# --- units ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("channel", [*ANGLES, *VELOCITIES])
@pytest.mark.parametrize("factor", [DEGREES, 1 / DEGREES], ids=["degrees", "twice"])
def test_one_column_in_degrees_is_named(channel: str, joint: str, factor: float) -> None:
    said = refusal(arm(), scaled(measured(), (channel,), (joint,), factor))
    assert f"{channel}.{joint}" in said and "radians" in said
    # columns differ by deflection and tracking error, too
    assert found(said) == pytest.approx(DEGREES, rel=0.3)


GROUPS = {
    "link": ("q", "dq"),
    "encoders": ("q", "theta"),
    "measured": ("q", "dq", "theta", "dtheta"),
    "told": ("q_ref", "theta_ref", "dtheta_ref"),
    "angles": ANGLES,
    "velocities": VELOCITIES,
    "all": (*ANGLES, *VELOCITIES),
}


@pytest.mark.parametrize("joints", [JOINTS, ("hip",), ("knee",)], ids="+".join)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("factor", [DEGREES, 1 / DEGREES], ids=["degrees", "twice"])
def test_columns_in_degrees_are_found(group: str, joints: tuple[str, ...], factor: float) -> None:
    said = refusal(arm(), scaled(measured(), GROUPS[group], joints, factor))
    assert any(f"{channel}.{joints[0]}" in said for channel in GROUPS[group])
    assert "57.3" in said or found(said) == pytest.approx(DEGREES, rel=0.3)
    assert "radians" in said


@pytest.mark.parametrize(
    "channels",
    [("q", "theta", "tau_m"), ("theta", "dtheta", "tau_m"), ("q", "dq", "tau_m"), ("q", "theta", "tau_t")],
    ids="+".join,
)
def test_all_angles_in_degrees_are_found_with_few_sensors(channels: tuple[str, ...]) -> None:
    """These joints have no limits: the torques, the spring or the control law must tell."""
    table = only(measured(), *channels)
    check(arm(), table)
    refusal(arm(), scaled(table, (*ANGLES, *VELOCITIES)))


def test_all_angles_in_degrees_are_found_by_the_limits() -> None:
    """With nothing but a motor encoder, which these limits allow 57 times too little."""
    robot, name = load("kr300"), "joint_2"
    table = recording.read(robots_folder() / "kr300" / "recordings" / "rec_A.parquet")
    table = Recording(table.time, {("theta", name): table.get("theta", name)}, "rec_A")
    check(robot, table)
    said = refusal(robot, scaled(table, ("theta",), (name,)))
    assert "theta.joint_2 goes from" in said and "where the URDF allows -0.8727 to 1.484 rad" in said


@pytest.mark.parametrize("joints", [[f"joint_{k}" for k in range(1, 7)], ["joint_3"]], ids=len)
def test_the_shipped_recording_in_degrees_is_refused(joints: list[str]) -> None:
    table = recording.read(robots_folder() / "kr300" / "recordings" / "rec_A.parquet")
    refusal(load("kr300"), scaled(table, (*ANGLES, *VELOCITIES), tuple(joints)))


def test_a_small_motion_beyond_a_limit_is_no_motion_in_degrees() -> None:
    """Divided by 57.3 it would lie near zero, within most limits: that it fits then says nothing. Another
    zero of the encoder explains it as well."""
    robot, name = load("kr300"), "joint_2"
    table = recording.read(robots_folder() / "kr300" / "recordings" / "rec_A.parquet")
    theta = table.get("theta", name)
    beyond = 2.2 + 0.2 * (theta - np.mean(theta)) / np.ptp(theta)  # the URDF allows 1.484 rad
    check(robot, Recording(table.time, {("theta", name): beyond}, "rec_A"))
