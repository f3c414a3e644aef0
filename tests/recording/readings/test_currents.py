"""Motor currents as motor torques: where they are used, at what factor, and what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.robots.robot_files import JOINT, file
from support.robots.ur5_logs import ELBOW, NAMES, log, ur5

from flexjoint.core.errors import RecordingError
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.recording.readings.currents import with_torques
from flexjoint.recording.table import Recording, make
from flexjoint.robot.robot import Robot, load

GEAR, CONSTANT = 101.0, 0.1
TIME = np.arange(200) / 100.0
AMPERES = 2.0 * np.sin(TIME)


def robot(folder: Path, **elbow: Any) -> Robot:
    known = {**JOINT, "gear_ratio": GEAR, "torque_constant": CONSTANT}
    return load(file(folder, joints={"shoulder": known, "elbow": {**JOINT, **elbow}}))


def table(**channels: np.ndarray) -> Recording:
    """Positions of three joints, currents of shoulder and elbow, and more channels of the elbow."""
    columns = {("q", name): 0.1 * AMPERES for name in ("shoulder", "elbow", "wrist")}
    columns |= {("current", name): AMPERES for name in ("shoulder", "elbow")}
    return make(TIME, columns | {(channel, "elbow"): values for channel, values in channels.items()}, "log")


def test_a_current_is_a_torque_at_the_link(tmp_path: Path) -> None:
    own = with_torques(robot(tmp_path, gear_ratio=50.0, torque_constant=0.2), table())
    assert own.get("tau_motor", "shoulder") == pytest.approx(CONSTANT * GEAR * AMPERES)
    assert own.get("tau_motor", "elbow") == pytest.approx(0.2 * 50.0 * AMPERES)
    assert own.notes == (
        "tau_motor is current times torque_constant times gear_ratio at shoulder (10.1 N m/A),"
        " elbow (10 N m/A)",
    )


@pytest.mark.parametrize("channel", ["tau_m", "tau_motor"])
def test_a_recorded_torque_comes_first(tmp_path: Path, channel: str) -> None:
    own = with_torques(robot(tmp_path), table(**{channel: 3.0 * AMPERES}))
    assert ("tau_motor", "elbow") not in own.columns or channel == "tau_motor"
    assert own.get(channel, "elbow") == pytest.approx(3.0 * AMPERES)


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ({"gear_ratio": 50.0}, r"has no torque_constant \[N m/A at the motor\] for it"),
        ({"torque_constant": 0.1}, r"has no gear_ratio \[turns of the motor per turn of the joint\] for it"),
        ({}, r"has no torque_constant \[N m/A at the motor\] and no gear_ratio \["),
    ],
)
def test_a_missing_constant_is_refused_in_one_line(
    tmp_path: Path, numbers: dict[str, float], says: str
) -> None:
    with pytest.raises(RecordingError, match=says) as error:
        with_torques(robot(tmp_path, **numbers), table())
    text = str(error.value)
    assert "current.elbow" in text and "joints.elbow" in text and "\n" not in text


def test_a_current_that_is_not_needed_needs_no_constants(tmp_path: Path) -> None:
    own = with_torques(robot(tmp_path), table(tau_t=AMPERES))
    assert ("tau_motor", "elbow") not in own.columns


def test_a_recording_without_currents_is_left_as_it_is() -> None:
    assert with_torques(ur5(GEAR, CONSTANT), log()) is log()


def test_a_comparison_is_driven_by_currents() -> None:
    """The same numbers, whether the log has torques or the currents that made them."""
    short = log(friction=0.0).between(0.0, 2.0)
    columns = {
        ("current" if channel == "tau_motor" else channel, joint): values
        / (GEAR * CONSTANT if channel == "tau_motor" else 1.0)
        for (channel, joint), values in short.columns.items()
    }
    of_currents = make(short.time, columns, "currents")
    by_torque = compare(ur5(), short, horizon=0.25, engine="pin")
    by_current = compare(ur5(GEAR, CONSTANT), of_currents, horizon=0.25, engine="pin")
    assert {f"q.{name}" for name in NAMES} == set(by_current.rms)
    # the product of two constants and its inverse, rounded once each
    assert by_current.rms[f"q.{ELBOW}"] == pytest.approx(by_torque.rms[f"q.{ELBOW}"], rel=1e-6)
