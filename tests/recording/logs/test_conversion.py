"""From a log to a recording: units, sides, signs, joints and clocks, each stated, seen or asked for."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import fake_diagnosis
from support.logs import JOINTS, RATE, assert_is, motion
from support.robots.robot_files import file

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.text import plain
from flexjoint.recording.logs import mapping
from flexjoint.recording.logs.conversion import Imported, converted
from flexjoint.recording.logs.log import Documented, Log, Signal, of_arrays
from flexjoint.recording.logs.units import UNITS_OF
from flexjoint.recording.table import UNITS
from flexjoint.robot import robot

DEGREES = 180.0 / math.pi
M = motion()


def log(joints: tuple[str, ...] = JOINTS, **arrays: np.ndarray) -> Log:
    """A log as a file of arrays holds it."""
    return of_arrays("monday.npz", "NumPy archive", {"time": M.time, **arrays}, joints)


def imported(source: Log, robot: robot.Robot | None = None, **keys: Any) -> Imported:
    return converted(source, mapping.parse(keys), robot)


def refused(source: Log, said: str, robot: robot.Robot | None = None, **keys: Any) -> None:
    with pytest.raises(RecordingError, match=said) as error:
        imported(source, robot, **keys)
    assert "\n" not in str(error.value)


# --- planted and found again --------------------------------------------------------------------------------
@settings(max_examples=60, deadline=None)
@given(
    unit=st.sampled_from([("rad", 1.0), ("deg", DEGREES), ("rev", 0.5 / math.pi)]),
    gear=st.floats(0.5, 300.0),
    turned=st.booleans(),
    constant=st.floats(0.01, 5.0),
    offset=st.floats(-1.0, 1.0),
)
def test_what_was_done_to_a_log_is_undone(
    unit: tuple[str, float], gear: float, turned: bool, constant: float, offset: float
) -> None:
    """Angles of the rotor in any unit, turned and shifted; torques as currents in mA."""
    name, factor = unit
    short = SHORT
    sign = -1.0 if turned else 1.0
    rotor = sign * (short.q - offset) * gear * factor
    speed = sign * short.dq * gear * factor
    current = sign * short.tau / (constant * gear) * 1e3
    got = imported(
        of_arrays("a.npz", "x", {"time": short.time, "pos": rotor, "vel": speed, "amps": current}, JOINTS),
        gear_ratio=gear,
        torque_constant=constant,
        channels={
            "theta": {"from": "pos", "unit": name, "side": "motor", "sign": sign, "offset": offset},
            "dtheta": {"from": "vel", "unit": f"{name}/s", "side": "motor", "sign": sign},
            "tau_motor": {"from": "amps", "unit": "mA", "sign": sign},
        },
    )
    assert_is(got.recording, "theta", short.q)
    assert_is(got.recording, "dtheta", short.dq)
    assert_is(got.recording, "tau_motor", short.tau)
    said = plain(got.account)
    assert "times the gear ratio" not in said and "N m/A (as stated) and the gear ratio" in said


SHORT = motion(0.4)
ARRAYS = {
    "time": SHORT.time,
    "pos": SHORT.q,
    "pos_deg": np.degrees(SHORT.q) * 80.0,
    "amps": SHORT.tau,
    "one": SHORT.q[:, 0],
    "q": np.where(SHORT.q > 0.4, np.nan, SHORT.q),
    "dq": 1e300 * SHORT.dq,
    "bad": np.full_like(SHORT.q, np.inf),
    "still": np.zeros_like(SHORT.q),
}
NUMBERS = st.none() | st.floats(allow_nan=False) | st.lists(st.floats(-1e3, 1e3), max_size=3).map(tuple)
NAMES = st.sampled_from(["shoulder", "elbow", "hip", ""])
ENTRY = st.fixed_dictionaries(
    {
        "from": st.sampled_from([*ARRAYS, "none", "pos[1]", "pos[9]"])
        | st.lists(st.sampled_from(["one", "pos[0]", "pos"]))
    },
    optional={
        "unit": st.sampled_from([*UNITS_OF["angle"], *UNITS_OF["velocity"], *UNITS_OF["torque"]]),
        "side": st.sampled_from(["motor", "link"]),
        "gear_ratio": NUMBERS,
        "torque_constant": NUMBERS,
        "offset": NUMBERS,
        "sign": st.sampled_from([1, -1, [1, -1]]),
        "joints": st.lists(NAMES, max_size=3),
    },
)
KEYS = st.fixed_dictionaries(
    {"channels": st.dictionaries(st.sampled_from(list(UNITS)), ENTRY, max_size=4)},
    optional={
        "time": st.sampled_from(["time", "one", "pos", "still"]),
        "time_unit": st.sampled_from(["s", "ns"]),
        "rate": st.floats(0.1, 1e6),
        "joints": st.lists(NAMES, min_size=1, max_size=3),
        "angles": st.sampled_from(["rad", "deg", "rev"]),
        "gear_ratio": NUMBERS,
        "torque_constant": NUMBERS,
        "encoder": st.sampled_from(["motor", "link"]),
    },
)


@settings(max_examples=200, deadline=None)
@given(KEYS)
def test_whatever_a_mapping_says_the_log_is_a_recording_or_refused(keys: dict[str, Any]) -> None:
    source = of_arrays("a.npz", "NumPy archive", ARRAYS, JOINTS)
    try:
        got = imported(source, **keys)
    except FlexJointError as error:
        assert "\n" not in str(error)
    else:
        assert np.all(np.diff(got.recording.time) > 0.0) and "clock: " in str(got)
        assert not any(np.any(np.isinf(values)) for values in got.recording.columns.values())


def test_work_does_not_grow_with_a_pause() -> None:
    """Spans of 50 ms through it would be 2e10, 160 GB."""
    time = M.time.copy()
    time[len(time) // 2 :] += 1e9
    read = imported(log(time=time, q=M.q, dq=M.dq)).recording
    assert read.duration > 1e9 and read.time.size == time.size


def test_numbers_by_joint_and_in_order() -> None:
    gears = np.array([100.0, 50.0])
    source = log(pos=M.q * gears)
    for gear in ([100.0, 50.0], {"elbow": 50.0, "shoulder": 100.0}):
        entry = {"from": "pos", "unit": "rad", "side": "motor", "gear_ratio": gear}
        assert_is(imported(source, channels={"theta": entry}).recording, "theta", M.q)
    refused(
        source,
        r"gear_ratio: expected 2 numbers, one a joint \(shoulder, elbow\), got 3",
        channels={"theta": {"from": "pos", "unit": "rad", "side": "motor", "gear_ratio": [1, 2, 3]}},
    )
    refused(
        source,
        "gear_ratio has no number for elbow",
        channels={"theta": {"from": "pos", "unit": "rad", "side": "motor", "gear_ratio": {"shoulder": 3}}},
    )


# --- degrees or radians -------------------------------------------------------------------------------------
def test_angles_within_one_turn_are_radians_and_the_account_says_why() -> None:
    got = imported(log(q=M.q))
    assert_is(got.recording, "q", M.q)
    assert "no joint beyond 0.9, so within one turn: --degrees if not" in plain(got.account)


def test_larger_angles_are_asked_for_and_an_option_answers() -> None:
    source = log(q=M.q * DEGREES, dq=M.dq * DEGREES)
    refused(source, "q reaches 51.57: degrees, or radians of more than a turn. Give --degrees or --radians")
    got = imported(source, angles="deg")
    assert_is(got.recording, "q", M.q)
    assert_is(got.recording, "dq", M.dq)
    assert_is(imported(log(q=M.q * 20.0), angles="rad").recording, "q", 20.0 * M.q)


def test_a_name_may_state_the_unit() -> None:
    got = imported(log(pos_deg=M.q * DEGREES), channels={"q": "pos_deg"})
    assert_is(got.recording, "q", M.q)
    assert "deg: its name says so" in plain(got.account)


def test_a_documented_unit_that_the_samples_contradict_is_asked_for() -> None:
    known = {"actual_q": Documented("q", "rad", "the guide says so")}
    source = of_arrays("a.csv", "RTDE", {"time": M.time, "actual_q": M.q * DEGREES}, JOINTS, known)
    refused(source, r"q \(actual_q\) reaches 51.57: degrees")
    assert_is(imported(source, angles="deg").recording, "q", M.q)


def test_velocities_have_the_unit_of_their_positions_unless_the_samples_say_otherwise() -> None:
    got = imported(log(q=M.q, dq=M.dq))
    assert "rad/s: as the positions" in plain(got.account)
    refused(log(q=M.q, dq=M.dq * DEGREES), "dq.shoulder is 57.3 times the derivative of q.shoulder")


# --- sides of the gear --------------------------------------------------------------------------------------
def test_turns_of_a_rotor_are_seen_by_the_slope_and_asked_for() -> None:
    source = log(q=M.q, theta=M.q * 100.0)
    said = (
        "theta.shoulder moves 100 times as far as q.shoulder: turns of the rotor before the gear.* --gear 100"
    )
    refused(source, said, angles="rad")
    got = imported(source, angles="rad", gear_ratio=100.0)
    assert_is(got.recording, "theta", M.q)
    assert "divided by the gear ratio 100 (as stated)" in plain(got.account)
    told = plain(imported(log(q=M.q), gear_ratio=3.0).account)
    assert "gear_ratio is stated, and no channel needs it" in told


def test_a_motor_that_turns_the_other_way_is_named() -> None:
    refused(log(q=M.q, theta=-M.q), "theta.shoulder turns against q.shoulder .slope -1.: state sign: -1")


def test_a_motor_alone_that_turns_far_is_asked_for() -> None:
    source = log(theta=M.q * 100.0)
    refused(source, "theta reaches 90: degrees, or radians.* or --gear RATIO if these are turns of the rotor")
    refused(source, "theta reaches 90 rad: turns of the rotor before the gear. Give --gear", angles="rad")
    assert_is(imported(source, angles="rad", gear_ratio=100.0).recording, "theta", M.q)
    refused(log(theta=M.q), "state side: motor .before the gear. or side: link", gear_ratio=2.0)


def test_a_motor_that_moves_with_its_link_is_seen_from_the_link() -> None:
    got = imported(log(q=M.q, theta=M.q + 1e-3))
    assert_is(got.recording, "theta", M.q + 1e-3)
    assert "moves 1 to 1 times as far as the link" in plain(got.account)


def test_a_link_that_is_stated_of_the_motor_is_refused() -> None:
    refused(
        log(pos=M.q),
        "q is of the link, but side: motor is stated; call the channel theta",
        channels={"q": {"from": "pos", "unit": "rad", "side": "motor", "gear_ratio": 2}},
    )


# --- currents -----------------------------------------------------------------------------------------------
def test_currents_become_torques_by_stated_constants_alone() -> None:
    source = log(q=M.q, amps=M.tau / (0.2 * 50.0))
    channels = {"q": "q", "tau_motor": {"from": "amps", "unit": "A"}}
    refused(source, r"tau_motor \(amps\) is a current: give --torque-constant", channels=channels)
    refused(source, "holds torques from currents: give --gear", channels=channels, torque_constant=0.2)
    got = imported(source, channels=channels, torque_constant=0.2, gear_ratio=50.0)
    assert_is(got.recording, "tau_motor", M.tau)
    as_current = imported(source, channels={"q": "q", "current": "amps"})
    assert_is(as_current.recording, "current", M.tau / 10.0)


def test_the_robot_file_may_give_the_constants(tmp_path: Path) -> None:
    rigid = {"stiffness": math.inf, "motor_inertia": 0.1, "gear_ratio": 50, "torque_constant": 0.2}
    path = file(tmp_path, joints={name: dict(rigid) for name in JOINTS}, lock=["wrist"])
    source = log((), q=M.q, amps=M.tau / 10.0)
    got = imported(source, robot.load(path), channels={"q": "q", "tau_motor": {"from": "amps", "unit": "A"}})
    assert_is(got.recording, "tau_motor", M.tau)
    said = plain(got.account)
    assert (
        "0.2 N m/A (of the robot file)" in said and "in the order of arm2: the log does not name them" in said
    )


# --- joints -------------------------------------------------------------------------------------------------
def test_joints_that_nobody_names_are_asked_for() -> None:
    refused(log((), q=M.q), "q has 2 columns and the log does not say of which joints; give --joints")
    assert_is(imported(log((), q=M.q), joints=list(JOINTS)).recording, "q", M.q)
    refused(log((), q=M.q), "q has 2 columns, but 3 joints are named: a, b, c", joints=["a", "b", "c"])


def test_joints_of_the_log_may_be_renamed_and_others_left_out(tmp_path: Path) -> None:
    signal = Signal(np.hstack([M.q, M.q[:, :1]]), (), ("j1", "j2", "finger"), M.time)
    known = {"pos": Documented("q", "rad", "documented")}
    source = Log("x.mcap", "MCAP", {"pos": signal}, known)
    arm = fake_diagnosis.arm(tmp_path)
    got = imported(source, arm, rename={"j1": "shoulder", "j2": "elbow"}, encoder="link")
    assert got.recording.joints == JOINTS
    assert "without finger, which the robot does not have" in plain(got.account)


def test_one_list_of_columns_a_joint_is_a_signal() -> None:
    source = log((), a=M.q[:, 0], b=M.q[:, 1])
    got = imported(source, joints=list(JOINTS), channels={"q": ["a", "b"]})
    assert_is(got.recording, "q", M.q)
    refused(source, "unknown signal 'c'; valid: a, b, time", joints=list(JOINTS), channels={"q": ["a", "c"]})


def test_some_columns_of_a_signal_are_numbered() -> None:
    source = log((), pos=np.hstack([M.q, 0.0 * M.q]), pos_deg=np.degrees(M.q))
    for name in ("pos", "pos_deg"):
        channels = {"q": [f"{name}[1]", f"{name}[0]"]}
        assert_is(imported(source, joints=["elbow", "shoulder"], channels=channels).recording, "q", M.q)
    said = r"pos\[4\]: the signal has 4 columns, from \[0\] on"
    refused(source, said, joints=["a", "b"], channels={"q": ["pos[1]", "pos[4]"]})


def test_two_signals_of_one_channel_and_joint_are_asked_for() -> None:
    known = {name: Documented("q", "rad", "documented") for name in ("/a.position", "/b.position")}
    signals = {name: Signal(M.q, (), JOINTS, M.time) for name in known}
    refused(
        Log("x.mcap", "MCAP", signals, known), "q.shoulder is in /a.position and in /b.position; name one"
    )


def test_which_encoder_is_asked_for_where_it_matters(tmp_path: Path) -> None:
    source = Log(
        "x.mcap",
        "MCAP",
        {"pos": Signal(M.q, (), JOINTS, M.time)},
        {"pos": Documented("q", "rad", "documented")},
    )
    said = "MCAP does not say on which side of the springs the encoder is; give --encoder motor"
    refused(source, said, fake_diagnosis.arm(tmp_path))
    got = imported(source, fake_diagnosis.arm(tmp_path), encoder="motor")
    assert_is(got.recording, "theta", M.q)
    assert_is(imported(source).recording, "q", M.q)


# --- clocks -------------------------------------------------------------------------------------------------
def test_a_clock_is_found_stated_or_asked_for() -> None:
    bare = of_arrays("a.npz", "NumPy archive", {"q": M.q, "ticks": 1e3 * M.time}, JOINTS)
    refused(bare, "has no signal that is called time, t or timestamp: name its clock")
    by_name = imported(bare, time="ticks", time_unit="ms", channels={"q": "q"})
    by_rate = imported(bare, rate=RATE, channels={"q": "q"})
    for got in (by_name, by_rate):
        assert got.recording.time == pytest.approx(M.time, abs=1e-12)
    refused(bare, "time: q has 2 columns, expected one", time="q", channels={"q": "q"})


def test_nanoseconds_of_1970_are_exact() -> None:
    stamps = 1_700_000_000_000_000_000 + np.round(M.time * 1e9).astype(np.int64)
    signal = Signal(M.q, (), JOINTS, stamps)
    source = Log("x", "MCAP", {"p": signal}, {"p": Documented("q", "rad", "")}, time_unit="ns")
    assert imported(source).recording.time == pytest.approx(M.time, abs=1e-12)


def test_a_signal_with_another_clock_is_interpolated_and_its_gaps_stay_empty() -> None:
    other = np.arange(0.0, 2.0, 0.01) + 0.0007
    slow = np.stack([np.sin(other), np.cos(other)], axis=1)
    keep = (other < 0.5) | (other > 1.0)
    source = Log(
        "x",
        "MCAP",
        {"p": Signal(M.q, (), JOINTS, M.time), "e": Signal(slow[keep], (), JOINTS, other[keep])},
        {"p": Documented("q", "rad", ""), "e": Documented("tau_motor", "N m", "", "link")},
    )
    got = imported(source)
    tau = got.recording.get("tau_motor", "shoulder")
    inside = (M.time > 0.51) & (M.time < 0.99)
    assert np.all(np.isnan(tau[inside]))
    known = np.isfinite(tau)
    assert np.count_nonzero(known) > 0.7 * tau.size
    # linear interpolation of a sine at 10 ms: (0.01)^2 / 8
    assert tau[known] == pytest.approx(np.sin(M.time[known]), abs=2e-5)
    assert "has a clock of its own (100 Hz): interpolated linearly" in plain(got.account)


def test_gaps_slow_clocks_filters_and_missing_signs_are_told() -> None:
    slow = motion(20.0, 30.0)
    told = plain(converted(of_arrays("a.npz", "x", {"time": slow.time, "q": slow.q}, JOINTS)).account)
    assert "slower than 50 Hz: a diagnosis refuses it" in told

    keep = (M.time < 0.8) | (M.time > 1.0)
    arrays = {"time": M.time[keep], "q": M.q[keep], "tau_motor": np.abs(M.tau[keep])}
    told = plain(converted(of_arrays("a.npz", "x", arrays, JOINTS)).account)
    assert "1 gaps, the longest 0.208 s" in told and "keeps one sign" in told

    late = motion(6.0)
    lag = 0.02
    phases = late.time[:, np.newaxis] - lag
    filtered = (
        np.array([0.9, 0.5])
        * np.array([2.1, 5.3])
        * np.cos(np.array([2.1, 5.3]) * phases + np.array([0.0, 1.0]))
    )
    arrays = {"time": late.time, "q": late.q, "dq": filtered}
    told = plain(converted(of_arrays("a.npz", "x", arrays, JOINTS)).account)
    assert "lags the derivative of q.elbow by 2" in told


def test_the_account_names_what_is_not_used() -> None:
    got = imported(log(q=M.q, temperature_of_room=M.q[:, 0]))
    assert "not used: temperature_of_room" in plain(got.account)
    assert "clock: time; 500 samples in 1.996 s, 250 Hz; no gaps" in plain(got.account)


def test_a_log_of_nothing_known_asks_for_a_mapping() -> None:
    refused(
        log(foo=M.q),
        "which signal is which channel. Write a mapping .docs/reference/formats.md. for --mapping",
    )


def test_joints_that_slide_keep_their_metres(tmp_path: Path) -> None:
    (tmp_path / "slide.urdf").write_text(
        '<robot name="s"><link name="b"/><link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1"'
        ' izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="slide" type="prismatic"><parent'
        ' link="b"/><child link="c"/><axis xyz="0 0 1"/><limit lower="-90" upper="90" effort="1" velocity="1"'
        "/></joint></robot>"
    )
    loaded = robot.load(tmp_path / "slide.urdf")
    source = log((), q=60.0 * M.q[:, :1])
    got = imported(source, loaded, angles="deg")
    assert got.recording.get("q", "slide") == pytest.approx(60.0 * M.q[:, 0])


def test_a_known_log_is_not_changed() -> None:
    source = log(q=M.q)
    before = source.signals["q"].values.copy()
    imported(source, angles="deg")
    assert np.array_equal(source.signals["q"].values, before)
