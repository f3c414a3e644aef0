"""Two causes of one joint that only together explain it."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from scipy.optimize import minimize
from support.diagnose_cases import as_recording
from support.robots.rigid_lever import rigid_lever

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import Fit, fit, refit_without
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate, Trace, enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.pairs import best_pairs, joint_pairs
from flexjoint.diagnosis.search.rivals import Key
from flexjoint.diagnosis.search.scan import Products, Scanner, bounds_of
from flexjoint.diagnosis.search.selection import select
from flexjoint.diagnosis.search.trials import at_noise
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import catalogue
from flexjoint.robot.robot import load

NOMINAL = 6.0  # N m, Coulomb friction that the model lists


def robot_of(folder: Path, *listed: float) -> Path:
    """The lever of the planting with a rigid joint, whose model lists friction of these levels [N m]."""
    effects = [
        {"effect": "motor_coulomb_friction", "joint": "swing", "level": level, "nominal": True}
        for level in listed
    ]
    return rigid_lever(folder, effects, f"lever_{len(listed)}")


def problem(folder: Path, causes: list[Planted], *listed: float) -> Problem:
    """That of a machine with these causes and no friction else, beside a model that lists some."""
    sensors = SensorSet(channels=("theta", "tau_motor"))
    recorded = plant(robot_of(folder), causes, "rich", 20.0, 5, sensors, rate=250.0)
    return Problem(balances_of(load(robot_of(folder, *listed)), as_recording(recorded)))


def sets(folder: Path, causes: list[Planted], *listed: float) -> list[Fit]:
    """The pairs of a machine with these causes."""
    here = problem(folder, causes, *listed)
    best = at_own_level(fit(here, []))
    bare = at_noise(best)
    assert bare is not None
    with worker_pool([], 1) as pool:
        return joint_pairs(best, bare, ["swing"], Scanner(enumerate_candidates(here)), pool)


def test_two_that_each_leave_something_alone(tmp_path: Path) -> None:
    planted = {
        "torque_offset": {"offset": 2.0},
        "cogging": {"amplitude": 2.4, "cycles": 5.0, "phase": 0.4},
    }
    found = sets(tmp_path, [Planted(name, "swing", values) for name, values in planted.items()])

    assert len(found) == 1
    both = found[0]
    numbers = {e.effect.name: {k: float(v) for k, v in e.values.items()} for e in both.effects}
    assert set(numbers) == set(planted)
    for name, values in planted.items():
        assert numbers[name] == pytest.approx(values, rel=0.01)  # standard errors are near 0.3 %
    for e in both.effects:
        assert refit_without(both, e).energy > 2.0 * both.energy


def test_a_friction_that_falls_below_the_nominal_one(tmp_path: Path) -> None:
    """As the joint warms up: less friction than nominal, and more that fades. What the model lists takes the
    first part with numbers that are implausible, so that this is no pair but is found one by one."""
    planted = {
        "motor_coulomb_friction": {"level": 3.6},
        "friction_drift": {"level": 2.4, "time_constant": 6.0},
    }
    here = problem(tmp_path, [Planted(name, "swing", values) for name, values in planted.items()], NOMINAL)
    best = select(here, enumerate_candidates(here), lambda share, what: None).best
    numbers = {e.effect.name: {k: float(v) for k, v in e.values.items()} for e in best.effects}
    assert set(numbers) == set(planted)
    for name, values in planted.items():
        assert numbers[name] == pytest.approx(values, rel=0.01)  # standard errors are near 0.3 %


def test_one_cause_is_no_pair(tmp_path: Path) -> None:
    assert sets(tmp_path, [Planted("motor_coulomb_friction", "swing", {"level": 3.6})], NOMINAL) == []


def gimbal() -> Problem:
    """That of several flexible joints, whose balances are white beside each other."""
    causes = [Planted("motor_coulomb_friction", "tilt", {"level": 3.0})]
    recorded = plant(ROBOTS / "gimbal.yaml", causes, "rich", 6.0, 5, SensorSet())
    return Problem(balances_of(load(ROBOTS / "gimbal.yaml"), as_recording(recorded)))


@pytest.mark.parametrize("joint", ["swing", "pan", "twist"])
def test_what_single_traces_remove_is_what_the_scan_says(joint: str, tmp_path: Path) -> None:
    causes = [Planted("motor_coulomb_friction", "swing", {"level": 3.6})]
    here = problem(tmp_path, causes, NOMINAL) if joint == "swing" else gimbal()
    current, settings = fit(here, []), here.settings.search
    scanner = Scanner(enumerate_candidates(here))
    products = scanner.products(current, joint)
    scanned = {s.candidate.key: s for s in scanner.scan(current) if s.since is None}
    removes: dict[tuple[str, str | None], float] = {}
    for k in products.visible():
        bounds, place = bounds_of(products.traces[k], settings), products.places[k]
        key = products.traces[k].candidate.key
        own = least(products.curvature[place, place], products.force[place], bounds)
        removes[key] = max(own, removes.get(key, 0.0))
    common = removes.keys() & scanned.keys()
    assert len(common) > 5
    for key in common:
        # the scan's columns are scaled and solved with a ridge of 1e-9
        assert removes[key] == pytest.approx(scanned[key].removes, rel=1e-4, abs=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_the_best_pairs_are_those_of_all_pairs(seed: int) -> None:
    """Against every pair solved within its bounds by another method."""
    rng = np.random.default_rng(seed)
    names = ["torque_offset", "torque_gain", "motor_coulomb_friction", "cogging", "asymmetric_friction"]
    traces, places, start = [], [], 0
    for name in [*names, *rng.choice(names, 4)]:
        effect = catalogue()[name]
        kind, width = ("phase", 2) if name == "cogging" else ("amplitudes", len(effect.nulls))
        trial = {p.name: float(rng.uniform(0.5, 2.0)) for p in effect.nulls[:width]}
        origin = {p.name: float(p.null or 0.0) for p in effect.nulls}
        traces.append(Trace(Candidate(effect, "swing"), {}, (), None, kind, trial, origin))
        places.append(slice(start, start + width))
        start += width
    columns = rng.standard_normal((start, 12))
    gram, force = columns @ columns.T, columns @ rng.standard_normal(12)
    products = Products(tuple(traces), tuple(places), gram, force, np.diag(gram))

    best: dict[frozenset[Key], float] = {}
    for i, j in itertools.combinations(range(len(traces)), 2):
        keys = frozenset((traces[i].candidate.key, traces[j].candidate.key))
        if len(keys) == 2:
            at = [*range(start)[places[i]], *range(start)[places[j]]]
            bounds = np.hstack([bounds_of(traces[k], USUAL.search) for k in (i, j)])
            gain = least(products.curvature[np.ix_(at, at)], products.force[at], bounds)
            best[keys] = max(gain, best.get(keys, 0.0))
    expected = sorted(best.items(), key=lambda one: -one[1])[:3]

    found = best_pairs(products, 3, USUAL.search)
    assert [pair.keys for pair in found] == [keys for keys, _ in expected]
    assert [pair.removes for pair in found] == pytest.approx([gain for _, gain in expected], rel=1e-5)


def least(curvature: np.ndarray, force: np.ndarray, bounds: np.ndarray) -> float:
    """Energy that amplitudes within bounds remove."""
    size = np.sqrt(np.diag(curvature))
    scaled, pull = curvature / np.outer(size, size), force / size
    found = minimize(
        lambda x: (x @ scaled @ x + 2.0 * pull @ x, 2.0 * (scaled @ x + pull)),
        np.clip(np.zeros(len(size)), *(bounds * size)),
        jac=True,
        bounds=list((bounds * size).T),
        options={"ftol": 1e-15, "gtol": 1e-12, "maxiter": 10000},
    )
    return -float(found.fun)
