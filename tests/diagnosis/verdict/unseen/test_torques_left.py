"""What is left on data that a fit did not see, and belief in a name on a machine that leaves something."""

from __future__ import annotations

from dataclasses import replace

import pytest

from flexjoint.diagnosis.result import Gain, Remaining, Removed
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.reliability import by_simulation, on_background
from flexjoint.diagnosis.verdict.unseen.torques import standing_out, unfinished
from flexjoint.effects import effect

LIMITS = USUAL.verdict
JOINT = Remaining("slide", torque=54.0, before=37.0, after=2.0, noise=0.03, structured=1.4, against="dtheta")
CAUSE = Removed("slide", "motor", without=21.0, left=2.0, structured=1.4, against="dtheta")


def believed(cause: Removed, joint: Remaining = JOINT, beside: int = 1) -> float:
    return on_background(cause, (joint,), LIMITS, beside)


def test_ordinary_friction_of_a_real_drive_is_believed() -> None:
    """The numbers of a ball screw drive, where two frictions take the error from 37 to 2 N."""
    assert believed(CAUSE) > 0.8


def test_a_cause_that_leaves_a_shape_as_large_as_itself_is_not() -> None:
    stand_in = replace(CAUSE, left=20.0, structured=19.0)

    assert believed(stand_in) < 0.1


def test_a_cause_as_small_as_many_small_errors_is_not() -> None:
    small = replace(CAUSE, without=2.2)

    assert believed(small) < 0.5


def test_a_small_cause_is_believed_where_next_to_nothing_is_left_but_not_as_a_large_one() -> None:
    """A small unnamed error lends its torque to some name as well, so that little is left."""
    small = replace(CAUSE, without=2.2, left=0.05, structured=0.0)

    assert 0.6 < believed(small, replace(JOINT, after=0.05)) < 0.95


def test_what_leaves_nothing_at_all_is_believed_and_a_joint_without_torque_tells_nothing() -> None:
    clean = replace(CAUSE, left=0.0, structured=0.0)

    assert believed(clean, replace(JOINT, after=0.0)) > 0.99
    assert believed(clean, replace(JOINT, torque=0.0)) == 0.0


def test_where_far_more_is_left_than_a_background_another_cause_may_stand_behind_a_name() -> None:
    assert believed(CAUSE, replace(JOINT, after=15.0)) < 0.5
    # the same as noise of the sensors tells nothing against it
    assert believed(CAUSE, replace(JOINT, after=15.0, noise=15.0)) > 0.8


def test_noise_of_the_sensors_is_no_background() -> None:
    """A servo with a 12-bit encoder: a friction of 6 % of the torque beside 4.4 % that is noise."""
    cause = Removed("slide", "motor", without=4.1, left=2.4, structured=0.0, against="t")
    servo = replace(JOINT, before=4.1, after=2.4, structured=0.0)

    assert believed(cause, replace(servo, noise=2.4)) > 0.8
    assert believed(cause, replace(servo, noise=0.1)) < 0.5


def test_three_convincing_causes_on_a_joint_are_believed_less() -> None:
    assert believed(CAUSE, beside=2) == believed(CAUSE)
    assert believed(CAUSE, beside=3) < believed(CAUSE)


def test_ordinary_friction_is_believed_whatever_else_is_left_or_acts() -> None:
    """As far as it stands out of the background and leaves no shape."""
    left = replace(JOINT, after=15.0)
    three = on_background(CAUSE, (left,), LIMITS, beside=3, friction=21.0)

    assert three == on_background(CAUSE, (JOINT,), LIMITS, friction=21.0) > 0.8
    assert on_background(replace(CAUSE, without=2.2), (left,), LIMITS, friction=0.9) < 0.5
    stand_in = replace(CAUSE, left=20.0, structured=19.0)
    assert on_background(stand_in, (left,), LIMITS, friction=6.4) < 0.1
    # beside the other friction of its joint, which removes far more, the shape is small
    assert on_background(stand_in, (left,), LIMITS, friction=100.0) > 0.5


def test_a_cause_of_no_joint_that_is_measured_is_not_believed_by_its_size() -> None:
    assert believed(replace(CAUSE, joint="other")) == 0.0


@pytest.mark.parametrize(
    ("left", "open_ones"),
    [
        (JOINT, 0),  # 4 % of the torque
        (replace(JOINT, after=10.0, structured=2.0), 0),  # more, without a shape
        (replace(JOINT, after=20.0, structured=19.0), 1),  # a law without a name
        (replace(JOINT, after=30.0, structured=0.0), 1),  # most of what there was
    ],
)
def test_a_joint_is_finished_when_what_is_left_is_background(left: Remaining, open_ones: int) -> None:
    assert len(unfinished((left,), LIMITS)) == open_ones


@pytest.mark.parametrize(
    ("others", "open_ones"),
    [
        ((0.16, 0.12), 0),  # a machine that leaves as much on its other joints
        ((0.02, 0.05), 1),  # this one alone
        ((), 1),  # a single joint says nothing of a background
        ((0.9, 0.9), 0),
    ],
)
def test_a_joint_that_leaves_no_more_than_the_others_does_not_stand_out(
    others: tuple[float, ...], open_ones: int
) -> None:
    left = replace(JOINT, after=0.15 * JOINT.torque, before=0.15 * JOINT.torque, structured=0.0)
    finished = [
        replace(JOINT, joint=f"other {k}", after=share * JOINT.torque, before=40.0 * JOINT.torque)
        for k, share in enumerate(others)
    ]

    found = standing_out((left, *finished), LIMITS)

    assert [one.joint for one in found] == ["slide"] * open_ones


def test_a_fifth_of_the_torque_is_no_background_whatever_is_left_of_others() -> None:
    left = replace(JOINT, after=0.3 * JOINT.torque, before=0.3 * JOINT.torque)
    other = replace(left, joint="other", before=40.0 * JOINT.torque)

    assert [one.joint for one in standing_out((left, other), LIMITS)] == ["slide"]


def simulated(without: float, with_it: float, joint: str | None = "elbow", beside: int = 1) -> float:
    """Of a cause of a joint that the nominal model simulates with an error of 1.4."""
    gains = [
        Gain(True, 0.5, {"nrmse": {"phi.elbow": 1.4}}, {"nrmse": {"phi.elbow": left}}, {})
        for left in (with_it, without)
    ]
    named = effect("backlash", joint, gap=1e-3) if joint else effect("base_tilt", roll=0.01)
    return by_simulation(*gains, named, LIMITS, beside)


def test_a_cause_with_which_its_joint_is_simulated_far_better_is_believed() -> None:
    assert simulated(1.4, 0.14) > 0.5  # ten times
    assert simulated(1.4, 0.31) < 0.3  # as a stand-in that explains 95 % of the variance
    assert simulated(1.4, 1.4) < 0.05


def test_a_cause_beside_which_others_gain_all_is_not_believed_for_their_gain() -> None:
    """Without this one the simulation is as good to some per cent; or it is worse, and each has its part."""
    assert simulated(0.144, 0.14) == 0.0
    assert simulated(0.17, 0.14) > 0.5
    alone = Gain(True, 0.5, {"nrmse": {}}, {"nrmse": {}}, {})
    assert by_simulation(alone, None, effect("backlash", "elbow", gap=1e-3), LIMITS) == 0.0


def test_a_simulation_says_nothing_of_another_joint_and_less_of_a_third_cause() -> None:
    assert simulated(1.4, 0.14, "wrist") == 0.0
    assert simulated(1.4, 0.14, None) == 0.0
    assert simulated(1.4, 0.14, beside=3) < 0.5 < simulated(1.4, 0.14, beside=2)
