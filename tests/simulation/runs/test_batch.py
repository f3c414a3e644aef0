"""Many rollouts in one call: each is the single rollout, however many workers there are."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from support.robots.arms import PENDULUM, PLANAR, make, waves

from flexjoint.core.errors import ModelError, SimulationError, UnknownNameError
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.runs import batch
from flexjoint.simulation.runs.batch import Batch, closed_loops, parameter_names, renumbered, rollouts
from flexjoint.simulation.sensors import true_signals

TICKS = 250
MODEL = FlexibleJointModel(
    make(PLANAR, rates={"physics": 1000, "control": 500}), [effect("motor_coulomb_friction", "hip")]
)
LAW = law_of(MODEL.robot)
REFERENCES = {
    "q_ref": waves(2, TICKS, 500.0, 0.4),
    "theta_ref": waves(2, TICKS, 500.0, 0.4),
    "dtheta_ref": np.zeros((TICKS, 2)),
    "tau_ff": np.zeros((TICKS, 2)),
}
PARAMETERS = {
    "drive.knee.stiffness": np.array([420.0, 300.0, 800.0]),
    "motor_coulomb_friction.hip.level": np.array([0.2, 0.0, 1.5]),
}
GAINS = {"kp": np.array([[2600.0, 1500.0], [900.0, 700.0], [2000.0, 1500.0]])}


def loops(kind: Engine, **how: Any) -> Batch:
    options = RunOptions(rate=1000.0, engine=kind)
    return closed_loops(
        MODEL, MODEL.rest(), LAW, REFERENCES, options, parameters=PARAMETERS, gains=GAINS, **how
    )


@pytest.mark.parametrize("kind", ["compiled", "pin"])
def test_each_rollout_is_the_single_one(kind: Engine) -> None:
    many = loops(kind, every=5, workers=1)
    assert many.x.shape == (3, 100, MODEL.nx) and many.tau_m.shape == (3, 100, 2)
    np.testing.assert_allclose(many.time, 5e-3 * np.arange(100), atol=1e-12)
    for k in range(3):
        changes = {name: float(values[k]) for name, values in PARAMETERS.items()}
        model = FlexibleJointModel(*renumbered(MODEL.robot, MODEL.effects, changes))
        law = type(LAW)(GAINS["kp"][k], LAW.kd, LAW.limit)
        tape = closed_loop(model, MODEL.rest(), law, REFERENCES, RunOptions(rate=1000.0, engine="pin"))
        rows = slice(0, 500)
        # as in test_compiled.py: two orders of the same sums, over half a second
        np.testing.assert_allclose(many.state("q.knee")[k], tape.q[rows][::5, 1], atol=1e-9)
        np.testing.assert_allclose(many.tau_m[k], tape.tau_m[rows][::5], atol=1e-7)
        np.testing.assert_allclose(many.final[k][:2], tape.q[-1], atol=1e-9)
        true = true_signals(model, tape)
        tau_t = np.column_stack([true["tau_t", joint][rows] for joint in ("hip", "knee")])
        said = many.summary["tau_t"]
        np.testing.assert_allclose(said.least[k], tau_t.min(0), atol=1e-7)
        np.testing.assert_allclose(said.peak[k], np.abs(tau_t).max(0), atol=1e-7)
        np.testing.assert_allclose(said.mean[k], tau_t.mean(0), atol=1e-7)
        np.testing.assert_allclose(said.rms[k], np.sqrt((tau_t**2).mean(0)), atol=1e-7)
        error = np.repeat(REFERENCES["q_ref"], 2, axis=0) - tape.q[rows]
        np.testing.assert_allclose(many.summary["error"].largest[k], error.max(0), atol=1e-9)
    assert np.all(np.isnan(many.failed_at))


@pytest.mark.parametrize("kind", ["compiled", "pin"])
def test_the_number_of_workers_changes_nothing(kind: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "LONG", 0)  # processes also for so little
    one, two = (loops(kind, every=1, workers=workers) for workers in (1, 2))
    np.testing.assert_array_equal(one.x, two.x)
    for name in batch.SIGNALS:
        np.testing.assert_array_equal(one.summary[name].rms, two.summary[name].rms)


def test_starts_and_torques_may_differ_too() -> None:
    starts = [MODEL.rest(np.array([angle, 0.0])) for angle in (0.1, 0.5)]
    torque = np.stack([waves(2, 200, 1000.0), waves(2, 200, 1000.0, 9.0)])
    many = rollouts(MODEL, starts, torque, RunOptions(rate=1000.0, engine="compiled"), every=1)
    for k in range(2):
        tape = rollout(MODEL, starts[k], torque[k], RunOptions(rate=1000.0, engine="pin"))
        np.testing.assert_allclose(many.x[k, :, :2], tape.q[:-1], atol=1e-9)


def test_memory_is_flat_when_only_summaries_are_asked_for() -> None:
    model = FlexibleJointModel(make(PENDULUM), [effect("sensor_delay", "joint", delay=0.01)])
    law = law_of(model.robot)
    taken = []
    for ticks in (2_000, 40_000):
        table = {name: np.zeros((ticks, 1)) for name in REFERENCES}
        closed_loops(
            model, model.rest(), law, table, RunOptions(rate=1000.0, engine="compiled"), workers=1
        )  # compiles
        tracemalloc.start()
        closed_loops(model, model.rest(), law, table, RunOptions(rate=1000.0, engine="compiled"), workers=1)
        taken.append(tracemalloc.get_traced_memory()[1] - 4 * 8 * ticks)  # less the references, stacked
        tracemalloc.stop()
    # the tape of 40 000 steps would be 2.6 MB
    assert abs(taken[1] - taken[0]) < 50_000


def test_a_rollout_that_fails_is_told_apart() -> None:
    robot = make(PENDULUM, {"joint": {"kp": 100.0, "kd": 0.0, "torque_limit": float("inf")}})
    model = FlexibleJointModel(robot, [])
    table = {name: np.full((3000, 1), 0.1) for name in REFERENCES}
    gains = {"kp": np.array([100.0, 1e9])}
    for kind in ("compiled", "pin"):
        many = closed_loops(
            model,
            model.rest(),
            law_of(robot),
            table,
            RunOptions(rate=1000.0, engine=kind),
            gains=gains,
            workers=1,
        )
        assert np.isnan(many.failed_at[0]) and 0.0 < many.failed_at[1] <= 3.0
        assert np.all(np.isfinite(many.final[0]))


def test_what_does_not_fit_is_refused() -> None:
    torque = np.zeros((10, 2))
    with pytest.raises(UnknownNameError, match=r"drive\.hip\.stiffness"):
        rollouts(MODEL, MODEL.rest(), torque, RunOptions(rate=1000.0), parameters={"stiffness": np.ones(2)})
    with pytest.raises(ModelError, match=r"drive\.hip\.stiffness: expected a number > 0 N m/rad, got -1"):
        rollouts(
            MODEL,
            MODEL.rest(),
            torque,
            RunOptions(rate=1000.0),
            parameters={"drive.hip.stiffness": -np.ones(2)},
        )
    with pytest.raises(ModelError, match="level: expected a number in"):
        rollouts(
            MODEL,
            MODEL.rest(),
            torque,
            RunOptions(rate=1000.0),
            parameters={"motor_coulomb_friction.hip.level": -np.ones(2)},
        )
    with pytest.raises(SimulationError, match=r"drive\.hip\.stiffness 2, starts 3"):
        rollouts(
            MODEL,
            [MODEL.rest()] * 3,
            torque,
            RunOptions(rate=1000.0),
            parameters={"drive.hip.stiffness": np.ones(2)},
        )
    with pytest.raises(SimulationError, match=r"\(B, N, 2\)"):
        rollouts(MODEL, MODEL.rest(), np.zeros((10, 3)), RunOptions(rate=1000.0))
    with pytest.raises(SimulationError, match="every"):
        rollouts(MODEL, MODEL.rest(), torque, RunOptions(rate=1000.0), every=0)
    with pytest.raises(SimulationError, match="workers"):
        rollouts(MODEL, MODEL.rest(), torque, RunOptions(rate=1000.0), workers=0)
    with pytest.raises(UnknownNameError, match="kd, kp, limit"):
        closed_loops(MODEL, MODEL.rest(), LAW, REFERENCES, RunOptions(rate=1000.0), gains={"ki": np.ones(2)})
    with pytest.raises(SimulationError, match="references: expected"):
        closed_loops(
            MODEL, MODEL.rest(), LAW, {**REFERENCES, "theta_ref": np.zeros((3, 2))}, RunOptions(rate=1000.0)
        )
    assert parameter_names(MODEL)[:2] == ("motor_coulomb_friction.hip.level", "drive.hip.stiffness")


@pytest.mark.parametrize("kind", ["compiled", "pin"])
def test_a_batch_tells_how_far_it_is(kind: Engine) -> None:
    """After each rollout, or after those that ran side by side."""
    for workers in (1, 2):
        shares: list[tuple[float, str]] = []

        def note(share: float, what: str, into: list[tuple[float, str]] = shares) -> None:
            into.append((share, what))

        loops(kind, workers=workers, progress=note)
        assert {what for _, what in shares} == {"rollouts"}
        told = [share for share, _ in shares]
        assert told == sorted(told) and told[-1] == 1.0
