"""What a cause must be to be named, and how far it is believed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from planting import FULL, NO_COMMAND, ROBOTS, Planted, plant, robot_file
from study.cases import COUNTS, make
from support.diagnose_cases import Case, as_recording, found_in, nominal, summary
from support.thorough import exhaustive, thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.deviations import deviation_effects, judged_energy
from flexjoint.diagnosis.regression.fit import Fit, fit, fit_tried
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.result import Estimation, Finding, Fitted
from flexjoint.diagnosis.search import criteria, dating, trials
from flexjoint.diagnosis.search.candidates import enumerate_candidates
from flexjoint.diagnosis.search.criteria import (
    _between_samples,
    _left_beside,
    at_own_level,
    contradicted,
    degenerate,
    explained,
    score,
    supported,
    unexplained_energy,
)
from flexjoint.diagnosis.search.dating import date_onset
from flexjoint.diagnosis.search.scan import Scanner
from flexjoint.diagnosis.search.trials import might_matter, settled
from flexjoint.diagnosis.settings import USUAL
from flexjoint.diagnosis.verdict.checks.finer import finer
from flexjoint.effects import Planned, effect
from flexjoint.robot.robot import load

CAUSES = (
    Planted("link_viscous_friction", "swing", {"coefficient": 1.3}),
    Planted("spring_damping", "swing", {"scale": 1.0}),
)
"""A damping twice the nominal one's, which the robot file claims to a tenth, beside a friction that explains
a hundred thousand times as much."""


def fitted(case: Case, *causes: Planted, assumed: tuple[Planned, ...]) -> Fit:
    problem = Problem(balances_of(nominal(case.robot), as_recording(case.with_causes(*causes))))
    return fit(problem, assumed)


@thorough
def test_a_nominal_number_far_off_beside_a_large_cause_is_named() -> None:
    result = found_in(Case("lever", "rich", 5, inexact=0.02), *CAUSES)
    named = {(f.effect, f.joint) for f in result.findings}

    assert named == {(c.effect, c.joint) for c in CAUSES}, summary(result)
    assert result.verdict == "causes", summary(result)


def test_what_the_change_of_a_nominal_number_explains_is_counted_with_that_number_held() -> None:
    """Its own deviation takes its place at a price of some hundred: what it explains is far more."""
    viscous = effect("link_viscous_friction", "swing", coefficient=1.3)
    damping = effect("spring_damping", "swing", scale=1.0)
    trial = fitted(Case("lever", "rich", 5, inexact=0.02), *CAUSES, assumed=(viscous, damping))
    without = fit(trial.problem, trial.effects[:1])
    gained = without.energy - trial.energy

    assert 20.0 < gained < 500.0
    assert explained(trial, without, trial.effects[1]) > 10.0 * gained
    assert explained(trial, fit(trial.problem, trial.effects[1:]), trial.effects[0]) > 1e5


COGGING = Planted("cogging", "turn", {"amplitude": 0.3, "cycles": 18.0, "phase": 0.7})


def test_a_cause_that_makes_another_balance_wrong_is_none() -> None:
    """A transmission error makes the motor's torque ripple as cogging does, and the link's, too."""
    spring = effect("transmission_error", "turn", amplitude=2e-3, cycles=18.0, phase=0.7)
    cogging = effect("cogging", "turn", amplitude=0.3, cycles=18.0, phase=0.7)
    case = Case("turret_exact", "slow", 3)
    nothing = fitted(case, COGGING, assumed=())
    wrong, right = (
        replace(nothing, effects=(one,), y=nothing.problem.residual([one])) for one in (spring, cogging)
    )

    assert contradicted(wrong, nothing)
    assert not contradicted(right, nothing)


@thorough
def test_next_to_nothing_of_a_sample_beside_a_lag_is_no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a noisy command does between two samples is not recorded: a delay of a 27th of a sample makes that
    smaller by far more than its price, where there is a lag of two samples only."""
    monkeypatch.setitem(COUNTS, "drawn", 300)
    machine = make("drawn", 293).case
    recording, (lag,) = as_recording(machine.train()), machine.effects
    problem = Problem(balances_of(load(robot_file(machine.robot)), recording))
    without = fit(problem, [Planned.of(lag.effect, lag.joint, dict(lag.parameters))])
    beside = [without.effects[0], effect("torque_delay", lag.joint, delay=1e-4)]
    trial = at_own_level(fit(problem, beside))

    assert trial.effects[1].values["delay"] < 1e-4
    assert score(trial) < score(fit(trial.problem, without.effects)) - 100.0
    assert not supported(trial, fit(trial.problem, without.effects), trial.effects[1])


@thorough
def test_a_struck_cause_is_not_replaced_with_confidence() -> None:
    result = found_in(Case("turret_exact", "slow", 3), COGGING, excluded=frozenset({"cogging"}))

    assert result.verdict == "unexplained", summary(result)
    assert all(f.probability < 0.5 for f in result.findings), summary(result)


def test_an_onset_is_found_in_a_few_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps that are fitted anew at each onset can take turns for ever, as every fit gains a little."""
    late = Planted("motor_coulomb_friction", "turn", {"level": 0.4}, since=5.9)
    guess = effect("motor_coulomb_friction", "turn", since=6.6, level=0.3)
    begun = fitted(Case("turret", "rich", 3, inexact=0.02), late, assumed=(guess,))
    count = 0

    def counted(*given: object, **named: object) -> Fit:
        nonlocal count
        count += 1
        return fit_tried(*given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(dating, "fit_tried", counted)
    dated = date_onset(begun)

    assert dated.effects[0].since == pytest.approx(5.9, abs=0.05)
    assert count <= 1 + len(USUAL.search.onset_steps)


def test_an_onset_found_at_a_high_noise_level_is_dated_again_at_the_level_that_its_set_leaves() -> None:
    late = Planted("motor_coulomb_friction", "turn", {"level": 0.4}, since=5.9)
    problem = Problem(
        balances_of(
            nominal("turret"), as_recording(Case("turret", "rich", 3, inexact=0.02).with_causes(late))
        )
    )
    loud = problem.at(NoiseLevel(np.full(len(problem.balances.rows), 1e4), 1.0))
    guess = fit(loud, [effect("motor_coulomb_friction", "turn", since=6.1, level=0.3)])

    assert at_own_level(guess).effects[0].since == 6.1
    assert settled(guess).effects[0].since == pytest.approx(5.9, abs=0.05)


@thorough
def test_a_jump_of_an_encoder_is_dated_before_it_is_compared() -> None:
    """A preload dated half a block away explains as much of what is left as the jump dated there; only at
    its own instant the jump explains what the motor's acceleration shows."""
    jump = Planted("motor_encoder_offset", "turn", {"offset": 0.01}, since=6.18)
    result = found_in(Case("turret", "rich", 3, inexact=0.02), jump)

    assert [(f.effect, f.joint) for f in result.findings] == [("motor_encoder_offset", "turn")], summary(
        result
    )
    assert result.findings[0].since == pytest.approx(6.18, abs=0.01)


def test_a_gain_that_a_nominal_stiffness_hides_is_no_contradiction() -> None:
    """Where a torque sensor reads 3 % too much and the spring is 3 % stiffer than the model, the sensor's
    balance looks right until the gain is named, and then with the stiffness that the others ask for."""
    gain, stiffer = (
        Planted("torque_sensor_gain", "turn", {"gain": 0.03}),
        Planted("spring_stiffness", "turn", {"scale": 0.03}),
    )
    named = effect("torque_sensor_gain", "turn", gain=0.03)
    right = fitted(Case("turret", "rich", 3), gain, stiffer, assumed=(named,))

    assert not contradicted(right, fit(right.problem, []))


def test_states_see_no_noise() -> None:
    """A hysteresis's state takes the magnitude of the deflection's speed: with its noise the state decays."""
    loop = {"level": 0.4, "scale": 0.0035}
    effect = Planned.of("spring_hysteresis", "turn", loop)
    left = []
    for with_twin in (True, False):
        problem = fitted(
            Case("turret_exact", "slow", 5), Planted("spring_hysteresis", "turn", loop), assumed=()
        ).problem
        if not with_twin:
            problem.balances.chains.denoised = None
        left.append(problem.energy(problem.residual([effect])) - problem.noise_energy)

    assert left[0] < 0.3 * left[1]


def test_states_follow_a_record_from_its_start() -> None:
    """Not from the first sample that is used, where a spring that carries a load is on its way."""
    loop = {"level": 4.86, "scale": 0.002}
    crane = Case("crane", "rich", 5)
    problem = fitted(crane, Planted("spring_hysteresis", "shoulder", loop), assumed=()).problem
    # where the deflection turns its filtered path leaves something; one begun late leaves five times more
    effect = Planned.of("spring_hysteresis", "shoulder", loop)
    assert problem.energy(problem.residual([effect])) < 2.0 * problem.noise_energy


def test_a_nominal_number_is_a_cause_beyond_its_tolerance() -> None:
    """Motor damping claimed to 10 %: off by 37 % it is one, although chance may favour other laws by more;
    off by 25 % it is none."""
    nominal_damping = nominal("turret").joint("turn").drive.D_m
    for share, named in ((0.37, True), (0.25, False)):
        more = {"coefficient": share * nominal_damping}
        guess = Planned.of("motor_viscous_friction", "turn", more)
        right = fitted(
            Case("turret", "rich", 3), Planted("motor_viscous_friction", "turn", more), assumed=(guess,)
        )
        assert supported(right, fit(right.problem, []), right.effects[0]) is named


def test_a_law_finer_than_the_sensors_see_is_a_simpler_one() -> None:
    """A loop that is through before an encoder shows any motion is dry friction."""
    problem = fitted(Case("turret", "rich", 3), assumed=()).problem
    for scale, simpler in ((3e-3, False), (5e-6, True)):
        law = effect("dahl_friction", "turn", level=0.4, scale=scale)
        assert degenerate(problem, law) is simpler


def test_ordinary_friction_is_held_against_what_its_own_joint_leaves() -> None:
    """A drag that nobody explains is left on the last of three joints: friction of the first is none the less
    there. Any other law has to stand out of all that is left."""
    first, _, last = nominal("gimbal").joint_names
    drag = Planted("quadratic_drag", last, {"coefficient": 3.0})
    rubs = Planted("motor_coulomb_friction", first, {"level": 0.3})
    assumed = (
        effect("motor_coulomb_friction", first, level=0.3),
        effect("torque_offset", first, offset=0.1),
    )
    trial = fitted(Case("gimbal", "rich", 3), drag, rubs, assumed=assumed)
    friction, offset = (_left_beside(trial, e) for e in trial.effects)

    assert offset == unexplained_energy(trial)
    assert 0.0 < friction < 0.1 * offset


def test_a_friction_in_one_direction_only_is_an_offset() -> None:
    """Beside an offset larger than itself a friction pushes one way at both speeds: no friction of two
    levels, each at least none, does that."""
    problem = fitted(Case("turret", "rich", 3), assumed=()).problem
    for least, one_way in ((0.0, True), (0.1, False)):
        law = effect("asymmetric_friction", "turn", level_positive=least, level_negative=0.5)
        assert degenerate(problem, law) is one_way


def test_a_shape_that_may_be_anything_is_not_named() -> None:
    """A friction that fades within a minute, or in a day, as far as the data tell: it is constant."""
    constant = effect("friction_drift", "turn", level=0.4, time_constant=5e4)
    for std, plainer in ((10.0, False), (2e5, True)):
        numbers = {"level": Fitted(0.4, 0.001, "N m"), "time_constant": Fitted(5e4, std, "s")}
        finding = Finding("friction_drift", "turn", 0.9, numbers, None, 0.9, "friction", constant)
        estimation = Estimation("balances", "", ("level", "time_constant"), np.eye(2))
        best = fitted(Case("turret", "rich", 3), assumed=(constant,))
        assert bool(finer(best, [finding], estimation)) is plainer


def test_what_cannot_matter_is_not_fitted() -> None:
    small, large = (
        fitted(Case("turret", "rich", 3), Planted("torque_offset", "turn", {"offset": offset}), assumed=())
        for offset in (2e-4, 0.2)
    )
    for nothing, matters in ((small, False), (large, True)):
        candidates = [c for c in enumerate_candidates(nothing.problem) if c.effect.name == "torque_offset"]
        scored = next(s for s in Scanner(candidates).scan(nothing) if s.candidate.joint == "turn")
        assert might_matter(nothing, scored) is matters


@exhaustive
def test_a_law_that_swaps_in_must_stay_better_at_its_own_level() -> None:
    """Beside a hysteresis, Coulomb friction must not give way to a Stribeck bump that shrinks once it is
    judged by what it leaves."""
    causes = (
        Planted("spring_hysteresis", "turn", {"level": 0.4, "scale": 0.0035}),
        Planted("motor_coulomb_friction", "turn", {"level": 0.4}),
    )
    result = found_in(Case("turret", "rich", 3, inexact=0.02), *causes)

    assert {f.effect for f in result.findings} == {c.effect for c in causes}, summary(result)


@thorough
def test_two_levels_are_told_apart_by_the_simulation() -> None:
    """With unknown encoder offsets the balances tell the mean of two friction levels only; the simulation
    tells both, and a law is as fine as its refined numbers are known."""
    levels = {"level_positive": 0.41, "level_negative": 0.205}
    two = found_in(Case("turret", "rich", 3), Planted("asymmetric_friction", "turn", levels))
    one = found_in(Case("turret", "rich", 3), Planted("motor_coulomb_friction", "turn", {"level": 0.3}))

    assert [f.effect for f in two.findings] == ["asymmetric_friction"], summary(two)
    assert [f.effect for f in one.findings] == ["motor_coulomb_friction"], summary(one)


@pytest.mark.parametrize(
    "causes",
    [
        (Planted("backlash", "swing", {"gap": 0.01}),),
        (
            Planted("motor_encoder_offset", "swing", {"offset": -0.0143}),
            Planted("motor_viscous_friction", "swing", {"coefficient": 4.41}),
        ),
    ],
    ids=lambda causes: causes[0].effect,
)
def test_a_stiffness_acts_on_the_deflection_that_an_effect_leaves(causes: tuple[Planted, ...]) -> None:
    """A spring 4 % off turns by what a gap or an encoder's offset leaves of the reading, not by all of it:
    beside the true effects, the nominal numbers explain the rest down to the noise."""
    stiffer = Planted("spring_stiffness", "swing", {"scale": 0.04})
    assumed = tuple(Planned.of(c.effect, str(c.joint), dict(c.parameters)) for c in causes)
    right = fitted(Case("lever", "rich", 3), *causes, stiffer, assumed=assumed)

    assert right.energy < 1.2 * right.problem.noise_energy


def test_a_law_names_no_torque_that_it_does_not_show() -> None:
    """A bump of friction below the speeds that the data resolve may have any height."""
    still = fitted(Case("turret", "rich", 3), assumed=()).problem
    bump = effect("stribeck_friction", "turn", level=0.0, static_extra=10.0, velocity=0.0014)
    friction = effect("stribeck_friction", "turn", level=0.3, static_extra=0.2, velocity=0.1)

    assert degenerate(still, bump)
    assert not degenerate(still, friction)


def test_chance_grows_with_the_joints() -> None:
    """The same energy says less where more candidates were tried."""
    one, three = (fitted(Case(name, "rich", 3), assumed=()) for name in ("lever", "gimbal"))
    law = {"lever": ("swing", one), "gimbal": ("tilt", three)}
    dearer = []
    for joint, bare in law.values():
        named = replace(bare, effects=(effect("motor_coulomb_friction", joint, level=0.1),))
        dearer.append(score(named) - score(bare))

    assert dearer[1] == pytest.approx(dearer[0] + 2.0 * np.log(3.0))


def test_numbers_that_no_machine_has_are_no_error() -> None:
    """Beside a hopelessly wrong set at the noise's level, nominal numbers may be asked for anything."""
    turret = nominal("turret")
    floating = replace(turret, file=turret.file.model_copy(update={"offsets": "per_recording"}))
    recording = as_recording(Case("turret", "rich", 3).with_causes())
    problem = Problem(balances_of(floating, recording))
    absurd = 1e4 * np.ones(len(problem.nuisance))

    assert all(
        np.isfinite(e.values["offset"]) for e in deviation_effects(problem, absurd) if "offset" in e.values
    )
    assert np.isfinite(judged_energy(problem, problem.along(absurd), []))


def test_a_law_is_not_named_by_what_it_adds_to_a_simpler_one_that_is_absent() -> None:
    """A body that sticks and does not rub: noise at rest looks like it."""
    law = effect("stribeck_friction", "turn", level=0.4, static_extra=0.2, velocity=0.05)
    best = fitted(Case("turret", "rich", 3), assumed=(law,))
    estimation = Estimation("balances", "", ("level", "static_extra", "velocity"), np.eye(3))
    for level, extra, plainer in ((0.4, 0.2, False), (0.4, 0.002, True), (0.002, 0.2, True)):
        numbers = {
            "level": Fitted(level, 0.001, "N m"),
            "static_extra": Fitted(extra, 0.001, "N m"),
            "velocity": Fitted(0.05, 0.001, "rad/s"),
        }
        finding = Finding("stribeck_friction", "turn", 0.9, numbers, None, 0.9, "friction", law)
        assert bool(finer(best, [finding], estimation)) is plainer


def test_of_many_joints_that_are_wrong_a_cause_clears_its_own() -> None:
    problem = SimpleNamespace(level=NoiseLevel(np.full(9, 1000.0)))
    wrong = SimpleNamespace(problem=problem, settings=USUAL)
    levels, own = np.full(9, 1000.0), np.arange(9) < 2
    levels[own] = 2.0
    assert trials.cleared(wrong, levels, own) == pytest.approx(np.log(500.0))
    assert trials.cleared(wrong, levels, ~own) == 0.0
    assert trials.cleared(wrong, levels, np.full(9, True)) < np.log(USUAL.search.cleared)


def test_the_methods_error_of_a_cause_is_in_the_balances_that_it_marks() -> None:
    """What a motor's friction leaves is nothing to a load on the link, but is to a gain of that motor."""
    effects = [
        effect("motor_coulomb_friction", "elbow", level=2.8),
        effect("payload", "elbow", mass=1.2, position=(0.0, 0.03, -0.3)),
        effect("torque_gain", "elbow", gain=0.1),
        effect("motor_coulomb_friction", "shoulder", level=6.0),
    ]
    recording = as_recording(Case("crane", "rich", 41).with_causes()).between(0.0, 5.0)
    trial = fit(Problem(balances_of(nominal("crane"), recording)), effects, iterations=0)
    beside = {
        e.effect.name: [b.effect.name for b in criteria._sharing_balances(trial, e)]
        for e in trial.effects[:3]
    }
    assert beside == {
        "motor_coulomb_friction": ["torque_gain"],
        "payload": [],
        "torque_gain": ["motor_coulomb_friction"],
    }


@thorough
def test_where_hardly_anything_counts_a_wrong_number_is_not_the_end() -> None:
    """At the level that the nominal model leaves, a wrist's friction of 0.60 N m settles at 0.57, though that
    leaves more."""
    machine = make("single", 253).case
    recording, (truth,) = as_recording(machine.train()), machine.effects
    problem = Problem(balances_of(nominal(machine.robot), recording))
    nothing = at_own_level(fit(problem, []))
    bare = trials.at_noise(nothing)
    assert bare is not None
    assumed = effect(truth.effect, truth.joint, level=0.5)
    above = fit(nothing.problem, [assumed])
    assert abs(above.effects[0].values["level"] / truth.value("level") - 1.0) > 0.02
    clearer = trials._clearer((nothing, bare, above))
    assert clearer.effects[0].values["level"] == pytest.approx(truth.value("level"), rel=0.005)


@pytest.mark.parametrize(("resolution", "seen"), [(2.0 * np.pi / 2**18, True), (2.0 * np.pi / 2**14, False)])
def test_a_gap_below_the_step_of_an_encoder_is_not_seen(resolution: float, seen: bool) -> None:
    """Rounding makes a dead zone of its own: on a healthy joint that turns its spring by 20 steps a gap of
    half a step was named, beside a stiffness."""
    sensors = replace(
        FULL,
        noise={"q": 4e-6, "theta": 4e-6, "dq": 5e-3, "dtheta": 5e-3, "tau_t": 0.05},
        resolution=resolution,
    )
    recorded = plant(ROBOTS / "lever_exact.yaml", [], "rich", 8.0, 3, sensors)
    problem = Problem(balances_of(nominal("lever_exact"), as_recording(recorded)))

    assert degenerate(problem, effect("backlash", "swing", gap=2e-4)) is not seen
    assert not degenerate(problem, effect("backlash", "swing", gap=6e-4))
    assert not degenerate(problem, effect("link_encoder_offset", "swing", offset=2e-4))  # a mean


def test_a_friction_must_show_where_its_joint_slides() -> None:
    """Without a command or a current, the motor's torque is computed from readings that are rounded: at rest
    a friction takes up what that leaves of it, and explains much; where the motor slides it explains
    nothing. A friction that is there shows in both."""
    sensors = replace(
        NO_COMMAND,
        noisy_feedback=False,
        resolution=5e-5,
        noise={"q": 1e-5, "theta": 1e-5, "dq": 5e-3, "dtheta": 5e-3, "tau_t": 0.05},
    )
    gained, sliding, named = [], [], []
    for causes in ([], [Planted("motor_coulomb_friction", "turn", {"level": 0.06})]):
        recorded = plant(robot_file("turret"), causes, "steps", 6.0, 2, sensors, rate=250.0)
        problem = Problem(balances_of(nominal("turret"), as_recording(recorded)))
        without = fit(problem, [])
        trial = fit(problem, [Planned.of("motor_coulomb_friction", "turn", {"level": 0.01})])
        gained.append(without.energy - trial.energy)
        sliding.append(criteria._explained_sliding(trial, without.y, trial.effects[0]))
        named.append(supported(trial, without, trial.effects[0]))

    limit = USUAL.search.sliding
    assert gained[0] > USUAL.search.price
    assert sliding[0] < 0.0 < limit < sliding[1]
    assert named == [False, True]


def test_a_delay_beside_a_lag_is_told_from_commands_that_were_not_recorded() -> None:
    """Of commands at 1 kHz every second is recorded: when they changed is known to half of 1 ms."""
    lever, recorded = nominal("lever"), as_recording(Case("lever", "rich", 3).with_causes())
    lag = effect("current_lag", "swing", time_constant=4e-3)

    def unrecorded(delay: float, control: float, *beside: Planned) -> bool:
        rates = lever.rates.model_copy(update={"control": control})
        robot = replace(lever, rates=rates)
        trial = fit(
            Problem(balances_of(robot, recorded)),
            [*beside, effect("torque_delay", "swing", delay=delay)],
            iterations=0,
        )
        return _between_samples(trial, trial.effects[-1])

    assert [unrecorded(delay, 1000.0, lag) for delay in (3e-4, 7e-4)] == [True, False]
    assert not unrecorded(3e-4, 1000.0), "alone it is no matter of two causes"
    assert not unrecorded(3e-4, 500.0, lag), "all commands are recorded"


def test_a_nominal_number_costs_no_more_where_a_position_is_reconstructed() -> None:
    """Within its tolerance it does the same along the same positions: what these lack is no reason to take a
    friction that is six tolerances off for one within them."""
    problem = Problem(
        balances_of(nominal("turret"), as_recording(Case("turret", "rich", 3, "motor_only").with_causes()))
    )
    (offset, friction) = (
        fit(problem, [e], iterations=0)
        for e in (
            effect("torque_offset", "turn", offset=1.0),
            effect("motor_viscous_friction", "turn", coefficient=1.0),
        )
    )
    assert problem.motion.missing
    assert score(friction) - friction.energy == pytest.approx(USUAL.search.price_nominal)
    assert score(offset) - offset.energy == pytest.approx(
        USUAL.search.price + USUAL.search.price_reconstructed
    )
