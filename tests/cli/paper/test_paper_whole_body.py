"""Section 5.2: plan, static law on the holds, and what each compensation leaves."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.thorough import thorough

from flexjoint.cli.main import main
from flexjoint.cli.paper import whole_body
from flexjoint.core.errors import UnknownNameError

every_variant = pytest.mark.parametrize(
    ("gravity", "motor"), [(g, m) for g in whole_body.GRAVITY for m in whole_body.MOTOR]
)


def variant(gravity: str, motor: str) -> whole_body.Run:
    return whole_body.run(gravity, motor, "compiled")


def at(joint: str) -> int:
    return whole_body.robot_model().robot.joint_names.index(joint)


# --- the plan ------------------------------------------------------------------------------------
def test_the_reference_respects_the_limits_of_joints() -> None:
    model, plan = whole_body.robot_model(), whole_body.plan()
    places = [joint.idx_q for joint in model.joints]
    assert np.all(plan.q >= model.robot.model.lowerPositionLimit[places] - 1e-9)
    assert np.all(plan.q <= model.robot.model.upperPositionLimit[places] + 1e-9)
    assert np.all(np.abs(plan.dq) <= model.robot.model.velocityLimit[[j.idx_v for j in model.joints]])
    limit = np.array([joint.torque_limit for joint in model.joints])
    assert np.all(np.abs(plan.load) <= limit)


def test_the_reference_is_smooth_and_passes_the_poses() -> None:
    model, plan = whole_body.robot_model(), whole_body.plan()
    places = [joint.idx_q for joint in model.joints]
    moving = ~whole_body.wheels(model)
    for k, pose in enumerate(whole_body.POSES):
        tick = round((whole_body.TIMING.wait + k * whole_body.TIMING.leg) * whole_body.CONTROL) - 1
        expected = whole_body.configuration(pose)[places]
        np.testing.assert_allclose(plan.q[tick, moving], expected[moving], atol=1e-9)
        np.testing.assert_allclose(plan.dq[tick], 0.0, atol=1e-6)
    jumps = np.abs(np.diff(plan.dq, axis=0))
    assert np.max(jumps) < 0.02  # 20 rad/s^2; a jump of the velocity itself would be of order 1


def test_planned_feet_stay_level_and_roll_without_slip() -> None:
    """The contact points' velocities at the planned motion: nothing sideways, nothing along."""
    model, plan = whole_body.robot_model(), whole_body.plan()
    assert model.ground is not None
    q = model.body.neutral.copy()
    for tick in range(0, len(plan.time), 500):
        v = np.zeros(model.nv)
        for i, joint in enumerate(model.joints):
            q[joint.idx_q], v[joint.idx_v] = plan.q[tick, i], plan.dq[tick, i]
        points, jacobian = model.ground.places(model.body, q)
        assert np.ptp(points[:, 2]) < 1e-4  # the poses' angles have four digits
        slip = (jacobian @ v)[:, :2]
        assert np.max(np.abs(slip)) < 5e-3  # against 0.1 m/s and more of the wheels


# --- the runs ------------------------------------------------------------------------------------
@every_variant
def test_the_static_law_holds_at_rest(gravity: str, motor: str) -> None:
    for hold in variant(gravity, motor).holds:
        assert hold.drift < 1e-3
        assert whole_body.largest(hold.error - hold.law) < 1e-3
        assert hold.weight == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("motor", whole_body.MOTOR)
def test_exact_compensation_leaves_little(motor: str) -> None:
    """Its theta_d = q_d variant leaves the springs' deflection; beside it forces between the feet."""
    for hold in variant("contact", motor).holds:
        assert whole_body.largest(hold.error) < 2e-3


@pytest.mark.parametrize("motor", whole_body.MOTOR)
@pytest.mark.parametrize("gravity", ["none", "gravity"])
def test_the_hip_yaw_converges_and_the_pitch_does_not(gravity: str, motor: str) -> None:
    """Fig. 9: below a tenth. Not of the rear legs in the mammal pose, whose hip pitch carries 7 to 9 N m and
    whose wheels are stuck with 15 N along (docs/studies/whole_body.md)."""
    spider, mammal = variant(gravity, motor).holds
    for hold, legs, least in ((spider, "1234", 0.05), (mammal, "12", 0.015)):
        for leg in legs:
            pitch = abs(hold.error[at(f"hip_pitch_{leg}")])
            assert pitch > least
            assert abs(hold.error[at(f"hip_yaw_{leg}")]) < 0.1 * pitch
    for leg in "34":
        assert abs(mammal.error[at(f"hip_yaw_{leg}")]) < 2e-3


@every_variant
def test_the_robot_stands_upright_all_the_time(gravity: str, motor: str) -> None:
    """Weight and static law would hold of a robot that hangs below its wheels, too."""
    body, tape = whole_body.robot_model().body, variant(gravity, motor).trajectory
    for row in range(0, len(tape.time), 1000):
        placement = body.frame_placement(tape.q[row], "pelvis")
        assert placement[2, 2] > 0.99
        assert placement[2, 3] > 0.6


def test_without_gravity_the_arm_sags_and_with_it_not() -> None:
    """Fig. 8: shoulder and elbow keep an error only under a zero centralised torque."""
    for k in (0, 1):
        sags, held = (variant(gravity, "link").holds[k] for gravity in ("none", "gravity"))
        for joint in ("j_arm1_2", "j_arm1_4"):
            assert abs(sags.error[at(joint)]) > 0.02
            assert abs(held.error[at(joint)]) < 3e-3


def test_unknown_variants_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="gravity_ff"):
        whole_body.references("half", "link")
    with pytest.raises(UnknownNameError, match="theta_d"):
        whole_body.references("none", "motor")


@thorough
def test_the_command_prints_the_tables_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "whole-body", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "spider" in out and "mammal" in out and "wrote" in out
    page = (tmp_path / "whole-body.html").read_text(encoding="utf-8")
    assert page.count("<img") == 2 * 6 + 4  # Fig. 8 and 9, three rows of two joints; the errors of four
    assert "Fig. 8" in page and "Fig. 9" in page and "speed [rad/s]" in page
    assert not re.findall('(?:src|href)="(?!data:)', page)  # opens offline


def test_the_arms_move_and_come_back() -> None:
    """Fig. 8 has a moving reference."""
    plan, shoulder, elbow = whole_body.plan(), at("j_arm1_1"), at("j_arm1_4")
    for joint in (shoulder, elbow):
        assert np.ptp(plan.q[:, joint]) > 0.3
        assert plan.q[-1, joint] == pytest.approx(plan.q[0, joint], abs=1e-9)


def test_wheels_follow_the_velocity_and_do_not_hold_a_place() -> None:
    """Their torque while they roll is kd (dq_d - dtheta) and the damping fed forward, whatever theta is."""
    model, tape = whole_body.robot_model(), variant("none", "link").trajectory
    told, kd = whole_body.references("none", "link"), 20.0
    ticks = np.arange(3000, 30000, 7)
    rows = ticks * whole_body.PHYSICS // whole_body.CONTROL
    for name in ("j_wheel_1", "j_wheel_4"):
        i = at(name)
        speed = tape.dtheta[rows, model.flexible.index(i)]
        expected = told["tau_ff"][ticks, i] + kd * (told["dtheta_ref"][ticks, i] - speed)
        np.testing.assert_allclose(tape.tau_m[rows, i], np.clip(expected, -35.0, 35.0), rtol=0, atol=1e-9)
        assert np.ptp(tape.tau_m[rows, i]) > 1.0
