"""What the encoders of rigid joints do, found by its trace in the torques."""

from __future__ import annotations

from functools import cache

import pytest
from planting import Planted, plant, robot_file
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.scan import Scanner, Scored
from flexjoint.recording.table import make as make_recording
from flexjoint.robot.robot import load

NAME, JOINT = "dirty_drawn_12_of6_rigid_5", "joint_0"  # of six rigid joints, it turns by 1.6 rad
RIPPLE = {"amplitude": 1.5e-3, "cycles": 24.0, "phase": 0.3, "channel": "theta"}


@cache
def first(channel: str) -> Scored:
    """The candidate that explains most of a recording of encoders, of this channel, and currents."""
    robot = load(robot_file(NAME))
    sensors = SensorSet(channels=("theta", "tau_motor"))
    made = as_recording(
        plant(
            robot_file(NAME), [Planted("encoder_ripple", JOINT, RIPPLE)], "rich", 16.0, 5, sensors, rate=250.0
        )
    )
    columns = {(channel if c == "theta" else c, joint): x for (c, joint), x in made.columns.items()}
    problem = Problem(balances_of(robot, make_recording(made.time, columns)))
    bare = at_own_level(fit(problem, []))
    return Scanner(enumerate_candidates(problem, frozenset())).scan(bare)[0]


@thorough
@pytest.mark.parametrize("channel", ["q", "theta"])
def test_a_ripple_of_an_encoder_is_found_with_its_cycles(channel: str) -> None:
    found = first(channel)
    assert found.candidate.key == ("encoder_ripple", JOINT)
    assert found.planned().values["channel"] == channel
    assert found.planned().values["cycles"] == pytest.approx(RIPPLE["cycles"], abs=0.5)


def test_the_name_of_the_angle_changes_nothing_of_what_is_found() -> None:
    assert first("q").removes == first("theta").removes
