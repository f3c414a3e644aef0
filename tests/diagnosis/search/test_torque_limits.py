"""Limits of a motor's torque: where they are sought, and where they are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from study.cases import make
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates, traces
from flexjoint.effects import catalogue


def test_a_limit_is_sought_where_it_starts_however_little_it_explains() -> None:
    """A limit of two numbers is a line: with one of them scaled by what is left to explain, it would lie
    where nothing meets it, and no search finds back."""
    case = make("beyond", 95).case
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.train())))
    candidate = Candidate(catalogue()["torque_speed_limit"], "tilt")
    lines = [t.values(np.array([0.2])) for t in traces(problem, candidate, (), problem.residual([]))]
    s = problem.signals("tilt")

    assert len(lines) > 3
    for line in lines:
        assert 0.0 < np.mean(np.abs(s.tau_m + line["drop"] * s.dtheta) > line["stall"]) < 0.2


@thorough
def test_a_limit_that_cuts_off_one_peak_is_found() -> None:
    """One swing of the tilt in 11 s met it; what it leaves there looks like a rough spot, too."""
    case = make("beyond", 95).case
    found = diagnose(nominal(case.robot), [as_recording(case.train())])

    assert [(f.effect, f.joint) for f in found.findings] == [("torque_speed_limit", "tilt")]
    for name, planted in case.effects[0].parameters.items():
        assert found.findings[0].parameters[name].value == pytest.approx(planted, rel=0.1)


@pytest.mark.parametrize(("channel", "met"), [("tau_m", False), ("tau_motor", True)])
def test_a_measured_torque_has_met_its_limits(channel: str, met: bool) -> None:
    """A motor's current stays below its limit; what is above is the noise of the sensor, which a lower limit
    would seem to explain."""
    recorded = as_recording(Case("lever", "rich", 3).with_causes())
    torque = recorded.get("tau_m", "swing")
    columns = {key: values for key, values in recorded.columns.items() if key[0] != "tau_m"}
    measured = replace(recorded, columns={**columns, (channel, "swing"): torque})
    sought = {c.effect.name for c in enumerate_candidates(Problem(balances_of(nominal("lever"), measured)))}

    assert ({"torque_saturation", "torque_speed_limit"} & sought == set()) is met
    assert {"torque_gain", "torque_offset", "cogging"} <= sought
