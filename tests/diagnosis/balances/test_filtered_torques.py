"""Rigid-body torques behind a filter: those of a changed body, of turned gravity, and of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import plant, robot_file
from planting.machine.sensing import PERFECT
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import Balances, balances_of
from flexjoint.diagnosis.balances.motion import Filtered
from flexjoint.rigidbody.numeric import PinBody

ROBOTS = ("lever", "crane", "scara")


def balances(robot: str) -> Balances:
    return balances_of(nominal(robot), as_recording(Case(robot, "rich", 7).with_causes()))


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_body_that_changes_adds_what_a_changed_model_has_more(robot: str) -> None:
    motion = balances(robot).motion
    model, rigid = motion.robot.model, motion.rigid
    i = len(motion.robot.joints) - 1
    body = motion.robot.joints[i].pin_id - 1
    added = np.array([0.3, 0.02, -0.01, 0.03, 0.01, 0.001, 0.012, -0.002, 0.0, 0.009])
    changed = PinBody(model).inertial.copy()
    changed[body] += added
    rows = [joint.idx_v for joint in motion.robot.joints]

    def torques(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(PinBody(model, inertial=changed).rnea_batch(q, v, a)[:, rows].T)

    more = rigid.filtered.of(torques) - rigid.tau

    assert rigid.regressor.torque(i, added) == pytest.approx(more, abs=1e-5 * np.max(np.abs(more)))


@pytest.mark.parametrize("robot", ROBOTS)
def test_gravity_by_axes_adds_up_to_what_a_robot_at_rest_carries(robot: str) -> None:
    motion = balances(robot).motion
    model = motion.robot.model
    rows = [joint.idx_v for joint in motion.robot.joints]

    def carried(q: np.ndarray, v: np.ndarray, _a: np.ndarray) -> np.ndarray:
        still = np.zeros_like(v)
        return np.ascontiguousarray(PinBody(model).rnea_batch(q, still, still)[:, rows].T)

    total = np.einsum("a,ajt->jt", motion.rigid.gravity, motion.rigid.by_gravity)

    assert total == pytest.approx(motion.rigid.filtered.of(carried), abs=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_machine_without_noise_closes_its_balances(robot: str) -> None:
    """Filters and rigid bodies commute: what is left is far below the torques that an angle has whose
    function is filtered and not the angle."""
    recorded = plant(robot_file(f"{robot}_exact"), (), "rich", seconds=8.0, seed=2, sensors=PERFECT)
    found = balances_of(nominal(f"{robot}_exact"), as_recording(recorded))
    valid = found.motion.readings.valid

    left = found.time_series(found.residual([]))[:, valid]
    rows = [row for row in range(len(found.rows)) if found.rows[row].balance == "link"]
    plainly = found.motion.filter.smooth(found.motion.rigid.tau)[:, valid]

    for row in rows:
        joint = found.rows[row].joint
        filtered_once_more = np.std(plainly[joint] - found.motion.rigid.tau[joint][valid])
        assert np.std(left[row]) < 0.02 * filtered_once_more


def test_the_order_of_the_filter_s_error_is_its_fourth() -> None:
    """Half the width leaves a sixteenth: what is in the square of the width cancels."""
    motion = balances("lever").motion
    window = motion.filter
    q = np.array([0.8 * np.sin(np.arange(window.count) * window.period * 9.0)])
    exact = np.sin(q) * 1.0

    def error(share: float) -> float:
        narrow = replace(window, gain=window.gain**share)
        filtered = Filtered(motion.robot, narrow, q, {})
        found = filtered.of(lambda at, _v, _a: np.sin(at).T)
        middle = slice(window.count // 4, -(window.count // 4))
        return float(np.std((found - narrow.smooth(exact))[:, middle]))

    assert error(1.0) / error(0.25) == pytest.approx(16.0, rel=0.2)
