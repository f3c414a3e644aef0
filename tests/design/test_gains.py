"""Designs against closed forms and scipy, and their verdicts in the nonlinear simulation."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from support.robots.arms import PENDULUM, PLANAR, SPATIAL, make
from support.robots.elastic_ur5 import ur5

from flexjoint.core.errors import ModelError, UnknownNameError
from flexjoint.core.parameter import Parameter
from flexjoint.design.feedback import Gains, StateFeedback, close_loop
from flexjoint.design.gains import lqr, motor_pd, place
from flexjoint.design.linearise import linearise
from flexjoint.design.margins import is_stable
from flexjoint.design.robustness import with_parameters, worst_case
from flexjoint.design.tomei import tomei
from flexjoint.design.verification import StepTest, verify
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import load, write
from flexjoint.simulation.controllers import MotorPD

POSE = np.array([0.4, -0.7])
WEIGHTS = {"q": 1e4, "dq": 10.0, "dtheta": 1.0}


def planar(*effects: object) -> FlexibleJointModel:
    return FlexibleJointModel(make(PLANAR), list(effects))  # type: ignore[arg-type]


# --- LQR and pole placement ------------------------------------------------------------------------------
def test_lqr_solves_its_riccati_equation() -> None:
    design = lqr(planar(), POSE, Q=WEIGHTS, R=0.02)
    linear = design.linear
    Q = np.diag([1e4, 1e4, 10.0, 10.0, 0.0, 0.0, 1.0, 1.0])
    P = scipy.linalg.solve_continuous_are(linear.A, linear.B, Q, 0.02 * np.eye(2))
    np.testing.assert_allclose(design.gains.matrix, linear.B.T @ P / 0.02, rtol=1e-6, atol=1e-6)
    assert design.verified and "settle" in design.verification.reason
    # guaranteed for any LQR (Anderson and Moore 1990, section 5.4)
    assert all(loop.phase >= 60.0 - 1e-6 and math.isinf(loop.gain_up) for loop in design.margins.loops)


def test_discrete_lqr_solves_its_riccati_equation() -> None:
    design = lqr(planar(), POSE, Q=WEIGHTS, R=np.array([0.02, 0.04]), rate=1000.0)
    linear = design.linear
    Q, R = np.diag([1e4, 1e4, 10.0, 10.0, 0.0, 0.0, 1.0, 1.0]), np.diag([0.02, 0.04])
    P = scipy.linalg.solve_discrete_are(linear.A, linear.B, Q, R)
    K = np.linalg.solve(R + linear.B.T @ P @ linear.B, linear.B.T @ P @ linear.A)
    np.testing.assert_allclose(design.gains.matrix, K, rtol=1e-6, atol=1e-6)
    assert design.verified and design.gains.rate == 1000.0


def test_a_law_that_knows_its_commands_on_the_way_bears_a_delay() -> None:
    """Ten ticks of dead time: designed for, the simulated step settles as the linear loop says; gains that
    ignore it are unstable there, and the verdict says so."""
    late = [effect("torque_delay", joint, delay=0.01) for joint in ("hip", "knee")]
    fast = {"q": 3e6, "dq": 10.0, "dtheta": 1.0}
    test = StepTest(size=0.002, horizon=1.0, overshoot=0.8)
    ignorant = lqr(planar(), POSE, Q=fast, R=0.02, rate=1000.0, test=test)
    assert ignorant.verified
    assert not verify(planar(*late), ignorant.gains, POSE, test).verified
    knowing = lqr(planar(*late), POSE, Q=fast, R=0.02, rate=1000.0, test=test)
    assert len(knowing.gains.signals) == 8 + 20
    assert knowing.verified, knowing.verification.reason
    linear = close_loop(knowing.linear, knowing.gains)
    x = np.zeros(len(linear.states))
    x[:2] = x[4:6] = -0.002  # both sides away from the goal by the step
    tape = [x]
    for _ in range(300):
        tape.append(linear.A @ tape[-1])
    predicted = np.array(tape)[:, :2]
    got = (knowing.verification.q - knowing.verification.q_ref)[:301]
    # g differs by 0.03 N m between start and goal: commands on the way are that much off what the law knows
    np.testing.assert_allclose(got, predicted, atol=6e-5)


# scipy's place_poles optimises the eigenvectors beyond that; that it stops at its limit moves no pole
@pytest.mark.filterwarnings("ignore:Convergence was not reached")
def test_poles_lie_where_they_were_placed() -> None:
    wanted = [-20 + 20j, -20 - 20j, -25 + 10j, -25 - 10j, -60, -65, -70, -75]
    design = place(planar(), POSE, poles=wanted)
    np.testing.assert_allclose(np.sort_complex(design.poles), np.sort_complex(wanted), rtol=1e-5)
    assert design.verified
    sampled = place(planar(), POSE, poles=wanted, rate=1000.0, delay=1e-3)
    expected = np.concatenate([np.exp(np.array(wanted) * 1e-3), np.zeros(4)])  # commands, sent and on the way
    np.testing.assert_allclose(np.sort(np.abs(sampled.poles)), np.sort(np.abs(expected)), atol=1e-5)
    assert sampled.verified
    with pytest.raises(ModelError, match=r"expected 8.*got 2"):
        place(planar(), POSE, poles=[-1, -2])
    with pytest.raises(ModelError, match="more than one tick"):
        place(planar(), POSE, poles=wanted, rate=1000.0, delay=5e-3)


def test_what_state_feedback_cannot_do_is_refused() -> None:
    floating = FlexibleJointModel(make(SPATIAL, base="floating"))
    with pytest.raises(ModelError, match=r"no sensor shows q\[0\]"):
        lqr(floating, Q=WEIGHTS, R=1.0)
    creep = effect("spring_creep", "hip", stiffness=50.0)
    with pytest.raises(ModelError, match=r"spring_creep\.hip"):
        lqr(planar(creep), Q=WEIGHTS, R=1.0)
    with pytest.raises(ModelError, match="give the rate"):
        lqr(planar(effect("torque_delay", "hip", delay=0.01)), Q=WEIGHTS, R=1.0)
    with pytest.raises(ModelError, match="without a choice"):
        lqr(planar(effect("backlash", "hip", gap=0.01)), Q=WEIGHTS, R=1.0)
    with pytest.raises(UnknownNameError, match="dtheta"):
        lqr(planar(), Q={"speed": 1.0}, R=1.0)
    with pytest.raises(ModelError, match="weights of 8 states"):
        lqr(planar(), Q=np.eye(3), R=1.0)
    with pytest.raises(ModelError, match=r"\(2, 2\) weights"):
        lqr(planar(), Q=WEIGHTS, R=np.eye(3))
    design = lqr(planar(), POSE, Q=WEIGHTS, R=0.02, rate=500.0 * 2)
    with pytest.raises(ModelError, match="500 Hz, but the robot's controller ticks at 1000 Hz"):
        verify(planar(), replace(design.gains, rate=500.0), POSE)


def test_gains_give_the_law_that_they_are() -> None:
    robot = make(PLANAR)
    pd = Gains.motor_pd(robot, np.array([900.0, 500.0]), np.array([10.0, 5.0])).law(robot)
    assert isinstance(pd, MotorPD)
    np.testing.assert_array_equal(pd.kp, [900.0, 500.0])
    np.testing.assert_array_equal(pd.limit, [110.0, 60.0])
    crossed = Gains(np.ones((2, 2)), ("theta.hip", "theta.knee"), ("tau_m.hip", "tau_m.knee")).law(robot)
    assert isinstance(crossed, StateFeedback)
    with pytest.raises(UnknownNameError, match="tau_t"):
        Gains(np.ones((2, 1)), ("tau_t.hip",), ("tau_m.hip", "tau_m.knee")).law(robot)


# --- motor PD ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("changes", [{}, {"joint": {"stiffness": math.inf}}], ids=["elastic", "rigid"])
def test_motor_pd_puts_the_pair_exactly(changes: dict) -> None:
    model = FlexibleJointModel(make(PENDULUM, changes), [])
    pose = np.array([[0.3]])
    design = motor_pd(model, 3.0, 0.7, poses=pose)
    continuous = close_loop(linearise(model, pose[0]), design.gains).poles
    wanted = 2 * math.pi * 3.0 * complex(-0.7, math.sqrt(1 - 0.49))
    assert np.min(np.abs(continuous - wanted)) < 1e-6 * abs(wanted)
    assert design.bandwidth[0, 0] == pytest.approx(3.0) and design.damping[0, 0] == pytest.approx(0.7)
    assert design.verified and design.tomei is not None and design.tomei.holds


def test_effects_count_in_the_pair() -> None:
    """Springs, motors and friction as effects change them."""
    effects = [
        effect("spring_stiffness", "joint", scale=-0.2),
        effect("motor_inertia", "joint", scale=0.3),
        effect("link_viscous_friction", "joint", coefficient=0.4),
        effect("hardening_spring", "joint", cubic=3e4),
        effect("motor_coulomb_friction", "joint", level=0.02),
    ]
    model = FlexibleJointModel(make(PENDULUM), effects)
    design = motor_pd(model, 3.0, 0.7, poses=np.array([[1.1]]), nonsmooth="null")
    closed = close_loop(linearise(model, np.array([1.1]), nonsmooth="null"), design.gains)
    wanted = 2 * math.pi * 3.0 * complex(-0.7, math.sqrt(1 - 0.49))
    assert np.min(np.abs(closed.poles - wanted)) < 1e-5 * abs(wanted)


def test_a_spring_lets_no_more_through_than_it_can() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    # with the motor held, the link swings at sqrt((K + G) / M) = 6.4 Hz
    with pytest.raises(ModelError, match=r"link swings at 6\.42 Hz.*Hz can be reached"):
        motor_pd(model, 20.0, 0.7, poses=np.array([[0.3]]))
    with pytest.raises(ModelError, match="floating base cannot be sampled"):
        motor_pd(FlexibleJointModel(make(PENDULUM, base="floating")), 1.0)
    with pytest.raises(ModelError, match="bandwidth > 0"):
        motor_pd(model, 1.0, 1.2)


def test_a_motor_that_damps_more_than_wanted_gets_no_more() -> None:
    design = motor_pd(FlexibleJointModel(make(PENDULUM), []), 1.0, 0.5, poses=np.array([[0.3]]))
    assert design.kd[0] == 0.0 and design.damping[0, 0] > 0.5
    assert design.bandwidth[0, 0] == pytest.approx(1.0)


def test_motor_pd_of_an_arm_over_its_workspace() -> None:
    model = FlexibleJointModel(ur5())
    design = motor_pd(model, np.array([3.0, 3.0, 4.0, 5.0, 6.0, 8.0]), 0.6, poses=12, seed=4)
    assert design.poses.shape == (12, 6) and design.bandwidth.shape == (12, 6)
    heaviest = np.min(design.bandwidth, axis=0)
    # gravity moves it a little
    np.testing.assert_allclose(heaviest, [3.0, 3.0, 4.0, 5.0, 6.0, 8.0], rtol=0.1)
    assert np.all(design.mimo_damping > 0.0) and design.margins.stable
    assert design.verified, design.verification.reason
    again = motor_pd(model, np.array([3.0, 3.0, 4.0, 5.0, 6.0, 8.0]), 0.6, poses=12, seed=4)
    np.testing.assert_array_equal(design.kp, again.kp)


def test_the_time_to_compute_is_in_the_simulation_too() -> None:
    """As a dead time of the commands beside those that the effects have."""
    fast = {"q": 3e6, "dq": 10.0, "dtheta": 1.0}
    test = StepTest(size=0.002, horizon=0.6, overshoot=0.8)
    own = planar(effect("torque_delay", "hip", delay=4e-3))
    design = lqr(own, POSE, Q=fast, R=0.02, rate=1000.0, delay=6e-3, test=test)
    assert design.verified, design.verification.reason
    assert [name for name in design.gains.signals if "hip[n-" in name][-1] == "tau_m.hip[n-10]"
    both = [effect("torque_delay", joint, delay=d) for joint, d in (("hip", 0.01), ("knee", 6e-3))]
    np.testing.assert_allclose(design.verification.q, verify(planar(*both), design.gains, POSE, test).q)
    assert not verify(own, design.gains, POSE, test).verified  # a law that expects more delay than there is


def test_a_law_remembers_what_it_said_not_what_the_motor_did() -> None:
    """The gain margin of a law with memory, against stability with the motor's gain changed as an effect: the
    plant does more than the law believes it told it."""
    late = [effect("torque_delay", joint, delay=8e-3) for joint in ("hip", "knee")]
    design = lqr(planar(*late), POSE, Q={"q": 3e6, "dq": 10.0, "dtheta": 1.0}, R=0.02, rate=1000.0)
    limit = design.margins.loops[0].gain_up
    assert 1.0 < limit < 20.0
    for share, stable in ((0.99, True), (1.01, False)):
        stronger = planar(*late, effect("torque_gain", "hip", gain=share * limit - 1.0))
        sampled = linearise(stronger, POSE).sampled(1000.0)
        assert is_stable(close_loop(sampled, design.gains)) == stable
    # on a robot without the delay, the law is the same
    assert close_loop(linearise(planar(), POSE).sampled(1000.0), design.gains).states[-1] == "sent.knee[n-8]"


# --- verdicts ---------------------------------------------------------------------------------------------
def test_the_simulation_has_the_last_word() -> None:
    """What the linear model does not know: a weak motor, dry friction, and gains too high for the rate."""
    kp, kd = np.array([1500.0, 800.0]), np.array([60.0, 20.0])
    good = verify(planar(), Gains.motor_pd(make(PLANAR), kp, kd), POSE)
    assert good.verified and np.all(good.settling < 1.0) and np.all(good.saturated < 0.2)
    weak = make(PLANAR, {"hip": {"torque_limit": 3.0}})
    found = verify(FlexibleJointModel(weak, []), Gains.motor_pd(weak, kp, kd), POSE)
    assert not found.verified and "hip has not settled" in found.reason and found.saturated[0] > 0.5
    stuck = verify(
        planar(effect("motor_coulomb_friction", "knee", level=15.0)),
        Gains.motor_pd(make(PLANAR), kp, kd),
        POSE,
    )
    assert not stuck.verified and "knee has not settled" in stuck.reason
    unlimited = {name: {"torque_limit": math.inf} for name in ("hip", "knee")}
    robot = make(PLANAR, unlimited, rates={"physics": 1000.0, "control": 100.0})
    wild = verify(FlexibleJointModel(robot, []), Gains.motor_pd(robot, 50 * kp, kd), POSE)
    assert not wild.verified and len(wild.reason) > 10
    high = verify(planar(), Gains.motor_pd(make(PLANAR), kp, kd), POSE, StepTest(overshoot=0.01))
    assert not high.verified and "overshoots" in high.reason


# --- Tomei's condition ------------------------------------------------------------------------------------
def test_tomei_of_a_pendulum_in_closed_form() -> None:
    model = FlexibleJointModel(make(PENDULUM), [])
    slope = 2.4 * 9.81 * 0.26
    for kp in (30.0, 8.0, 5.0):
        check = tomei(model, kp, samples=200)
        potential = np.linalg.eigvalsh([[340.0, -340.0], [-340.0, 340.0 + kp]])[0]
        assert check.gravity == pytest.approx(slope, rel=1e-6)  # hanging, or upright
        assert check.stiffness == pytest.approx(potential, rel=1e-9)
        assert check.holds == (potential > slope)
        assert check.convex == pytest.approx(1.0 / (1.0 / 340.0 + 1.0 / kp) - slope, abs=1e-5)
        assert ("condition holds" in str(check)) == check.holds and check.margin == pytest.approx(
            potential / slope, rel=1e-6
        )


def test_tomei_finds_the_steepest_pose_of_an_arm() -> None:
    """Against a fine grid of the written-out gravity of the planar arm: masses 3.2 and 1.5 kg."""
    model = planar()
    angles = np.linspace(-np.pi, np.pi, 181)
    a, b = (x.ravel() for x in np.meshgrid(angles, angles))
    knee = 1.5 * 9.81 * 0.17 * np.cos(a + b)
    hip = 3.2 * 9.81 * (0.2 * np.cos(a) + 0.01 * np.sin(a)) + 1.5 * 9.81 * 0.4 * np.cos(a) + knee
    hessians = np.stack([np.stack([hip, knee], -1), np.stack([knee, knee], -1)], -2)
    largest = np.max(np.linalg.norm(hessians, 2, axis=(1, 2)))
    check = tomei(model, 500.0, samples=300)
    assert largest * (1.0 - 1e-12) <= check.gravity <= largest * 1.001  # the grid misses by 1 degree at most
    assert check.holds
    with pytest.raises(ModelError, match="fixed base"):
        tomei(FlexibleJointModel(make(SPATIAL, base="floating")), 100.0)


def test_where_tomei_fails_there_are_two_rests() -> None:
    """K_P just below the pendulum's gravity: upright is commanded and held, yet a push finds another rest."""
    robot = make(PENDULUM, {"joint": {"motor_damping": 12.0}})
    model = FlexibleJointModel(robot, [])
    test = StepTest(size=1e-3, horizon=8.0, overshoot=10.0)
    upright = np.array([math.pi])
    for kp, once in ((4.0, False), (80.0, True)):
        gains = Gains.motor_pd(robot, np.array([kp]), np.array([1.0]))
        assert (tomei(model, kp, samples=100).convex > 0.0) == once
        assert verify(model, gains, upright, test).verified == once


# --- robustness -------------------------------------------------------------------------------------------
def test_the_worst_case_is_at_the_corner_that_physics_says() -> None:
    model = planar()
    gains = Gains.motor_pd(model.robot, np.array([900.0, 500.0]), np.array([10.0, 5.0]))
    box = [
        Parameter("spring_stiffness.*.scale", low=-0.3, high=0.3),
        Parameter("motor_viscous_friction.*.coefficient", low=-3.0, high=3.0),
    ]
    found = worst_case(model, gains, POSE, box=box, samples=6)
    assert len(found.cases) == 4 + 6 and found.stable
    # a softer spring swings slower beside the same motor, and less friction damps less
    assert found.worst.parameters == {
        "spring_stiffness.*.scale": -0.3,
        "motor_viscous_friction.*.coefficient": -3.0,
    }
    nominal = worst_case(model, gains, POSE).worst
    assert found.worst.disk < nominal.disk
    delayed = worst_case(model, gains, POSE, delay=0.05)
    assert not delayed.stable and delayed.worst.damping < 0.0


def test_models_of_a_diagnosis_count(tmp_path: Path) -> None:
    """Robots as `flexjoint diagnose --out` writes them: nominal YAML with the causes found."""
    nominal = load("rrbot")
    found = nominal.extended(
        [effect("torque_delay", "joint1", delay=0.02), effect("payload", "joint2", mass=0.5)]
    )
    write(found, tmp_path / "extended.yaml")
    extended = load(tmp_path / "extended.yaml")
    gains = Gains.motor_pd(nominal, np.array([1000.0, 1000.0]), np.array([5.0, 5.0]))
    pose = np.array([math.pi - 0.3, 0.4])
    result = worst_case(FlexibleJointModel(nominal), gains, pose, models=[extended])
    assert [case.robot for case in result.cases] == ["nominal", "model 1"]
    assert result.worst.robot == "model 1" and result.worst.disk < result.cases[0].disk


def test_parameters_are_set_by_name() -> None:
    robot = with_parameters(
        load("rrbot"), {"link_viscous_friction.joint1.coefficient": 0.9, "base_tilt.robot.roll": 0.1}
    )
    kept = {str(item): item for item in robot.effects}
    assert kept["link_viscous_friction on joint1"].values["coefficient"] == 0.9
    assert kept["link_viscous_friction on joint1"].nominal and not kept["base_tilt"].nominal
    model, gains = planar(), Gains.motor_pd(make(PLANAR), np.ones(2), np.ones(2))
    for name, (low, high), words in (
        ("spring_stiffnes.hip.scale", (0.0, 1.0), "spring_stiffness"),
        ("spring_stiffness.hip.factor", (0.0, 1.0), "scale"),
        ("spring_stiffness.elbow.scale", (0.0, 1.0), "hip"),
        ("spring_stiffness", (0.0, 1.0), "effect.joint.parameter"),
        ("spring_stiffness.hip.scale", (1.0, 0.0), "low <= high"),
        ("spring_stiffness.hip.scale", (0.0, math.inf), "finite bounds"),
    ):
        with pytest.raises(
            ModelError if " " in words or "effect." in words else UnknownNameError, match=words
        ):
            worst_case(model, gains, POSE, box=[Parameter(name, low=low, high=high)])


# --- the page ---------------------------------------------------------------------------------------------
def test_the_example_of_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "gain_design.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    names: dict = {}
    exec(example, names)
    printed = capsys.readouterr().out
    assert "all at once: disk" in printed and "Tomei's condition" in printed
    assert names["pd"].verified and names["best"].verified
