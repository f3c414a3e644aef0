"""Tests of one's own robot: it moves as it did, keeps energy, limits and the law of rest, and repeats.

Run: pytest examples/test_my_robot.py
Record anew, when a change is meant: FLEXJOINT_GOLDEN=record pytest examples/test_my_robot.py
"""

from pathlib import Path

import numpy as np
import pytest

from flexjoint import FlexibleJointModel, load_robot, testing
from flexjoint.model.statics.start import at_rest
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.references import tomei
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.trajectory import Trajectory

ROBOT = "ur5"  # or the path of your YAML
GOLDEN = Path(__file__).parent / "golden" / "my_robot.parquet"
START = np.array([0.0, -1.2, 1.4, -1.0, -1.57, 0.0])
REACH = np.array([0.5, 0.3, -0.4, 0.2, 0.0, 0.6])
SECONDS, RATE = 3.0, 1000.0


def reference(model: FlexibleJointModel) -> dict[str, np.ndarray]:
    """From START to START + REACH in 1.5 s, and there it holds; no gravity torque is fed forward."""
    s = np.clip(np.arange(round(SECONDS * model.robot.rates.control)) / 1500.0, 0.0, 1.0)
    way = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    told = tomei(model, START + way[:, None] * REACH)
    return {**told, "theta_ref": told["q_ref"], "tau_ff": np.zeros_like(told["q_ref"])}


def reach(robot: str = ROBOT) -> Trajectory:
    model = FlexibleJointModel(load_robot(robot))
    options = RunOptions(rate=RATE, engine="pin")
    return closed_loop(model, at_rest(model, START), law_of(model.robot), reference(model), options)


@pytest.fixture(scope="module")
def model() -> FlexibleJointModel:
    return FlexibleJointModel(load_robot(ROBOT))


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    return reach()


def test_it_moves_as_it_did(model: FlexibleJointModel, motion: Trajectory) -> None:
    run = testing.golden_run(model, motion, rate=20.0, settings={"engine": "pin", "tau_ff": "none"})
    tolerances = {
        "q": testing.Tolerance(1e-9, "rounding moves 1e-13 rad, 1 % of a stiffness 2e-7"),
        "theta": 1e-9,
        "tau_t": 1e-6,
        "tau_m": 1e-6,
    }
    testing.assert_golden(run, GOLDEN, tolerances)


def test_it_repeats() -> None:
    testing.assert_deterministic(reach)


def test_energy_adds_up(model: FlexibleJointModel, motion: Trajectory) -> None:
    testing.assert_energy_balance(model, motion, tolerance=1e-5)


def test_it_rests_where_its_load_says(model: FlexibleJointModel, motion: Trajectory) -> None:
    told = reference(model)
    testing.assert_static_law(model, motion, told["theta_ref"][-1], told["tau_ff"][-1], tolerance=1e-3)


def test_it_stays_within_its_limits(model: FlexibleJointModel, motion: Trajectory) -> None:
    testing.assert_limits(model, motion, ["position", "speed", "torque", "spring torque"])
