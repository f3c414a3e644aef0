"""No simulation and no residual depends on the order in which a set of effects is listed or found."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, catalogue, effect, signal_order
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import make
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.simulate import simulate

CASE = Case("turret", "rich", 3)
JOINT = nominal(CASE.robot).joint_names[0]
NAMES = [  # of one joint, which has a spring
    name for name, e in catalogue().items() if not (e.whole_robot or e.reaches_before or e.for_rigid)
]
STATEFUL_OR_PLAIN = st.lists(st.sampled_from(NAMES), min_size=2, max_size=5, unique=True)


def typical(name: str, since: float | None = None) -> Planned:
    """An effect with numbers at which it does something: its defaults, off their null."""
    effect = catalogue()[name]
    values = {}
    for p in effect.params:
        off = 0.1 * min(1.0, p.high) if p.value == p.null else p.value
        values[p.name] = off if p.size == 1 else (off,) * p.size
    return Planned.of(name, None if effect.whole_robot else JOINT, values, since=since)


@cache
def problem() -> Problem:
    recorded = as_recording(CASE.with_causes(), CASE.name)
    return Problem(balances_of(nominal(CASE.robot), recorded))


def simulated(effects: list[Planned]) -> dict[tuple[str, str], np.ndarray]:
    robot = nominal(CASE.robot)
    time = np.linspace(0.0, 0.1, 51)
    reference = {("q_ref", name): 0.2 * np.sin(20 * time) for name in robot.joint_names}
    model = FlexibleJointModel(robot, effects)
    return dict(
        simulate(model, make(time, reference, "reference"), RunOptions(engine="pin")).measured.columns
    )


@given(names=STATEFUL_OR_PLAIN, seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_a_simulation_does_not_depend_on_the_order_of_its_effects(names: list[str], seed: int) -> None:
    effects = [typical(name) for name in names]
    shuffled = [effects[k] for k in np.random.default_rng(seed).permutation(len(effects))]
    one, other = simulated(effects), simulated(shuffled)
    for key, values in one.items():
        np.testing.assert_array_equal(values, other[key], err_msg=f"{key} of {names}")


@given(names=STATEFUL_OR_PLAIN, seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_a_residual_does_not_depend_on_the_order_of_its_effects(names: list[str], seed: int) -> None:
    effects = [typical(name) for name in names]
    shuffled = [effects[k] for k in np.random.default_rng(seed).permutation(len(effects))]
    balances = problem().balances
    np.testing.assert_array_equal(balances.residual(effects), balances.residual(shuffled))
    np.testing.assert_array_equal(
        problem()._residual(effects), problem()._residual(shuffled), err_msg=str(names)
    )


def test_gain_and_saturation_give_one_balance_in_either_order() -> None:
    """The two do not commute; the simulator limits what the gain has made of a command."""
    gain, limit = effect("torque_gain", JOINT, gain=0.5), effect("torque_saturation", JOINT, limit=2.0)
    balances = problem().balances
    np.testing.assert_array_equal(balances.residual([gain, limit]), balances.residual([limit, gain]))
    only_limit = balances.residual([limit])
    assert np.max(np.abs(balances.residual([gain, limit]) - only_limit)) > 0.1  # [N m]: both are at work


@pytest.mark.parametrize("first", NAMES)
def test_a_dead_time_comes_first_and_a_play_last_at_its_site(first: str) -> None:
    effects = [typical(first), typical("torque_delay"), typical("backlash")]
    names = [e.effect.name for e in signal_order(effects)]
    command = [n for n in names if catalogue()[n].site.value == "command"]
    deflection = [n for n in names if catalogue()[n].site.value == "deflection"]
    assert command[0] == "torque_delay"
    assert deflection[-1] == "backlash"
