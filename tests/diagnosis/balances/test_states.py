"""Internal states along a recording, against a solver with a tight tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from flexjoint.core.ops import Value
from flexjoint.diagnosis.balances.states import play, state_along, stepped
from flexjoint.effects import Planned, Signals, catalogue

PERIOD = 1e-3
STATEFUL = [name for name, effect in catalogue().items() if effect.states]


def motion(t: Value) -> Signals:
    """A joint that turns and twists, smoothly; where it stands still, it does so for a moment only."""
    dtheta, dphi = 0.8 * np.cos(3.0 * t) - 0.5 * np.sin(5.0 * t), 0.03 * np.cos(4.0 * t)
    return Signals(
        t=t,
        dq=dtheta - dphi,
        dtheta=dtheta,
        phi=0.0075 * np.sin(4.0 * t),
        dphi=dphi,
        tau_m=9.0 * np.cos(6.0 * t),
    )


@pytest.mark.parametrize("since", [None, 0.5], ids=["always", "late"])
@pytest.mark.parametrize("name", STATEFUL)
def test_a_state_is_that_of_a_solver(name: str, since: float | None) -> None:
    """At rest until the effect sets in, but for one that follows its signals."""
    wide = {"scale": 0.03} if "scale" in {p.name for p in catalogue()[name].params} else {}
    item = replace(Planned.of(name, "joint", wide), since=since)
    effect, p, t = item.effect, item.p, np.arange(0.0, 1.5, PERIOD)
    begin = 0.0 if since is None or effect.overrides("steady_state") else since
    start = float(effect.steady_state(motion(0.0), p))
    later = t[t >= begin]
    exact = solve_ivp(
        lambda at, z: np.ravel(effect.rate(motion(at), p, z)),
        (begin, t[-1]),
        [start],
        t_eval=later,
        rtol=1e-10,
        atol=1e-13,
        max_step=1e-3,
    ).y[0]
    z = state_along(item, motion(t), PERIOD, 0)
    np.testing.assert_array_equal(z[t < begin], start)
    # order 2 in the period: (0.001 / 0.005 of the fastest of these, squared, times a twelfth)
    np.testing.assert_allclose(z[t >= begin], exact, atol=2e-3 * np.ptp(exact))


@pytest.mark.parametrize("count", [1, 2, 16, 17, 1000])
def test_a_recursion_in_blocks_is_that_step_by_step(count: int) -> None:
    rng = np.random.default_rng(count)
    keep, add = rng.choice([0.0, 0.3, 0.999, 1.0], count), rng.normal(size=count)
    z = [0.7]
    for k, a in zip(keep[:-1], add[:-1], strict=True):
        z.append(k * z[-1] + a)
    # rounding of a thousand steps that keep what they have
    np.testing.assert_allclose(stepped(0.7, keep, add), z, rtol=0.0, atol=1e-12 * max(1.0, np.max(np.abs(z))))


@pytest.mark.parametrize("count", [1, 2, 16, 17, 1000])
def test_a_play_in_blocks_is_that_step_by_step(count: int) -> None:
    rng = np.random.default_rng(count)
    x, width = np.cumsum(rng.normal(size=count)), rng.uniform(0.0, 3.0, count)
    here, there = x[0], []
    for place, half in zip(x, width, strict=True):
        here = min(max(here, place - half), place + half)
        there.append(here)
    np.testing.assert_array_equal(play(x, width), there)


def test_noise_within_a_play_makes_no_way() -> None:
    t = np.arange(0.0, 4.0, PERIOD)
    noise = 1e-5 * np.random.default_rng(1).uniform(-1.0, 1.0, t.size)
    turns = np.where(t < 1.0, 0.2 * t, 0.2)  # and stands
    behind = play(turns + noise, np.full(t.size, 2e-5))
    assert np.sum(np.abs(np.diff(turns + noise))) > 0.2 + 0.01
    assert np.sum(np.abs(np.diff(behind))) == pytest.approx(0.2, abs=1e-4)
    np.testing.assert_array_equal(play(turns, 0.0 * t), turns)
