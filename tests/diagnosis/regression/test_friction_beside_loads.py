"""Dry friction of a rigid arm holds the load of its links at rest, a payload's too: what a change of it does
is taken beside that payload, and so is what any change on its joint does."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from planting import ROBOTS, Planted, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording
from support.thorough import thorough

from flexjoint.core.running.worker_pool import worker_pool
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import converged_deviations
from flexjoint.diagnosis.regression.fit import Fit, Slot, _column, fit, slots_of
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search import criteria, selection
from flexjoint.diagnosis.search.candidates import Candidate, enumerate_candidates
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.selection import with_ordinary
from flexjoint.diagnosis.search.trials import at_noise, clearing, might_clear
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.robot.robot import load

DRAG = "quadratic_drag"
MOTOR = SensorSet(channels=("theta", "tau_motor"))
FRICTION = {"shoulder": 9.0, "elbow": 5.0}  # N m: more than the payload's weight, which it holds at rest
PLANTED = [
    Planted("payload", "elbow", {"mass": 0.7, "position": [0.02, 0.0, -0.4]}),
    *(Planted("motor_coulomb_friction", joint, {"level": level}) for joint, level in FRICTION.items()),
]
ASSUMED = [
    effect("payload", "elbow", mass=0.7, position=(0.02, 0.0, -0.4)),
    *(effect("motor_coulomb_friction", joint, level=level) for joint, level in FRICTION.items()),
]


@cache
def problem(damping: float = 0.0) -> Problem:
    """The crane with rigid joints and that nominal damping, 20 s of motion with stops."""
    return made(PLANTED, damping)


def made(planted: list[Planted], damping: float) -> Problem:
    data = yaml.safe_load((ROBOTS / "crane.yaml").read_text())
    for joint in data["joints"].values():
        joint |= {
            "stiffness": float("inf"),
            "damping": 0.0,
            "motor_damping": damping,
            "kp": 900.0,
            "kd": 40.0,
        }
    with TemporaryDirectory() as folder:
        shutil.copyfile(ROBOTS / "crane.urdf", Path(folder) / "crane.urdf")
        path = Path(folder) / "crane_rigid.yaml"
        path.write_text(yaml.safe_dump(data, sort_keys=False))
        recorded = as_recording(plant(path, planted, "rich", 20.0, 3, MOTOR, rate=250.0))
        return Problem(balances_of(load(path), recorded))


@cache
def stribeck_problem() -> Problem:
    """The same with Stribeck friction on the shoulder alone."""
    planted = [
        Planted("stribeck_friction", "shoulder", {"level": 6.0, "static_extra": 3.0, "velocity": 0.08})
    ]
    return made(planted, 0.0)


def of_level(effects: list[Planned], joint: str) -> Slot:
    return next(
        slot for slot in slots_of(effects) if effects[slot.effect].key == ("motor_coulomb_friction", joint)
    )


@pytest.mark.parametrize("joint", list(FRICTION))
def test_the_derivative_by_a_level_is_that_of_the_whole_residual(joint: str) -> None:
    here, effects = problem(), list(ASSUMED)
    slot = of_level(effects, joint)
    step = 1e-3 * slot.get(effects)
    moved = list(effects)
    slot.put(moved, slot.get(effects) + step)

    by_level = _column(here, effects, slot)
    whole = (here.residual(moved) - here.residual(effects)) / step

    assert np.linalg.norm(whole) > 100.0
    # without the payload the friction would hold another torque at rest
    assert np.linalg.norm(by_level - whole) < 1e-6 * np.linalg.norm(whole)


@pytest.mark.parametrize("name, component", [("mass", 0), ("position", 1), ("position", 2)])
def test_the_derivative_by_a_load_is_that_of_the_whole_residual(name: str, component: int) -> None:
    """What sticks still does, and carries the load: only where a joint begins to slip is more left out."""
    here, effects = problem(), list(ASSUMED)
    slot = next(s for s in slots_of(effects) if (s.param.name, s.component) == (name, component))
    moved = list(effects)
    slot.put(moved, slot.get(effects) + 1e-4)

    by_load = _column(here, effects, slot)
    whole = (here.residual(moved) - here.residual(effects)) / 1e-4
    free = (here.residual(moved[:1]) - here.residual(effects[:1])) / 1e-4  # nothing sticks

    assert np.linalg.norm(whole) > 100.0
    assert np.linalg.norm(by_load - whole) < 0.1 * np.linalg.norm(whole)
    assert np.linalg.norm(free - whole) > 2.0 * np.linalg.norm(by_load - whole)


@thorough
@pytest.mark.parametrize(
    "added, number",
    [
        (effect("motor_viscous_friction", "shoulder", coefficient=2.0), "coefficient"),
        (effect("cogging", "shoulder", amplitude=2.0, cycles=30.0, phase=0.4), "phase"),
        (effect("cable_spring", "elbow", stiffness=3.0), "stiffness"),
    ],
    ids=lambda x: x.effect.name if isinstance(x, Planned) else x,
)
def test_the_derivative_by_a_torque_beside_a_friction_is_that_of_the_whole_residual(
    added: Planned, number: str
) -> None:
    """What sticks still does, and carries the torque, too. Where a joint begins to slip is more of a spring's
    torque, which is largest there: 0.18 of it."""
    here, effects = problem(), [*ASSUMED, added]
    slot = next(s for s in slots_of(effects) if effects[s.effect] is added and s.param.name == number)
    moved, alone, alone_moved = list(effects), [added], [added]
    slot.put(moved, slot.get(effects) + 1e-3)
    alone_moved[0] = moved[-1]

    column = _column(here, effects, slot)
    whole = (here.residual(moved) - here.residual(effects)) / 1e-3
    free = (here.residual(alone_moved) - here.residual(alone)) / 1e-3  # nothing sticks

    assert np.linalg.norm(whole) > 10.0
    assert np.linalg.norm(column - whole) < 0.2 * np.linalg.norm(whole)
    assert np.linalg.norm(free - whole) > 2.0 * np.linalg.norm(column - whole)


def test_deviations_that_gain_no_more_are_not_sought_any_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a friction that sticks each evaluation takes the frictions of all joints anew, and the energy
    is not smooth in steps that gain less than its tolerance."""
    here = problem()
    here, y = here.at(here.plausible_level(here.residual(ASSUMED))), here.residual(ASSUMED)
    evaluated: list[Sequence[Planned]] = []
    residual = Problem.residual

    def counted(self: Problem, extra: Sequence[Planned]) -> np.ndarray:
        evaluated.append(extra)
        return residual(self, extra)

    monkeypatch.setattr(Problem, "residual", counted)
    converged_deviations(here, ASSUMED, y)

    assert 1 <= len(evaluated) <= 6


def test_supported_effects_are_not_asked_again_when_one_of_another_joint_is_dropped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = problem()
    needless = [effect(DRAG, joint, coefficient=1e-6) for joint in FRICTION]
    best = fit(here, [*ASSUMED[1:], *needless])
    asked: list[tuple[str, str | None]] = []

    def answer(task: tuple[Fit, Planned]) -> Fit | None:
        result, dropped = task
        asked.append(dropped.key)
        if dropped.effect.name != DRAG:
            return None
        return fit(here, [e for e in result.effects if e is not dropped])

    monkeypatch.setattr(selection, "_without_unsupported", answer)
    with worker_pool([], 1) as pool:
        left = selection.prune(best, pool)
    assert {e.key for e in left.effects} == {e.key for e in ASSUMED[1:]}
    # each friction is asked before the drag on its joint is gone, and once more after
    assert {key: asked.count(key) for key in (e.key for e in ASSUMED[1:])} == dict.fromkeys(
        (e.key for e in ASSUMED[1:]), 2
    )


@pytest.mark.parametrize("joint", list(FRICTION))
def test_a_scan_sees_what_friction_explains_beside_a_payload(joint: str) -> None:
    best = fit(problem(), ASSUMED)
    others = [e for e in best.effects if e.key != ("motor_coulomb_friction", joint)]
    without = fit(best.problem, others, held=others)
    law = Candidate(catalogue()["motor_coulomb_friction"], joint)

    (scored,) = Scanner([law]).scan(without)

    # numbers of the others may make up for some of it, which the scan allows for
    free = fit(best.problem, others)
    assert scored.removes > 0.75 * (free.energy - best.energy)
    assert scored.planned().values["level"] == pytest.approx(FRICTION[joint], rel=0.25)


def test_a_damping_that_the_model_has_not_is_no_nominal_number() -> None:
    """A share of nothing is nothing: such a number explains nothing, and a friction is not a change of it."""
    viscous = effect("motor_viscous_friction", "elbow", coefficient=2.0)

    assert criteria.own_number(problem(), viscous) is None
    assert criteria.own_number(problem(3.0), viscous) is not None


def test_friction_of_two_joints_is_no_shaft_that_both_share() -> None:
    here = problem()
    payload = ASSUMED[0]
    shared = effect("coupled_friction", "elbow", level=5.0, coefficient=0.1, speed="sum")
    trial = fit(here, [payload, shared])

    assert criteria.stands_in(trial, trial.effects[-1])
    assert not criteria.supported(trial, fit(here, [payload]), trial.effects[-1])
    # beside the friction of both it stands for nothing else
    every = fit(here, [*ASSUMED, effect("motor_viscous_friction", "elbow", coefficient=0.1),
                       effect("motor_viscous_friction", "shoulder", coefficient=0.1), shared])  # fmt: skip
    assert not criteria.stands_in(every, every.effects[-1])


def test_of_two_numbers_one_at_its_bound_leaves_the_other_its_best() -> None:
    """Static friction that would be negative is none, and the level is then Coulomb friction's."""
    here = problem()
    wide, narrow = (
        Scanner([c for c in enumerate_candidates(here) if c.key == (name, "elbow")]).scan(fit(here, []))[0]
        for name in ("stribeck_friction", "motor_coulomb_friction")
    )
    assert wide.removes >= narrow.removes * (1.0 - 1e-3)
    assert wide.planned().values["static_extra"] >= 0.0


@pytest.mark.parametrize("joint", list(FRICTION))
def test_the_residual_is_smooth_in_a_level(joint: str) -> None:
    """Friction switches between samples, not with them: a small change of its level moves the residual in
    proportion, and energy does not jump."""
    here, effects = problem(), list(ASSUMED)
    slot = of_level(effects, joint)
    at = slot.get(effects)

    def along(share: float) -> np.ndarray:
        moved = list(effects)
        slot.put(moved, at * (1.0 + share))
        return here.residual(moved) - here.residual(effects)

    small, tenth = along(1e-4), along(1e-5)
    assert np.linalg.norm(tenth) > 0.0
    assert np.linalg.norm(small - 10.0 * tenth) < 0.05 * np.linalg.norm(small)


@pytest.mark.parametrize("start", [0.01, 0.5])
def test_a_scale_is_found_from_far_away(start: float) -> None:
    """A full step from a far start would take the speed of a Stribeck friction to one of its bounds, where
    the energy is flat."""
    here = stribeck_problem()
    begun = [effect("stribeck_friction", "shoulder", level=6.0, static_extra=1.0, velocity=start)]
    found = fit(here, begun).effects[0].values
    assert found["velocity"] == pytest.approx(0.08, rel=0.2)
    assert found["static_extra"] == pytest.approx(3.0, rel=0.2)


def test_what_acts_within_joints_enters_on_all_of_them_at_once() -> None:
    """Coulomb friction takes most of the error of both joints: it is there before anything else is sought."""
    here = problem()
    nothing = at_own_level(fit(here, []))
    candidates = [c for c in enumerate_candidates(here) if c.effect.ordinary]
    with worker_pool([], 1) as pool:
        common = with_ordinary(nothing, Scanner(candidates).scan(nothing), pool)
    assert common is not None
    assert {("motor_coulomb_friction", joint) for joint in FRICTION} <= {e.key for e in common.effects}


@thorough
def test_a_load_that_hides_friction_is_found_first() -> None:
    """Beside 20 times the load, friction takes little of the error of any joint, and most beside the load."""
    here = made(
        [Planted("payload", "elbow", {"mass": 15.0, "position": [0.02, 0.0, -0.4]}), *PLANTED[1:]], 0.0
    )
    candidates = [c for c in enumerate_candidates(here) if c.effect.ordinary]
    with worker_pool([], 1) as pool:
        nothing = at_own_level(fit(here, []))
        assert with_ordinary(nothing, Scanner(candidates).scan(nothing), pool) is None
        loaded = at_own_level(fit(here, [effect("payload", "elbow", mass=15.0, position=(0.02, 0.0, -0.4))]))
        common = with_ordinary(loaded, Scanner(candidates).scan(loaded), pool)
    assert common is not None
    assert {e.key for e in common.effects} >= {e.key for e in ASSUMED}


def test_a_load_moves_along_its_derivatives_where_a_joint_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit with one joint's friction ends where a fit does that evaluates all joints for each step."""
    payload, shoulder, elbow = ASSUMED
    here = problem()
    current = fit(here, [payload, shoulder])
    begun = [*current.effects, elbow.with_values({"level": 1.0})]
    places: list[object] = []
    evaluated = Problem.residual

    def residual(self: Problem, effects: Sequence[Planned]) -> np.ndarray:
        places.append(effects[0].values["position"] if effects else None)
        return evaluated(self, effects)

    monkeypatch.setattr(Problem, "residual", residual)
    all_joints = fit(here, begun, held=[begun[1]])
    moved = len(set(places))
    places.clear()
    one_joint = fit(here, begun, changed=begun[2])
    assert one_joint.effects[1] is begun[1]
    assert 1 < len(set(places)) < moved
    # derivatives are kept where numbers move by little, so that both end near the optimum and not on it
    assert one_joint.energy == pytest.approx(all_joints.energy, abs=here.settings.search.chance)
    assert one_joint.energy < fit(here, current.effects).energy - 1000.0
    for slot in all_joints.slots[:5]:
        assert slot.get(one_joint.effects) == pytest.approx(slot.get(all_joints.effects), rel=1e-2, abs=1e-3)


def test_what_one_joint_lacks_is_no_common_friction() -> None:
    here = problem()
    nothing = at_own_level(fit(here, []))
    candidates = [c for c in enumerate_candidates(here) if c.effect.ordinary and c.joint == "shoulder"]
    with worker_pool([], 1) as pool:
        assert with_ordinary(nothing, Scanner(candidates).scan(nothing), pool) is None


def test_sets_of_different_joints_are_found_in_one_round() -> None:
    """A law of one joint is no rival of a law of another one: each is tried, whichever leaves less."""
    here, payload = problem(), ASSUMED[0]
    best = at_own_level(fit(here, [payload]))
    bare = at_noise(best)
    assert bare is not None
    trials = [fit(bare.problem, [payload, friction]) for friction in ASSUMED[1:]]
    with worker_pool([], 1) as pool:
        found = clearing(best, trials, bare, pool)
    assert {f.effects[-1].joint for f in found} == set(FRICTION)


def test_a_rival_pair_that_cannot_clear_is_not_fitted() -> None:
    here = problem()
    best = at_own_level(fit(here, ASSUMED))
    rival = fit(best.problem, [e for e in ASSUMED if e.joint != "shoulder"])
    scanned = Scanner(enumerate_candidates(here)).scan(rival)
    missing = next(s for s in scanned if s.candidate.key == ("motor_coulomb_friction", "shoulder"))
    worst = scanned[-1]
    assert best.furthest <= best.settings.regression.implausible
    assert missing.removes > 10.0 * worst.removes
    assert not might_clear(best, rival, [worst.planned()], worst.removes)
