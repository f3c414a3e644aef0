"""A simulation in pieces is the simulation: the same numbers, whatever the size of a piece."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.robots.arms import SPATIAL, make

from flexjoint.core.running.budget import Budget
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.runs.live import KEPT, LiveSimulation
from flexjoint.simulation.runs.pieces import simulated_in_pieces
from flexjoint.simulation.simulate import simulate

LATE = [
    effect("torque_delay", "yaw", delay=3.3e-3),
    effect("sensor_delay", "roll", delay=2e-3, channel="theta"),
    replace(effect("motor_coulomb_friction", "roll", level=2.0), since=0.31),
    effect("spring_hysteresis", "pitch"),
]


def swing(channel: str, seconds: float = 1.0) -> Recording:
    time = np.arange(0.0, seconds, 0.001)
    size = 0.4 if channel == "q_ref" else 5.0
    columns = {(channel, name): size * np.sin((2 + k) * time) for k, (name, *_) in enumerate(SPATIAL)}
    return recording.make(time + 3.0, columns, "swing")


@pytest.mark.parametrize("kind", ["pin", "compiled"])
@pytest.mark.parametrize(("channel", "control"), [("q_ref", 1000), ("q_ref", 300), ("tau_m", 1000)])
def test_pieces_make_the_whole(kind: Engine, channel: str, control: int) -> None:
    model = FlexibleJointModel(make(SPATIAL, rates={"physics": 1000, "control": control}), LATE)
    reference, how = swing(channel), RunOptions(engine=kind)
    whole = simulate(model, reference, how).measured
    pieces = [piece.measured for piece in simulated_in_pieces(model, reference, how, size=130)]
    assert len(pieces) > 5 and all(piece.columns.keys() == whole.columns.keys() for piece in pieces)
    np.testing.assert_array_equal(np.concatenate([piece.time for piece in pieces]), whole.time)
    for key, values in whole.columns.items():
        found = np.concatenate([piece.columns[key] for piece in pieces])
        if channel == "q_ref":
            np.testing.assert_array_equal(found, values, err_msg=str(key))
        else:  # sums of recorded torques begin anew with every piece
            np.testing.assert_allclose(found, values, rtol=1e-9, atol=1e-10, err_msg=str(key))


def test_pieces_are_written_as_one(tmp_path: Path) -> None:
    model = FlexibleJointModel(make(SPATIAL), [])
    whole = simulate(model, swing("q_ref")).measured
    for name in ("run.csv", "run.parquet"):
        pieces = (piece.measured for piece in simulated_in_pieces(model, swing("q_ref"), size=130))
        recording.write_pieces(pieces, tmp_path / name)
        written = recording.read(tmp_path / name)
        assert list(written.columns) == list(whole.columns)
        for key, values in whole.columns.items():
            np.testing.assert_array_equal(written.columns[key], values)


def test_what_fails_on_the_way_leaves_no_file(tmp_path: Path) -> None:
    def pieces():
        yield swing("q_ref")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        recording.write_pieces(pieces(), tmp_path / "run.parquet")
    assert not list(tmp_path.iterdir())


def test_a_budget_ends_it_after_a_piece() -> None:
    model = FlexibleJointModel(make(SPATIAL), [])
    told: list[float] = []
    pieces = list(
        simulated_in_pieces(
            model,
            swing("q_ref"),
            size=100,
            budget=Budget(0.0),
            progress=lambda share, _what: told.append(share),
        )
    )
    assert len(pieces) == 1 and pieces[0].done == pytest.approx(0.1) and told == [pieces[0].done]


def test_a_command_is_held_where_the_rows_behind_are_dropped() -> None:
    """The rows that a live simulation keeps end between two ticks, and no delay keeps one behind."""
    robot = make(SPATIAL, rates={"physics": 3000, "control": 1000})
    model = FlexibleJointModel(robot, [])
    found = []
    for kind in ("pin", "compiled"):
        sim = LiveSimulation(model, RunOptions(engine=kind))  # type: ignore[arg-type]
        sim.command("yaw", position=0.3)
        assert KEPT % 3 != 0
        sim.step(KEPT + 30)
        found.append(sim.full_state.v)
    np.testing.assert_allclose(found[0], found[1], atol=1e-9)
