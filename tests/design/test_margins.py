"""Margins against closed forms, against python-control, and against what they promise."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from flexjoint.design.feedback import Gains, close_loop
from flexjoint.design.linear_model import LinearModel
from flexjoint.design.margins import disk_gain, disk_margin, is_stable, margins, smallest_damping


def plant(system: control.StateSpace) -> LinearModel:
    """A python-control system with outputs y.a, y.b ... for inputs tau_m.a, tau_m.b ..."""
    letters = "abcdef"
    n, inputs, outputs = system.nstates, system.ninputs, system.noutputs
    return LinearModel(
        A=system.A,
        B=system.B,
        C=system.C,
        D=system.D,
        states=tuple(f"x{k}" for k in range(n)),
        inputs=tuple(f"tau_m.{letters[k]}" for k in range(inputs)),
        outputs=tuple(f"y.{letters[k]}" for k in range(outputs)),
        input_delay=np.zeros(inputs),
        output_delay=np.zeros(outputs),
        drift=np.zeros(n),
        dt=system.dt or None,
    )


def unit(model: LinearModel, gain: float | np.ndarray = 1.0) -> Gains:
    return Gains(gain * np.eye(len(model.inputs)), model.outputs, model.inputs)


THIRD = control.ss(control.tf([1.0], [1.0, 3.0, 2.0, 0.0]))  # 1 / (s (s + 1) (s + 2))


@pytest.mark.parametrize("gain", [0.5, 2.0, 5.0])
def test_a_textbook_loop(gain: float) -> None:
    """k / (s (s+1) (s+2)) is stable up to k = 6, which it reaches at sqrt(2) rad/s."""
    model = plant(THIRD)
    found = margins(model, unit(model, gain)).loops[0]
    assert found.gain_up == pytest.approx(6.0 / gain, rel=1e-8) and found.gain_down == 0.0
    phase = control.margin(gain * THIRD)[1]
    assert found.phase == pytest.approx(phase, rel=1e-6)
    w = control.margin(gain * THIRD)[3]
    assert found.crossover == pytest.approx(w / (2 * math.pi), rel=1e-6)
    assert found.delay == pytest.approx(math.radians(phase) / w, rel=1e-6)


@pytest.mark.skipif(
    not hasattr(control, "disk_margins"),
    reason="disk_margins, the reference here, came with python-control 0.10.2",
)
def test_disk_margins_of_one_loop() -> None:
    model = plant(THIRD)
    omega = np.geomspace(1e-2, 1e2, 20001)
    theirs = control.disk_margins(2.0 * THIRD, omega)[0]
    # theirs is the smallest on a grid of 0.05 % spacing
    assert disk_margin(model, unit(model, 2.0)) == pytest.approx(theirs, rel=1e-5)
    assert margins(model, unit(model, 2.0)).loops[0].disk == pytest.approx(theirs, rel=1e-5)


def test_a_conditionally_stable_loop_has_a_margin_downwards() -> None:
    """k / (s - 1) needs k > 1: (s - 1 + k)."""
    model = plant(control.ss(control.tf([1.0], [1.0, -1.0])))
    found = margins(model, unit(model, 4.0))
    assert found.stable and found.loops[0].gain_down == pytest.approx(0.25, rel=1e-9)
    assert math.isinf(found.loops[0].gain_up)
    unstable = margins(model, unit(model, 0.5))
    assert "UNSTABLE" in str(unstable) and "UNSTABLE" not in str(found)
    assert not unstable.stable and unstable.disk == 0.0 and unstable.loops[0].delay == 0.0


def test_the_delay_margin_is_where_delay_destabilises() -> None:
    model = plant(THIRD)
    gains = unit(model, 2.0)
    delay = margins(model, gains).loops[0].delay
    for share, stable in ((0.98, True), (1.02, False)):
        # the hold costs 1.25 ms of 0.6 s
        late = replace(model, input_delay=np.array([share * delay])).sampled(400.0)
        assert is_stable(close_loop(late, gains)) == stable


def test_margins_of_a_sampled_loop() -> None:
    """z-plane: k / (z - 1) is stable for 0 < k < 2."""
    model = plant(control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.01))
    found = margins(model, unit(model, 0.5))
    assert found.loops[0].gain_up == pytest.approx(4.0, rel=1e-6)
    assert found.damping == pytest.approx(1.0)


def test_loops_that_do_not_interact_have_the_margin_of_the_worst() -> None:
    first, second = plant(THIRD), plant(2.0 * THIRD)
    both = plant(control.append(THIRD, 2.0 * THIRD))
    alone = [margins(model, unit(model, 1.5)) for model in (first, second)]
    together = margins(both, unit(both, 1.5))
    assert together.disk == pytest.approx(min(m.disk for m in alone), rel=1e-6)
    for k in range(2):
        assert together.loops[k].gain_up == pytest.approx(alone[k].loops[0].gain_up, rel=1e-8)
    # a one-way coupling closes no loop, however strong: scaling sees that, the plain norm does not
    coupled = replace(both, C=both.C + np.array([[0.0], [30.0]]) @ both.C[[0]])
    assert together.disk == pytest.approx(disk_margin(coupled, unit(coupled, 1.5)), rel=0.05)


def test_what_lies_inside_the_disk_is_stable() -> None:
    """Seeded gains and phases within the MIMO disk margin, of both loops at once and apart, on a coupled
    plant; and there is one not far outside that is not stable."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(4, 4)) - 2.5 * np.eye(4)
    model = plant(control.ss(A, rng.normal(size=(4, 2)), rng.normal(size=(2, 4)), np.zeros((2, 2))))
    gains = unit(model, 0.8)
    found = margins(model, gains)
    assert found.stable and 0.0 < found.disk < 2.0
    low, high = found.disk_gain
    assert (low, high) == disk_gain(found.disk) and low * high == pytest.approx(1.0)
    for factors in rng.uniform(low, high, (400, 2)):
        assert is_stable(close_loop(model, Gains(0.8 * np.diag(factors), model.outputs, model.inputs)))
    for loop in found.loops:
        assert loop.gain_up >= high * (1.0 - 1e-9) and loop.phase >= found.disk_phase * (1.0 - 1e-9)
        assert loop.disk >= found.disk * (1.0 - 1e-6)


def test_damping_of_sampled_poles_is_that_of_the_continuous_ones() -> None:
    model = plant(control.ss(control.tf([1.0], [1.0, 2 * 0.3 * 7.0, 49.0])))
    assert smallest_damping(model) == pytest.approx(0.3)
    assert smallest_damping(model.sampled(100.0)) == pytest.approx(0.3)
