"""A timing cause of several joints as one of the robot."""

from __future__ import annotations

from functools import cache

import pytest
from planting import Planted, plant, robot_file
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import standard_errors
from flexjoint.diagnosis.result import Finding, Fitted
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.verdict.verdict import merged
from flexjoint.effects import effect
from flexjoint.robot.robot import load

NAME = "dirty_drawn_12_of6_rigid_5"  # six rigid joints
JOINTS = tuple(f"joint_{k}" for k in range(6))
LAG = 8e-3  # s


@cache
def fitted(*late: str) -> Fit:
    """The lags of two joints of an arm on which the currents of some are late."""
    sensors = SensorSet(channels=("theta", "tau_m"))
    causes = [Planted("current_lag", j, {"time_constant": LAG}) for j in late]
    recorded = plant(robot_file(NAME), causes, "rich", 12.0, 7, sensors, rate=250.0)
    problem = Problem(balances_of(load(robot_file(NAME)), as_recording(recorded)))
    return at_own_level(fit(problem, [effect("current_lag", j, time_constant=5e-3) for j in JOINTS[1:3]]))


def findings(best: Fit) -> tuple[Finding, ...]:
    """Each with a probability of 0.6."""
    found = [
        Finding(
            e.effect.name,
            e.joint,
            0.6,
            {"time_constant": Fitted(float(e.values["time_constant"]), std["time_constant"][0], "s")},
            None,
            0.1,
            str(e.effect.kind),
            e,
        )
        for e, std in zip(best.effects, standard_errors(best), strict=True)
    ]
    return merged(found, enumerate_candidates(best.problem), best)


def test_what_all_joints_may_have_is_one_cause_of_the_robot() -> None:
    (found,) = findings(fitted(*JOINTS))

    assert found.joint is None
    assert {e.joint for e in found.members} == set(JOINTS)
    lag = found.parameters["time_constant"]
    assert isinstance(lag, Fitted) and lag.value == pytest.approx(LAG, rel=0.02)  # standard error: 1 %
    assert {e.values["time_constant"] for e in found.members} == {lag.value}
    assert found.probability == pytest.approx(1.0 - 0.4**2)  # both joints tell of it


def test_what_other_joints_do_not_have_stays_with_its_joints() -> None:
    assert [f.joint for f in findings(fitted(*JOINTS[1:3]))] == list(JOINTS[1:3])
