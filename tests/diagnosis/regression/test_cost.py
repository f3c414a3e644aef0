"""What makes the diagnosis fast changes nothing: processes, memory, triangular whitening, shared numbers."""

from __future__ import annotations

import json
import sys
from functools import cache

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances import balances, chain, laws
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression import problem as problems
from flexjoint.diagnosis.regression import whitening
from flexjoint.diagnosis.regression.deviations import judged_energy
from flexjoint.diagnosis.regression.fit import Fit, covariance, fit
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.regression.shared_numbers import SharedNumbers
from flexjoint.diagnosis.result import to_json
from flexjoint.diagnosis.search import scan
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates, may_replace
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import Search
from flexjoint.effects import Site, catalogue, effect

fitting = sys.modules["flexjoint.diagnosis.regression.fit"]
GAP = Planted("backlash", "elbow", {"gap": 0.009})
KEPT = ("backlash", "cogging", "link_coulomb_friction", "payload", "base_tilt", "sensor_delay")


@cache
def problem(seed: int = 41) -> Problem:
    recording = as_recording(Case("crane", "rich", seed).with_causes(GAP)).between(0.0, 5.0)
    return Problem(balances_of(nominal("crane"), recording))


def scanned(workers: int, current: Fit) -> list[tuple[object, ...]]:
    candidates = [c for c in enumerate_candidates(problem()) if c.effect.name in KEPT]
    scanner = Scanner(candidates)
    with worker_pool(
        [*problem().shared(), *catalogue().values(), *candidates, scanner], workers
    ) as processes:
        assert processes.size == workers
        # twice: the second scan takes what the first remembered
        found = [*scanner.scan(current, processes), *scanner.scan(current, processes)]
    return [(s.candidate, s.amplitude.tolist(), s.removes, s.since, s.sight) for s in found]


@thorough
def test_any_number_of_processes_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    current = fit(problem(), [effect("motor_coulomb_friction", "elbow", level=0.3)])
    alone = scanned(1, current)
    assert scanned(2, current) == alone == scanned(5, current)
    # and so does a scan that may remember nothing, and a chain that is made anew each time
    monkeypatch.setattr(scan, "MEMORY", 0.0)
    monkeypatch.setattr(chain, "REMEMBERED", 0.0)
    monkeypatch.setattr(laws, "CORRECTED", 0.0)
    monkeypatch.setattr(balances, "REMEMBERED", 0.0)
    assert scanned(2, current) == alone


@thorough
def test_a_search_is_the_same_for_any_number_of_processes() -> None:
    recording = as_recording(Case("crane", "rich", 41).with_causes(GAP)).between(0.0, 6.0)
    one, three = (json.dumps(to_json(diagnose(nominal("crane"), [recording], workers=n))) for n in (1, 3))
    assert one == three
    assert '"backlash"' in one


def test_fits_of_one_set_are_scanned_together_as_alone() -> None:
    noisy = problem().at(NoiseLevel(np.full(6, 50.0)))
    effects = [effect("motor_coulomb_friction", "elbow", level=0.3)]
    for set_of in ([], effects):  # with an effect, traces of its joint are not shared
        fits = [fit(problem(), set_of), fit(noisy, set_of)]
        scanner = Scanner([c for c in enumerate_candidates(problem()) if c.effect.name in KEPT])
        together, alone = scanner.scans(fits), [scanner.scan(one) for one in fits]
        for a, b in zip(together, alone, strict=True):
            assert [s.candidate for s in a] == [s.candidate for s in b]
            # sums of some 7000 products, in batches of other sizes
            assert [s.removes for s in a] == pytest.approx([s.removes for s in b], rel=1e-8, abs=1e-6)


def test_what_is_remembered_changes_no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = [effect("motor_coulomb_friction", "elbow", level=0.3), effect("cogging", "shoulder")]
    fitted = [fit(fresh, effects) for fresh in (problem.__wrapped__(), problem())]
    monkeypatch.setattr(problems, "REMEMBERED", 0.0)
    fitted += [fit(fresh, effects) for fresh in (problem.__wrapped__(), problem())]
    assert len({(f.energy, *(slot.get(f.effects) for slot in f.slots)) for f in fitted}) == 1


def test_a_change_of_the_bodies_torques_is_remembered_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a joint's late encoder does to all joints, beside what differs at another one, and alone."""
    late = [effect("sensor_delay", "shoulder", delay=2e-3, channel="q")]
    rubs = [*late, effect("motor_coulomb_friction", "elbow", level=0.3)]
    torques = [problem.__wrapped__().balances.change(*pair) for pair in ((late, rubs), ([], late))]
    monkeypatch.setattr(balances, "REMEMBERED", 0.0)
    monkeypatch.setattr(laws, "CORRECTED", 0.0)
    anew = problem().balances
    assert np.array_equal(torques[1], anew.change([], late))
    assert np.array_equal(torques[0], anew.change(late, rubs))
    elbow = nominal("crane").joint_names.index("elbow")
    assert {anew.rows[r].joint for r in np.flatnonzero(np.any(torques[0], axis=1))} == {elbow}
    assert len({anew.rows[r].joint for r in np.flatnonzero(np.any(torques[1], axis=1))}) > 1


def test_an_energy_is_evaluated_once_and_when_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0

    def counted(*given: object) -> float:
        nonlocal asked
        asked += 1
        return judged_energy(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(fitting, "judged_energy", counted)
    fitted = at_own_level(fit(problem(), THREE))
    assert asked == 0
    judged = judged_energy(fitted.problem, fitted.y, fitted.effects)
    weak = fitting._prior(fitted.problem, fitted.slots, fitted.effects)
    assert 0.0 < weak < 1e-6  # a friction is far smaller than the torques of its joint
    assert [fitted.energy, fitted.energy] == [judged + weak, judged + weak]
    assert asked == 1


THREE = (
    effect("motor_coulomb_friction", "elbow", level=0.3),
    effect("link_viscous_friction", "shoulder", coefficient=0.4),
    effect("backlash", "elbow", gap=0.006),
)


def test_kept_derivatives_lead_to_the_same_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = fit(problem(), THREE)
    point = fitting._Point(list(kept.effects), kept.tangents, [kept.effects] * 3)
    every = np.ones(3, dtype=bool)
    made = len(fitting._followed(kept.problem, kept.effects, kept.slots, point, every).jacobian)
    monkeypatch.setattr(fitting, "NEAR", 0.0)
    anew = fit(problem.__wrapped__(), THREE)
    assert made == len(kept.slots) == 3
    assert kept.energy < fit(problem(), THREE, iterations=0).energy - 1000.0
    # both end where a step gains less than CONVERGED and a millionth
    assert kept.energy == pytest.approx(anew.energy, abs=2.0 * fitting.CONVERGED + 2e-6 * anew.energy)
    error = np.sqrt(np.diag(covariance(anew, np.zeros(anew.y.size, int) + np.arange(anew.y.size) // 100)))
    for slot, std in zip(anew.slots, error, strict=True):
        assert abs(slot.get(kept.effects) - slot.get(anew.effects)) < 0.2 * std


def test_only_derivatives_that_are_wanted_are_followed() -> None:
    kept = fit(problem(), THREE)
    moved = [e.with_values({name: 2.0 * value for name, value in e.values.items()}) for e in kept.effects]
    wanted = np.array([True, False, False])

    point = fitting._Point(list(kept.effects), kept.tangents, [kept.effects] * 3)
    there = fitting._followed(kept.problem, moved, kept.slots, point, wanted)

    changed = [not np.array_equal(a, b) for a, b in zip(there.jacobian, kept.tangents, strict=True)]
    assert changed == [True, False, False]
    assert [at is moved for at in there.taken] == changed
    later = fitting._followed(kept.problem, moved, kept.slots, there, np.ones(3, dtype=bool))
    assert np.array_equal(later.jacobian, fitting.jacobian_of(kept.problem, moved, kept.slots))


def test_a_derivative_depends_on_the_effects_of_its_joint() -> None:
    here = problem()
    slots = fitting.slots_of(THREE)
    for slot in slots:
        low, high = list(THREE), list(THREE)
        step = fitting.step_of(here, slot, THREE)
        slot.put(high, slot.get(THREE) + step)
        whole = here.moved(low, high) / step
        assert np.array_equal(fitting.jacobian_of(here, THREE, [slot])[0], whole)


def test_at_an_optimum_one_step_is_tried() -> None:
    best = fit(problem(), THREE)
    for _ in range(4):
        best = fit(best.problem, best.effects)

    def tried() -> int:
        return sum(key[0] == "residual" for key in best.problem._recent._values)

    before = tried()
    again = fit(best.problem, best.effects)
    assert tried() <= before + 1
    assert again.energy == pytest.approx(best.energy, abs=2.0 * fitting.CONVERGED + 2e-6 * best.energy)


def test_a_trace_on_rounded_numbers_is_hardly_another() -> None:
    there = effect("payload", "elbow", since=2.0, mass=0.31, position=(0.2, 0.0, -0.0007))
    near = scan.rounded(there)
    assert near.since == 2.0 and scan.rounded(near) == near
    for name, value in there.values.items():  # of a vector, by its largest component
        near_by = float(np.max(np.abs(value))) / scan.ROUNDED
        assert near.values[name] == pytest.approx(value, abs=near_by)
    assert near.values["mass"] != there.values["mass"]
    moved = there.with_values({"mass": 0.31 * (1.0 + 1e-5)})
    assert scan.rounded(moved) == near


def test_every_few_samples_tell_what_a_load_does_to_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    load = [effect("payload", "elbow", mass=1.0, position=(0.3, 0.0, 0.0))]
    scale = problem().torque_scale[[row.joint for row in problem().balances.rows]]

    def deviation() -> np.ndarray:
        return whitening.make(problem().balances, scale, load).deviation

    few = deviation()
    monkeypatch.setattr(whitening, "MASSES", 10**9)
    assert few == pytest.approx(deviation(), rel=0.005)
    assert np.max(np.abs(few / problem().whitening.deviation - 1.0)) > 0.05


def test_residuals_are_made_of_what_changes() -> None:
    """Joint by joint against the nominal model's, or all balances at once."""
    here = problem()
    effects = [
        effect("cable_spring", "elbow", stiffness=3.0, rest=0.2),
        effect("link_viscous_friction", "shoulder", coefficient=0.4),
    ]
    whole = here.whitened(here.with_nominal(effects))
    # some thousand noises large, of which rounding leaves 1e-12
    assert here.residual(effects) == pytest.approx(whole, abs=1e-12 * float(np.max(np.abs(whole))) + 1e-9)
    assert np.max(np.abs(here.residual(effects) - here.residual([]))) > 1.0


def test_the_least_recently_used_is_forgotten_first() -> None:
    made: list[str] = []
    recent: LruCache[np.ndarray] = LruCache()

    def get(key: str) -> np.ndarray:
        return recent.get(key, lambda: made.append(key) or np.zeros(10), 160.0)  # room for two

    for key in ("a", "b", "a", "c", "a", "b"):
        get(key)
    assert made == ["a", "b", "c", "b"]


def test_products_are_those_of_weighted_columns() -> None:
    """Against the formula with all columns written out: Q(a, b) = a W b - a W J' (J W J' + 1)^-1 J W b."""
    here = problem().at(NoiseLevel(np.array([1.0, 2.0, 3.0, 1.5, 1.0, 4.0])))
    a = np.random.default_rng(1).standard_normal((3, here.samples))
    weights = np.repeat(1.0 / np.sqrt(here.level.inflation), here.time.size)
    columns, rows = here.J * weights, a * weights
    inner = np.linalg.solve(columns @ columns.T + np.eye(len(columns)), columns @ rows.T)
    # two ways to add up some 7000 products
    assert here.product(a, a) == pytest.approx(rows @ rows.T - rows @ columns.T @ inner, rel=1e-9, abs=1e-9)
    assert here.energy(a[0]) == pytest.approx(here.product(a, a)[0, 0], rel=1e-9)


def test_whitening_uses_all_of_its_matrix() -> None:
    whitening = problem().whitening
    upper = np.triu(np.abs(whitening.matrix[:, :, 5]), 1)
    assert np.max(upper) <= 1e-12 * np.max(np.abs(whitening.matrix))  # what is not applied is not there


def test_shared_numbers_are_paid_for_once() -> None:
    here = problem()
    y = 3.0 * here.J[4]  # what a nominal number off by three deviations leaves
    shared = SharedNumbers([here, here])
    joint = 2.0 * here.energy(y) + shared.surplus([y, y])
    stacked = np.concatenate([here.J, here.J], axis=1)
    pull = np.linalg.solve(stacked @ stacked.T + np.eye(len(stacked)), stacked @ np.concatenate([y, y]))
    rest = np.concatenate([y, y]) - pull @ stacked
    # energies of some 1e4 are told to rounding
    assert joint == pytest.approx(float(rest @ rest + pull @ pull), abs=1e-4)
    assert joint < 1.6 * here.energy(y)  # not twice: 9 against 18 where the number is well seen
    apart = 2.0 * here.energy(y) + shared.surplus([y, -y])
    assert apart > 100.0 * joint  # it cannot be off by both


def marked(candidate: Candidate) -> set[int]:
    """Balances that change with the effect at some small size."""
    sizes = {p.name: (p.null or 0.0) + min(p.step, 0.1) for p in candidate.effect.nulls if p.size == 1}
    there = problem().with_nominal([candidate.planned(sizes)])
    changed = problem().balances.changed(problem().with_nominal([]), there)
    return {row for row, spectrum in changed.items() if np.any(spectrum)}


def test_what_is_not_tried_as_a_rival_shares_no_balance_with_the_cause() -> None:
    candidates = enumerate_candidates(problem())
    marks = {c: marked(c) for c in candidates}
    left_out = 0
    for cause in candidates:
        for other in candidates:
            if (
                not may_replace(other, cause.planned({}), problem().robot.joint_names)
                and other.effect.site is not Site.SENSOR
            ):
                assert not marks[cause] & marks[other], (cause.key, other.key)
                left_out += 1
    assert left_out > 500
    assert sum(bool(rows) for rows in marks.values()) > 0.9 * len(candidates)


def test_with_an_angle_missing_any_joint_may_hold_a_rival() -> None:
    cause = effect("torque_gain", "elbow", gain=0.03)
    joints = {}
    for sensors in ("full", "motor_only"):
        recording = as_recording(Case("crane", "rich", 41, sensors).with_causes(GAP)).between(0.0, 5.0)
        here = Problem(balances_of(nominal("crane"), recording))
        own = [c for c in enumerate_candidates(here) if c.effect.name == "motor_coulomb_friction"]
        scanner = Scanner(own)
        with worker_pool([*here.shared(), *catalogue().values(), *own, scanner], 1) as processes:
            found = Search(scanner, processes).scan(fit(here, []), cause)
        joints[sensors] = {s.candidate.joint for s in found}
    assert joints == {"full": {"elbow"}, "motor_only": {"elbow", "shoulder"}}
