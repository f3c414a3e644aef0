"""Noise that one encoder makes in several links' balances, where inertias vary along the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planting import FULL, PERFECT, ROBOTS, plant
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import _chance
from flexjoint.effects import Planned
from flexjoint.recording.table import Recording

CYCLES = (300.0, 600.0, 900.0, 1200.0)
RECORDINGS = 10  # of new noise: with four ripples of two numbers each, chi-square scatters by 20 to 25 %


def recorded(robot: str, perfect: bool = False) -> Recording:
    sensors = PERFECT if perfect else replace(FULL, noisy_feedback=False)
    return as_recording(plant(ROBOTS / f"{robot}.yaml", [], "slow", 8.0, 3, sensors))


def ripples(problem: Problem, joint: str) -> list[Fit]:
    """Ripples of an encoder, as they are: the traces of their numbers count."""
    numbers = {"amplitude": 2e-5, "phase": 0.5, "channel": "q"}
    return [
        fit(problem, [Planned.of("encoder_ripple", joint, {**numbers, "cycles": c})], iterations=0)
        for c in CYCLES
    ]


@pytest.mark.parametrize("robot", ["lever", "scara"])
def test_drawn_noise_is_white(robot: str) -> None:
    problem = Problem(balances_of(nominal(robot), recorded(robot)))

    drawn = problem.whitening.drawn.reshape(-1, len(problem.balances.rows), problem.time.size)

    # 24 draws of some hundred samples a balance: the mean square scatters by 5 % at most
    np.testing.assert_allclose(np.mean(drawn**2, axis=(0, 2)), 1.0, atol=0.15)


@pytest.mark.parametrize("robot", ["gimbal", "reach"])
def test_links_that_springs_tell_of_have_the_noise_of_motors_and_springs(robot: str) -> None:
    """Where no sensor reads a link, its angle is that of the motor less the deflection; what the noise of
    both makes of inertias that vary is predicted, too: seven joints would be left at three times the noise.
    """
    whole = as_recording(Case(robot, "rich", 31).with_causes())
    kept = {key: x for key, x in whole.columns.items() if key[0] not in ("q", "dq")}
    problem = Problem(balances_of(nominal(robot), replace(whole, columns=kept)))
    rows, joints = len(problem.balances.rows), len(problem.robot.joints)
    left = problem.residual([]).reshape(rows, -1)[joints:]  # beside the balances that tell where links are

    assert np.max(np.mean(left**2, axis=1)) < 1.3


def test_noise_of_a_single_link_counts_once() -> None:
    problem = Problem(balances_of(nominal("lever"), recorded("lever")))

    factors = [_chance(found, 0.0, found.effects[0]) for found in ripples(problem, "swing")]

    assert np.mean(factors) < 1.2, factors


@thorough
def test_noise_along_a_motion_explains_as_much_as_that_of_new_recordings() -> None:
    """The mass matrix of seven joints varies so much that a ripple of one encoder gains three times by chance
    what white noise would give: drawn as predicted, and in recordings of the same motion with new noise."""
    robot, joint = nominal("reach"), "s1"
    problem = Problem(balances_of(robot, recorded("reach")))
    found = ripples(problem, joint)
    predicted = float(np.mean([_chance(one, 0.0, one.effects[0]) for one in found]))

    clean, rng, gained = recorded("reach", perfect=True), np.random.default_rng(1), []
    noise = {
        key: float(problem.readings.noise[key[0]][robot.joint_names.index(key[1])])
        for key in clean.columns
        if key[0] in ("q", "theta", "tau_t")
    }
    for _ in range(RECORDINGS):
        columns = {
            key: x + noise.get(key, 0.0) * rng.standard_normal(x.size) for key, x in clean.columns.items()
        }
        again = Problem(balances_of(robot, replace(clean, columns=columns)))
        y = again.residual([])
        for one in found:
            traces = np.array(
                [
                    again.residual([one.effects[0].with_values({"phase": phase})]) - y
                    for phase in (0.0, 0.5 * np.pi)
                ]
            )
            normal, slope = again.normal(traces, y)
            gained.append(float(slope @ np.linalg.solve(normal, slope)) / len(slope))

    assert predicted > 2.0
    np.testing.assert_allclose(predicted, np.mean(gained), rtol=0.5)
