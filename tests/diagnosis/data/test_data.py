"""Parts of the check of data: changes one after the other, torques against motion, loads instead, repairs."""

from __future__ import annotations

import numpy as np
import pytest
from support.robots.ur5_logs import ELBOW, LIFT, NAMES, PAN, WRIST_1, log, ur5

from flexjoint.diagnosis.data.change import Change, Source, View
from flexjoint.diagnosis.data.check import check_data
from flexjoint.diagnosis.data.columns import repaired
from flexjoint.diagnosis.data.motion.encoders import differences
from flexjoint.diagnosis.data.torques.follows import Balance
from flexjoint.diagnosis.data.torques.rivals import explained_otherwise, reach
from flexjoint.diagnosis.data.torques.sampled import sampled
from flexjoint.diagnosis.data.travel import slope
from flexjoint.diagnosis.result import Column, DataFinding
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.table import Recording, make
from flexjoint.robot.robot import load as load_robot

LIMITS = USUAL.data


def balance(friction: float = 0.5, **load: object) -> Balance:
    data = sampled(ur5(), log(friction=friction, **load), LIMITS)  # type: ignore[arg-type]
    assert data is not None
    return Balance(data, LIMITS)


def test_changes_are_made_one_after_the_other() -> None:
    """x -> -x, then + 1, then swapped with the pan's: the elbow's right values are the pan's, and the pan's
    are 1 less the elbow's."""
    swap = {PAN: Source(ELBOW), ELBOW: Source(PAN)}
    view = View.of(
        [
            Change("turned", (ELBOW,), {ELBOW: Source(ELBOW, -1.0)}),
            Change("zero", (ELBOW,), {ELBOW: Source(ELBOW, 1.0, 1.0)}),
            Change("swapped", (PAN, ELBOW), swap),
        ]
    )
    assert view.positions[PAN] == Source(ELBOW, -1.0, 1.0)
    assert view.positions[ELBOW] == Source(PAN)


def test_friction_that_resists_is_no_misfit_and_friction_that_drives_is() -> None:
    """With half of the torque as friction, which the model has not: what is left is noise of 2 %, and turned
    it is all of it, as no gain below 0.5 is allowed."""
    given = balance()
    left = np.sqrt(given.misfits(View()))
    assert np.all(left < 0.06)  # the noise, and the corners of friction that the kernel rounds
    turned = Change("", NAMES, torques={("tau_motor", name): Source(name, -1.0) for name in NAMES})
    assert np.all(given.misfits(View.of([turned])) > 1.0)


def test_a_swap_with_a_joint_that_was_not_recorded_explains_nothing() -> None:
    given = balance()
    view = View.of([Change("", (PAN,), torques={("tau_motor", PAN): Source("nobody")})])
    assert given.misfits(view)[given.rows.index(("tau_motor", PAN))] == 1.0


def explained(given: Balance, view: View, final: np.ndarray) -> bool:
    return explained_otherwise(given, view, given.misfits(view), final)


def test_a_load_that_is_there_stands_behind_the_torque_and_a_turned_torque_has_none() -> None:
    laden = balance(mass=5.0, place=(0.1, 0.05, 0.05))
    row = laden.rows.index(("tau_motor", "wrist_2_joint"))
    assert laden.misfits(View())[row] > LIMITS.wrong**2
    assert explained(laden, View(), np.full(6, 0.05**2))
    plain = balance()
    turned = View.of([Change("", (LIFT,), torques={("tau_motor", LIFT): Source(LIFT, -1.0)})])
    assert not explained(plain, turned, plain.misfits(View()))


def sprung(*joints: str) -> Balance:
    """With a spring of the torque's size, set to another angle, at each of the joints."""
    whole = log(friction=0.0)
    columns = dict(whole.columns)
    for joint in joints:
        q, tau = whole.get("q", joint), whole.get("tau_motor", joint)
        columns["tau_motor", joint] = tau + 3.0 * np.sqrt(np.mean(tau**2)) * (q - np.mean(q) + 0.3)
    data = sampled(ur5(), make(whole.time, columns), LIMITS)
    assert data is not None
    return Balance(data, LIMITS)


def test_a_spring_stands_behind_one_torque_and_not_behind_two_that_one_error_sets_right() -> None:
    """One error of the data is a simpler account of two joints than a spring at each; a torque that is only a
    little off may have one of its own."""
    right = balance(friction=0.0).misfits(View())
    for joints, cause in (((ELBOW,), True), ((ELBOW, WRIST_1), False)):
        given = sprung(*joints)
        off = given.misfits(View())
        wrong = [key[1] for key, misfit in zip(given.rows, off, strict=True) if misfit > LIMITS.wrong**2]
        assert wrong == list(joints)
        assert explained(given, View(), right) is cause


def test_a_load_has_to_explain_every_torque_that_is_set_right() -> None:
    """A mass on the last link is behind the wrists' torques, but not behind a turned pan, which it leaves as
    it is."""
    laden = balance(mass=5.0, place=(0.1, 0.05, 0.05))
    turned = View.of([Change("", (PAN,), torques={("tau_motor", PAN): Source(PAN, -1.0)})])
    right = np.full(6, 0.05**2)
    assert explained(laden, View(), right) and not explained(laden, turned, right)


def test_the_reach_is_that_of_the_stretched_arm() -> None:
    # upper arm 0.425 m, forearm 0.392 m, wrist 0.109 + 0.095 + 0.082 m: no less, and with the offsets to the
    # side (0.136 and 0.12 m) and a body's centre no more than half as much again
    assert 1.1 < reach(ur5()) < 1.65


def test_columns_are_repaired_together_and_noted() -> None:
    one, other = f"q.{PAN}", f"q.{ELBOW}"
    swap = DataFinding(
        "swapped", None, "they are swapped", (Column(one, other), Column(other, one, -1.0, 0.5))
    )
    before = log()
    after = repaired(before, [swap])
    assert np.array_equal(after.get("q", PAN), before.get("q", ELBOW))
    assert np.array_equal(after.get("q", ELBOW), 0.5 - before.get("q", PAN))
    assert after.notes == ("they are swapped: repaired",)
    assert repaired(before, []) is before


@pytest.mark.parametrize("factor", [-1.0, 57.0, 0.02])
def test_a_slope_is_told_whatever_the_offset_and_the_noise(factor: float) -> None:
    before = log()
    noise = 1e-4 * abs(factor) * np.random.default_rng(0).normal(size=before.time.size)
    theta = factor * before.get("q", ELBOW) + 3.0 + noise
    table = make(before.time, {("q", ELBOW): before.get("q", ELBOW), ("theta", ELBOW): theta})
    found = slope(table, ELBOW, "theta", "q")
    assert found is not None and found.slope == pytest.approx(factor, rel=1e-3)
    assert abs(found.alike) > 0.999


# --- stamps of arrival --------------------------------------------------------------------------------------
def delayed(recording: Recording, delay: np.ndarray, sampled_late: bool = False) -> Recording:
    """The recording with stamps as rows came, one after the other; `sampled_late`: sampled when they say."""
    arrived = np.maximum.accumulate(recording.time + delay) + 1e-6 * np.arange(delay.size)
    columns = recording.columns
    if sampled_late:
        columns = {key: np.interp(arrived, recording.time, values) for key, values in columns.items()}
    return make(arrived, columns, "late.csv")


def test_stamps_of_arrival_are_named_with_the_rate_of_the_samples() -> None:
    recording = log()
    period = float(np.median(np.diff(recording.time)))
    rng = np.random.default_rng(3)
    delay = rng.exponential(period, recording.time.size)
    (found,) = check_data(ur5(), delayed(recording, delay)).findings
    assert found.error == "stamps_of_arrival" and f"even clock of {1.0 / period:.4g} Hz" in found.text
    assert f"rate: {1.0 / period:.4g}" in found.robot_file
    assert found.command == "flexjoint import late.csv --mapping map.yaml --to even.parquet"


def test_stamps_that_tell_when_rows_were_sampled_or_that_hiccup_once_are_left_alone() -> None:
    recording = log()
    period = float(np.median(np.diff(recording.time)))
    rng = np.random.default_rng(3)
    delay = rng.exponential(period, recording.time.size)
    hiccup = np.where(np.arange(delay.size) == delay.size // 2, 20.0 * period, 0.0)
    jitter = 0.3 * period * rng.random(delay.size)
    lost = delay.copy()
    lost[delay.size // 2 :] += 5.0 * period  # as where five rows are missing: no one even clock
    for late in (
        delayed(recording, delay, sampled_late=True),
        delayed(recording, hiccup),
        delayed(recording, jitter),
        delayed(recording, lost),
    ):
        assert check_data(ur5(), late).findings == ()


@pytest.mark.parametrize("turned", [1.0, -1.0], ids=["right torque", "turned torque"])
def test_a_spring_that_sags_has_no_wrong_zero(turned: float) -> None:
    """One so soft that its load bends it by 0.7 rad in the mean, and moves it by little."""
    robot = load_robot("rrbot")
    joint = robot.joints[-1]
    time = np.arange(0.0, 4.0, 0.01)
    q = 0.2 * np.sin(3.0 * time)
    bent = 0.7 + 0.01 * np.sin(2.0 * time)

    def recorded(shift: float) -> Recording:
        columns = {
            ("q", joint.name): q,
            ("theta", joint.name): q + bent + shift,
            ("tau_t", joint.name): turned * joint.drive.K * bent,
        }
        return make(time, columns)

    assert not list(differences(robot, recorded(0.0), LIMITS))
    (found,) = differences(robot, recorded(1.5), LIMITS)
    assert found.error == "zero"


@pytest.mark.parametrize("softness", [1.0, 0.01], ids=["soft", "stiff"])
def test_a_link_that_swings_on_a_soft_spring_is_in_no_other_unit(softness: float) -> None:
    """Its motor moves 0.4 times as far, and its spring's torque says so; that of a stiff one does not."""
    robot = load_robot("rrbot")
    joint = robot.joints[-1]
    time = np.arange(0.0, 4.0, 0.01)
    q = 0.5 * np.sin(3.0 * time)
    columns = {
        ("q", joint.name): q,
        ("theta", joint.name): 0.4 * q,
        ("tau_t", joint.name): softness * joint.drive.K * -0.6 * q,
    }
    found = [f.error for f in differences(robot, make(time, columns), LIMITS)]
    assert found == ([] if softness == 1.0 else ["unit"])


def test_a_turned_torque_is_found_where_motors_are_off_for_most_of_the_log() -> None:
    """Brakes hold the arm there, and say nothing of its torques: instants lie where motors give some."""
    moving = log()
    count = 2 * moving.time.size
    columns = {}
    for (channel, joint), x in moving.columns.items():
        sign = -1.0 if (channel, joint) == ("tau_motor", LIFT) else 1.0
        before = (
            np.zeros(count) if channel == "tau_motor" or channel.startswith("d") else np.full(count, x[0])
        )
        columns[channel, joint] = np.concatenate([before, sign * x])
    time = moving.period * np.arange(count + moving.time.size)
    found = check_data(ur5(), make(time, columns, "braked"))
    assert any("brakes" in note for note in found.notes)
    assert [(f.error, f.joint) for f in found.findings] == [("turned_torque", LIFT)]
