"""Learned laws of every signal: the spline, its slope, its ends, and one simulation in every engine."""

from itertools import chain

import numpy as np
import pytest
from scipy.interpolate import BSpline

import flexjoint as fj
from flexjoint.effects import Planned, Signals, catalogue, effect
from flexjoint.simulation.options import RunOptions

LAWS = [
    (e.name, signal)
    for e in catalogue().values()
    if not e.is_cause and len(e.words) == 1
    for signal in e.words[0].choices
]
C = tuple(np.random.default_rng(5).normal(size=12))


def planned(name: str, signal: str, joint: str = "joint2", scale: float = 0.1) -> Planned:
    size = catalogue()[name].nulls[0].name
    values = tuple(scale * c for c in C)
    return effect(name, joint, **{size: values, "start": -0.7, "span": 1.9, "signal": signal})


def value(law: Planned, x: np.ndarray, signal: str) -> np.ndarray:
    s = Signals(**{signal: x})
    if law.effect.name == "learned_deflection":
        return law.effect.map(s, law.p, s.phi) - s.phi
    return law.effect.torque(s, law.p, 0.0)


@pytest.mark.parametrize(("name", "signal"), LAWS)
def test_each_is_the_spline_of_its_signal_and_constant_beyond(name: str, signal: str) -> None:
    x = np.linspace(-2.0, 2.5, 400)
    knots = -0.7 + 1.9 / 9.0 * np.arange(-3, 13)
    expected = BSpline(knots, 0.1 * np.array(C), 3)(np.clip(x, -0.7, 1.2))
    np.testing.assert_allclose(value(planned(name, signal), x, signal), expected, rtol=1e-10, atol=1e-12)


def test_the_slope_of_a_deflection_of_itself_is_its_derivative() -> None:
    law = planned("learned_deflection", "phi")
    x, step = np.linspace(-1.0, 1.5, 301) + 1e-3, 1e-6  # no sample within a step of a kink at an end
    up, down = (law.effect.map(Signals(phi=x + d), law.p, x + d) for d in (step, -step))
    # the third derivative is of order 12 max|c| / h^3, times step^2
    np.testing.assert_allclose(law.effect.slope(Signals(phi=x), law.p), (up - down) / (2 * step), atol=1e-6)


# ------------------------------------------------------------------ of two signals
def surface(torques: np.ndarray, signal: str = "theta", other: str = "tau_m") -> Planned:
    ranges = {"start": -0.7, "span": 1.9, "other_start": -20.0, "other_span": 50.0}
    return effect(
        "learned_surface", "joint2", torques=tuple(torques.ravel()), signal=signal, other=other, **ranges
    )


def test_a_law_of_two_signals_is_a_product_of_splines() -> None:
    rng = np.random.default_rng(3)
    c = rng.normal(size=(6, 6))
    x, y = rng.uniform(-1.5, 2.0, 300), rng.uniform(-40.0, 50.0, 300)
    law = surface(c)
    inside = np.clip(x, -0.7, 1.2), np.clip(y, -20.0, 30.0)
    bases = [
        BSpline.design_matrix(at, low + width / 3.0 * np.arange(-3, 7), 3).toarray()
        for at, low, width in ((inside[0], -0.7, 1.9), (inside[1], -20.0, 50.0))
    ]
    expected = np.einsum("ni,ij,nj->n", bases[0], c, bases[1])
    value = law.effect.torque(Signals(theta=x, tau_m=y), law.p, 0.0)
    np.testing.assert_allclose(value, expected, rtol=1e-10, atol=1e-12)


def test_a_sum_of_two_laws_is_one_of_two_signals() -> None:
    rng = np.random.default_rng(4)
    of_x, of_y = rng.normal(size=(2, 6))
    x, y = rng.uniform(-0.7, 1.2, 200), rng.uniform(-20.0, 30.0, 200)

    def value(c: np.ndarray) -> np.ndarray:
        law = surface(c)
        return np.asarray(law.effect.torque(Signals(theta=x, tau_m=y), law.p, 0.0))

    ones = np.ones(6)
    both = value(of_x[:, None] + of_y)
    np.testing.assert_allclose(both, value(np.outer(of_x, ones)) + value(np.outer(ones, of_y)), atol=1e-12)
    at_zero = surface(np.outer(of_x, ones))
    alone = at_zero.effect.torque(Signals(theta=x, tau_m=0.0 * y), at_zero.p, 0.0)
    np.testing.assert_allclose(value(np.outer(of_x, ones)), alone, atol=1e-12)  # of x alone


def test_the_compiled_simulation_of_a_law_of_two_signals_is_that_in_python() -> None:
    same_in_both_engines(surface(0.5 * np.random.default_rng(6).normal(size=(6, 6))))


@pytest.mark.parametrize(("name", "signal"), LAWS)
def test_the_compiled_simulation_is_that_in_python(name: str, signal: str) -> None:
    scale = 2e-3 if name == "learned_deflection" else 0.5
    same_in_both_engines(planned(name, signal, scale=scale))


def same_in_both_engines(law: Planned) -> None:
    robot = fj.load_robot("rrbot")
    model = fj.FlexibleJointModel(robot.extended([law]))
    time = np.linspace(0.0, 0.3, 151)
    reference = fj.make_recording(
        time, {("q_ref", joint): 0.5 * np.sin(9.0 * time) for joint in robot.joint_names}
    )
    runs = [fj.simulate(model, reference, RunOptions(engine=e)).measured for e in ("pin", "compiled")]
    without = fj.simulate(fj.FlexibleJointModel(robot), reference, RunOptions(engine="pin")).measured
    for key in chain(without.columns):
        np.testing.assert_allclose(runs[0].columns[key], runs[1].columns[key], rtol=1e-7, atol=1e-9)
    moved = np.max(np.abs(runs[0].get("q", "joint2") - without.get("q", "joint2")))
    assert moved > 1e-5  # [rad]: it is at work
