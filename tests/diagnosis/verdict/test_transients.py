"""A push on a link, told with its joint, begin and end, and nothing else told as one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import Planted, plant, robot_file
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording, summary
from support.thorough import sample, thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, ResidualView, Unexplained
from flexjoint.diagnosis.result.values import to_json
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.transients import push_of
from flexjoint.robot.robot import load

ENCODERS = SensorSet(channels=("q", "theta", "tau_m"))
MOTOR = SensorSet(channels=("theta", "tau_motor"))
RIGID = "dirty_drawn_12_of6_rigid_5"  # six joints
# joint that is pushed, and the RMS of its torque [N m]
ROBOTS = {"crane": ("elbow", 6.32), RIGID: ("joint_2", 32.8)}
T = np.arange(0.0, 14.0, 0.004)


DONE: dict[str, Diagnosis] = {}


def diagnosed(name: str, *causes: Planted) -> Diagnosis:
    """Made once; effects have no hash."""
    key = repr((name, causes))
    if key not in DONE:
        DONE[key] = _diagnosed(name, causes)
    return DONE[key]


def _diagnosed(name: str, causes: tuple[Planted, ...]) -> Diagnosis:
    path = robot_file(name)
    recorded = plant(path, list(causes), "rich", 14.0, 3, MOTOR if name == RIGID else ENCODERS, rate=250.0)
    return diagnose(load(path), [as_recording(recorded)], refine=False, workers=1)


def pushed(found: Diagnosis) -> list[Unexplained]:
    return [u for u in found.unexplained if u.begin is not None]


@thorough
@pytest.mark.parametrize(
    ("name", "share"),
    sample([("crane", 0.05), (RIGID, 0.2), ("crane", 0.3)], one_in=2, several=True, thorough_in=2),
)
def test_a_push_of_two_seconds_is_told_with_joint_and_times(name: str, share: float) -> None:
    joint, size = ROBOTS[name]
    # exp(-(t - 5)^4): from 4 to 6 s, above half of its height from 4.09 to 5.91 s
    found = diagnosed(
        name, Planted("pushes", joint, {"torque": share * size, "times": (5.0,), "length": 1.0})
    )
    assert not found.likely(0.5), summary(found)
    (told,) = pushed(found)
    assert told.joint == joint
    assert told.begin == pytest.approx(4.0, abs=0.2) and told.end == pytest.approx(6.0, abs=0.2)
    # the mean over that time is 0.87 of the height, and nominal numbers within their tolerances take some
    assert told.torque == pytest.approx(0.85 * share * size, rel=0.2)
    said = str(found)
    assert f"An outside force acts on the link of {joint} from 4.1 to" in " ".join(said.split())
    assert "slow and fast sweeps" not in said
    assert next(u["push"] for u in to_json(found)["unexplained"] if u["push"]) == {
        "begin": told.begin,
        "end": told.end,
        "torque": told.torque,
    }


def test_a_healthy_machine_was_not_pushed() -> None:
    assert diagnosed("crane").verdict == "healthy" and not pushed(diagnosed("crane"))


@thorough
def test_a_push_beside_friction_and_friction_alone() -> None:
    friction = Planted("motor_coulomb_friction", "elbow", {"level": 1.0})
    push = Planted("pushes", "elbow", {"torque": 1.26, "times": (5.0,), "length": 1.0})
    rubbing = diagnosed("crane", friction)
    assert [(f.effect, f.joint) for f in rubbing.likely(0.5)] == [("motor_coulomb_friction", "elbow")]
    assert not pushed(rubbing)
    both = diagnosed("crane", friction, push)
    assert [(f.effect, f.joint) for f in both.likely(0.5)] == [("motor_coulomb_friction", "elbow")]
    assert [u.joint for u in pushed(both)] == ["elbow"]


def view(after: np.ndarray) -> ResidualView:
    noise = 0.05 * np.random.default_rng(2).standard_normal(T.size)
    q = np.sin(1.3 * T) + 0.4 * np.sin(4.1 * T)
    return ResidualView("elbow", "link", T, after + noise, after + noise, 0.05, {"q": q, "t": T})


@pytest.mark.parametrize(
    "after",
    [
        0.0 * T,
        0.5 * np.exp(-T / 4.0),
        0.3 * np.sin(2.0 * np.pi * 0.5 * T),
        np.where(T > 5.0, 0.5, 0.0),  # sets in, and stays
        0.5 * np.sin(1.3 * T) + 0.2 * np.sin(4.1 * T),  # a law of the position
        np.where((T > 3.0) & (T < 4.0), 0.5, 0.0) + np.where((T > 8.0) & (T < 9.0), -0.5, 0.0),  # two
    ],
    ids=["noise", "warming", "oscillation", "onset", "position", "twice"],
)
def test_what_is_no_push(after: np.ndarray) -> None:
    assert push_of(view(after), USUAL.verdict) is None


def in_one_stroke(left: np.ndarray) -> ResidualView:
    """Of a joint that goes forward and back six times, what is left of its third move, from 4 to 5 s."""
    speed = np.zeros_like(T)
    for k in range(6):
        share = np.clip(T - 2.0 * k, 0.0, 1.0)
        speed += (-1.0) ** k * 30.0 * (share * (1.0 - share)) ** 2
    shown = view(left * np.where((T >= 4.0) & (T < 5.0), speed, 0.0))
    return replace(shown, signals={**shown.signals, "dtheta": speed})


def test_friction_of_one_move_is_no_push() -> None:
    """A cold joint rubs more the first time that it moves."""
    rubs = in_one_stroke(np.full_like(T, -0.3))
    assert push_of(rubs, USUAL.verdict) is None
    steady = replace(rubs, after=view(np.where((T >= 4.1) & (T < 4.9), -0.5, 0.0)).after)
    assert push_of(steady, USUAL.verdict) is not None


def test_times_and_torque_of_a_push() -> None:
    found = push_of(view(np.where((T >= 4.0) & (T < 6.0), -0.5, 0.0)), USUAL.verdict)
    assert found is not None
    # what the balance has too little the push gives
    np.testing.assert_allclose(found, (4.0, 6.0, 0.5), atol=0.03)


@thorough
def test_a_leftover_is_told_by_the_neighbours_position() -> None:
    """A cable over two joints pulls at one by the angle of the other."""
    pull = Planted("neighbour_pull", "tilt", {"torque": 0.8, "angle": 0.3, "side": "before"})
    found = diagnosed("gimbal", pull)
    own = [u.against for u in found.unexplained if u.joint == "tilt" and u.balance == "link"]
    assert own == ["q.pan"], (summary(found), found.unexplained)
