"""The time that work may take."""

from __future__ import annotations

import math
import pickle

import pytest

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import (
    UNLIMITED,
    Budget,
    OutOfTimeError,
    budget_of,
    checkpoint,
    here,
    within,
)


def test_it_is_spent_when_its_seconds_are_over() -> None:
    now = [5.0]
    budget = Budget(10.0, lambda: now[0])
    assert budget.limited and budget.left == 10.0 and not budget.spent
    now[0] = 14.9
    assert budget.left == pytest.approx(0.1) and not budget.spent
    now[0] = 15.0
    assert budget.left == 0.0 and budget.spent


def test_a_part_counts_from_the_same_beginning() -> None:
    now = [5.0]
    budget = Budget(10.0, lambda: now[0])
    now[0] = 9.0
    part = budget.part(0.5)
    assert part.left == pytest.approx(1.0)
    part.check()
    now[0] = 10.0
    with pytest.raises(OutOfTimeError, match="the time allowed was over"):
        part.check()
    budget.check()
    assert UNLIMITED.part(0.1) is UNLIMITED


def test_it_holds_for_all_that_is_called_within_it() -> None:
    now = [0.0]
    outer = Budget(10.0, lambda: now[0])
    with within(outer):
        checkpoint()
        now[0] = 6.0
        with within(outer.part(0.5)), pytest.raises(OutOfTimeError):
            checkpoint()
        assert here() is outer
        checkpoint()
        now[0] = 10.0
        with within(UNLIMITED):  # what must be done in any case
            checkpoint()
        with pytest.raises(OutOfTimeError):
            checkpoint()
    checkpoint()
    assert here() is UNLIMITED


def test_the_error_goes_from_process_to_process() -> None:
    assert str(pickle.loads(pickle.dumps(OutOfTimeError()))) == "the time allowed was over"


def test_without_a_limit_no_clock_is_asked() -> None:
    def clock() -> float:
        raise AssertionError

    assert not Budget(clock=clock).spent and Budget(clock=clock).left == math.inf
    assert not UNLIMITED.limited


@pytest.mark.parametrize(
    ("text", "seconds"), [("60s", 60.0), ("60", 60.0), ("1.5 min", 90.0), ("2h", 7200.0), (" .5h ", 1800.0)]
)
def test_it_is_written_as_a_time(text: str, seconds: float) -> None:
    assert budget_of(text).seconds == seconds


@pytest.mark.parametrize("text", ["", "soon", "-5s", "5 days", "1e3s", "nan", "inf", "0.5s", "60ss", "1_0s"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(FlexJointError, match="budget: expected"):
        budget_of(text)


@pytest.mark.parametrize("seconds", [-1.0, math.nan])
def test_no_time_is_less_than_none(seconds: float) -> None:
    with pytest.raises(FlexJointError, match="budget: expected seconds from 0 on"):
        Budget(seconds)
