"""Several recordings beside each other: those of one machine agree, one of another machine is odd."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planting import Planted, plant
from support.diagnose_cases import ROBOTS, SENSORS, as_recording, findings_of, nominal

from flexjoint import report
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.followup.agreement.agreement import agreement
from flexjoint.diagnosis.followup.agreement.spread import Series, repeated
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording

FRICTION, GAP = 1.0, 0.01


@cache
def recorded(seed: int, friction: float = FRICTION, gap: float = GAP) -> Recording:
    planted = [Planted("motor_coulomb_friction", "swing", {"level": friction})] if friction else []
    planted += [Planted("backlash", "swing", {"gap": gap})] if gap else []
    one = plant(ROBOTS / "lever.yaml", planted, "rich", 8.0, seed, SENSORS["full"])
    return as_recording(one, f"lever-{seed}")


def diagnosed(first: Recording) -> Diagnosis:
    """What a diagnosis says that found both causes, without its search."""
    problem = Problem(balances_of(nominal("lever"), first))
    effects = [
        Planned.of("motor_coulomb_friction", "swing", {"level": FRICTION}),
        Planned.of("backlash", "swing", {"gap": GAP}),
    ]
    return Diagnosis("causes", "fitted", findings_of(fit(problem, effects)), robot="lever")


def together(recordings: Sequence[Recording]) -> Diagnosis:
    return agreement(nominal("lever"), recordings, diagnosed(recordings[0]))


@cache
def alike() -> Diagnosis:
    return together([recorded(41), recorded(42), recorded(43)])


# ------------------------------------------------------------------ recordings
def test_recordings_of_one_machine_agree_and_foretell_each_other() -> None:
    found = alike().agreement
    assert found is not None and len(found.recordings) == 3
    assert [r.parameter for r in found.numbers] == ["level", "gap"]
    assert not any(r.disagree or r.odd for r in found.numbers), found.numbers
    for number, true in zip(found.numbers, (FRICTION, GAP), strict=True):
        # three standard errors, and what the filter does at a kink
        assert abs(number.mean - true) < 3.0 * number.std + 1e-3 * true
        assert number.freedom == 2 and number.std < min(number.stds)
    assert all(shown.there == (0, 1, 2) for shown in found.causes)
    for one in found.left_out:
        assert one.gain is not None and one.gain.held_out
        before, after = (one.gain.before["nrmse"]["phi.swing"], one.gain.after["nrmse"]["phi.swing"])
        assert after < 0.1 * before  # nearly all of the error is the gap's


def test_the_recording_of_a_worn_machine_is_odd() -> None:
    found = together([recorded(41), recorded(42), recorded(43, gap=0.012)]).agreement
    assert found is not None
    level, gap = found.numbers
    assert gap.disagree and gap.odd == (2,) and not level.odd
    assert gap.chi_square > 9.0 * gap.freedom


def test_a_cause_that_only_some_show_is_said() -> None:
    found = together([recorded(41), recorded(42, friction=0.0)])
    assert found.agreement is not None
    friction, gap = found.agreement.causes
    assert friction.there == (0,) and friction.absent == (1,)
    assert gap.there == (0, 1)
    assert "shown by [1], absent in [2]" in str(found) and "Shown by each recording: backlash" in str(found)


def test_one_recording_is_handed_back_and_a_healthy_robot_has_no_numbers() -> None:
    single = diagnosed(recorded(41))
    assert agreement(nominal("lever"), [recorded(41)], single) is single
    healthy = Diagnosis("healthy", "nothing", robot="lever")
    found = agreement(nominal("lever"), [recorded(44, 0.0, 0.0), recorded(45, 0.0, 0.0)], healthy).agreement
    assert found is not None and not found.numbers and not found.causes
    assert all(one.gain is not None and one.gain.before == one.gain.after for one in found.left_out)


def test_the_json_the_summary_and_the_page_have_it() -> None:
    found = alike()
    content = to_json(found)["recordings"]
    assert content["names"] == ["lever-41", "lever-42", "lever-43"]
    assert len(content["numbers"][0]["values"]) == len(content["numbers"][0]["stds"]) == 3
    assert content["left_out"][0]["comparison"]["held_out"]
    assert to_json(replace(found, agreement=None))["recordings"] is None
    assert "3 recordings beside each other" in str(found) and "agree (" in str(found)
    page = report.render(found, nominal("lever"), recorded(41))
    assert "3 recordings beside each other" in page and "lever-42" in page
    assert page.count('alt="backlash at swing: gap by recording') == 1


# ------------------------------------------------------------------ spread
def series(values: Sequence[float], stds: Sequence[float], wraps: bool = False) -> Series:
    return Series("payload", "elbow", "mass", "kg", np.array(values), np.array(stds), wraps)


def test_spread_is_chi_square_about_the_weighted_mean() -> None:
    (one,) = repeated([series([1.0, 1.2], [0.1, 0.1])], 0.01)
    assert one.mean == pytest.approx(1.1) and one.chi_square == pytest.approx(2.0) and one.freedom == 1
    assert one.chance == pytest.approx(math.erfc(1.0))  # of one degree of freedom
    assert not one.disagree


@pytest.mark.parametrize(
    ("values", "odd"),
    [
        ([1.0, 1.02, 0.98, 1.9], (3,)),
        ([1.0, 1.02, 1.9, 1.92, 1.0], (2, 3)),
        ([1.0, 1.9], ()),  # of two none is the odd one
        ([1.0, 2.0, 3.0], ()),  # nor of three that all differ
    ],
)
def test_who_is_odd(values: list[float], odd: tuple[int, ...]) -> None:
    (one,) = repeated([series(values, [0.05] * len(values))], 0.01)
    assert one.disagree and one.odd == odd


def test_what_a_recording_does_not_show_counts_not() -> None:
    (one,) = repeated([series([1.0, 50.0, 1.02], [0.1, math.inf, 0.1])], 0.01)
    assert one.freedom == 1 and not one.disagree and one.mean == pytest.approx(1.01)


def test_angles_are_compared_around_the_circle() -> None:
    (one,) = repeated([series([3.1, -3.1], [0.1, 0.11], wraps=True)], 0.01)
    assert not one.disagree and abs(one.mean) == pytest.approx(math.pi, abs=0.05)


def test_recordings_that_agree_rarely_count_as_spread() -> None:
    """100 sets of 10 numbers of 4 recordings, drawn with their standard errors: at a chance of 1 % a set, one
    alarms, and more than 4 would have a probability of 0.3 %."""
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(100):
        found = repeated([series(rng.normal(1.0, 0.1, 4).tolist(), [0.1] * 4) for _ in range(10)], 0.01)
        alarms += any(r.disagree for r in found)
    assert alarms <= 4
