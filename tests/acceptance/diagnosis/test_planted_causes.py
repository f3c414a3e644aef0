"""Causes planted by an independent generator are named, measured and dated; healthy machines left alone."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache

import pytest
from planting import BEYOND, CATALOGUE, Planted
from support.diagnose_cases import Case, as_recording, found_in, nominal, summary
from support.thorough import exhaustive, sample, thorough

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.effects import catalogue

# sensor noise alone leaves most parameters within 1 %; the rest is the Gaussian filter's bias at kinks and
# what the nominal tolerances (2 %, damping 10 %) take for themselves
TOLERANCE = 0.05
SURE = 0.9  # probability from which a name is a claim
ONSET = 0.5  # s

CONSTANT_TWIST = frozenset({"link_encoder_offset", "motor_encoder_offset", "spring_preload"})
"""A constant in phi: a shift of theta, of q or of the spring torque by K times as much leave the same trace
in motor and spring balance. Only gravity, through q, tells the link encoder's apart."""

COMMON_DELAY = frozenset({"torque_delay", "sensor_delay"})
"""On a robot of one joint, a late command and equally late sensors are the same machine, seen later."""


@dataclass(frozen=True)
class Single:
    """One cause; `main` is the parameter that must come out within `tolerance` (relative). One of its
    `equivalents` may be named in its place when the finding lists the cause as indistinguishable."""

    case: Case
    cause: Planted
    main: str
    tolerance: float = TOLERANCE
    equivalents: frozenset[str] = frozenset()

    @property
    def name(self) -> str:
        return f"{self.cause.effect}-{self.case.name}"


def single(
    effect: str,
    robot: str,
    joint: str | None,
    excitation: str,
    tolerance: float = TOLERANCE,
    equivalents: frozenset[str] = frozenset(),
    **parameters: object,
) -> Single:
    seed = 100 + list(CATALOGUE).index(effect)
    main = next(iter(parameters))
    case = Case(robot, excitation, seed)
    return Single(case, Planted(effect, joint, parameters), main, tolerance, equivalents)


SINGLES = (
    single("torque_gain", "crane", "shoulder", "rich", gain=-0.1),
    single("torque_offset", "crane", "elbow", "slow", offset=2.4),
    single("torque_delay", "crane", "elbow", "rich", delay=0.0045),
    single("torque_delay", "lever", "swing", "rich", TOLERANCE, COMMON_DELAY, delay=0.0045),
    single("torque_saturation", "lever", "swing", "steps", limit=55.0),
    single("cogging", "turret", "turn", "slow", amplitude=0.29, cycles=14.0, phase=1.0),
    single("motor_inertia", "crane", "elbow", "rich", scale=0.3),
    single("motor_viscous_friction", "crane", "elbow", "rich", coefficient=3.2),
    single("motor_coulomb_friction", "crane", "elbow", "rich", level=2.8),
    single("asymmetric_friction", "lever", "swing", "rich", level_positive=6.0, level_negative=3.0),
    # level and static_extra are told apart only where the speed is a few times `velocity`, which a slow
    # motion with its sticking offers for part of the time
    single("stribeck_friction", "turret", "turn", "slow", 0.1, level=0.48, static_extra=0.48, velocity=0.06),
    single("load_friction", "crane", "elbow", "rich", coefficient=0.13),
    # 12 s are 1.7 time constants: a decay and what is left of it are correlated
    single("friction_drift", "turret", "turn", "rich", 0.1, level=0.96, time_constant=7.0),
    single("spring_stiffness", "crane", "elbow", "rich", scale=-0.2),
    # D phi' is 2 % of the spring torque, and D itself is trusted to 10 %
    single("spring_damping", "lever", "swing", "rich", 0.1, scale=1.5),
    single("hardening_spring", "crane", "elbow", "rich", cubic=3.0e5),
    single("backlash", "lever", "swing", "rich", gap=0.009),
    # the loop's width over a decade of amplitudes tells level from scale, one recording has less
    single("spring_hysteresis", "crane", "elbow", "rich", 0.1, level=2.0, scale=0.0035),
    single("transmission_error", "turret", "turn", "slow", amplitude=0.002, cycles=16.0, phase=-1.0),
    single("spring_preload", "crane", "elbow", "rich", TOLERANCE, CONSTANT_TWIST, torque=-2.4),
    single("payload", "crane", "elbow", "rich", mass=0.65, position=(0.0, 0.0, -0.25)),
    single("base_tilt", "crane", None, "rich", roll=0.06, pitch=0.0),  # the axes run along x: pitch is hidden
    single("link_coulomb_friction", "crane", "shoulder", "rich", level=4.7),
    single("link_viscous_friction", "crane", "elbow", "rich", coefficient=1.75),
    single("cable_spring", "crane", "elbow", "slow", stiffness=7.4, rest=0.2),
    single("end_stop", "lever", "swing", "steps", position=-0.4, stiffness=4600.0),
    single("link_encoder_offset", "crane", "elbow", "rich", TOLERANCE, CONSTANT_TWIST, offset=0.015),
    single("motor_encoder_offset", "crane", "shoulder", "rich", TOLERANCE, CONSTANT_TWIST, offset=-0.015),
    single("encoder_eccentricity", "lever", "swing", "rich", amplitude=0.008, phase=1.0, channel="q"),
    single("torque_sensor_offset", "crane", "elbow", "rich", offset=2.4),
    single("torque_sensor_gain", "crane", "shoulder", "rich", gain=-0.1),
    single("sensor_delay", "crane", "elbow", "rich", delay=0.005, channel="q"),
)

HEALTHY = (
    *(
        Case(robot, excitation, seed)
        for seed, (robot, excitation) in enumerate(
            (r, e) for r in ("lever", "turret", "crane", "gimbal") for e in ("rich", "slow", "steps")
        )
    ),
    Case("lever", "rich", 21, "encoders"),
    Case("crane", "rich", 22, "motor_only"),
    Case("turret", "rich", 23, "ragged"),
    Case("crane", "rich", 24, "noisy_feedback"),
)


@cache
def diagnosis(case: Case, *names: str) -> Diagnosis:
    """Diagnosis of the machine with the named ones of SINGLES' causes."""
    causes = [s.cause for s in SINGLES if s.name in names]
    return found_in(case, *causes)


def test_every_effect_of_the_catalogue_that_can_be_planted_is_tested() -> None:
    assert {s.cause.effect for s in SINGLES} == set(CATALOGUE)
    assert set(CATALOGUE) <= set(catalogue())


def test_every_effect_that_came_later_is_one_of_the_catalogue() -> None:
    assert set(BEYOND) <= set(catalogue())


@pytest.mark.parametrize("single", sample(SINGLES, one_in=20, thorough_in=3), ids=lambda s: s.name)
def test_a_planted_cause_is_named_and_measured(single: Single) -> None:
    result, cause = diagnosis(single.case, single.name), single.cause
    told = summary(result)

    assert result.verdict == "causes", told
    assert len(result.findings) == 1, told
    finding = result.findings[0]
    named = (finding.effect, finding.joint)
    if single.equivalents and named != (cause.effect, cause.joint):
        assert finding.effect in single.equivalents, told
        ties = [(tie.effect, tie.joint) for tie in finding.indistinguishable]
        assert (cause.effect, cause.joint) in ties, told
        return
    assert named == (cause.effect, cause.joint), told
    assert finding.since is None, told
    fitted, true = finding.parameters[single.main], cause.value(single.main)
    assert fitted.value == pytest.approx(true, rel=single.tolerance), told
    # the standard error holds noise, tolerances and autocorrelation; 2 % more are the filter's bias at kinks
    assert abs(fitted.value - true) < 4 * fitted.std + 0.02 * abs(true), told
    assert 0.0 < fitted.std < 0.5 * abs(true), told
    for word in ("channel",):
        if word in cause.parameters:
            assert finding.parameters[word] == cause.word(word), told


@pytest.mark.parametrize("case", sample(HEALTHY, one_in=12, thorough_in=3), ids=lambda c: c.name)
def test_a_healthy_machine_is_called_healthy(case: Case) -> None:
    result = diagnosis(case)
    told = summary(result)

    assert result.verdict == "healthy", told
    assert not result.findings, told
    assert not result.unexplained, told


@thorough
@pytest.mark.parametrize(
    ("case", "cause", "main"),
    [
        (Case("lever", "rich", 31), Planted("backlash", "swing", {"gap": 0.009}, since=7.3), "gap"),
        (
            Case("crane", "rich", 32),
            Planted("motor_coulomb_friction", "elbow", {"level": 2.8}, since=5.9),
            "level",
        ),
        (
            Case("crane", "rich", 33),
            Planted("payload", "elbow", {"mass": 0.65, "position": (0.0, 0.0, -0.25)}, since=6.6),
            "mass",
        ),
    ],
    ids=lambda x: getattr(x, "effect", None),
)
def test_a_cause_that_sets_in_later_is_dated(case: Case, cause: Planted, main: str) -> None:
    result = found_in(case, cause)
    told = summary(result)

    assert result.verdict == "causes", told
    assert [(f.effect, f.joint) for f in result.findings] == [(cause.effect, cause.joint)], told
    assert result.findings[0].since == pytest.approx(cause.since, abs=ONSET), told
    # half of the recording is left to measure it in
    assert result.findings[0].parameters[main].value == pytest.approx(cause.value(main), rel=0.1), told


@thorough
def test_two_causes_on_two_joints_are_both_named() -> None:
    backlash = Planted("backlash", "shoulder", {"gap": 0.009})
    coulomb = Planted("motor_coulomb_friction", "elbow", {"level": 2.8})

    result = found_in(Case("crane", "rich", 41), backlash, coulomb)

    told = summary(result)
    assert result.verdict == "causes", told
    found = {(f.effect, f.joint): f.parameters for f in result.findings}
    assert set(found) == {("backlash", "shoulder"), ("motor_coulomb_friction", "elbow")}, told
    gap, level = found["backlash", "shoulder"]["gap"], found["motor_coulomb_friction", "elbow"]["level"]
    assert gap.value == pytest.approx(0.009, rel=TOLERANCE), told
    assert level.value == pytest.approx(2.8, rel=TOLERANCE), told
    gains = [f.gain for f in result.findings]
    assert gains == sorted(gains, reverse=True)


@thorough
def test_a_model_without_any_friction_gets_it_at_every_joint() -> None:
    """What most robot descriptions leave out, all at once, and a load that nobody told of."""
    planted = [
        Planted("motor_coulomb_friction", "shoulder", {"level": 6.0}),
        Planted("motor_coulomb_friction", "elbow", {"level": 2.8}),
        Planted("link_viscous_friction", "shoulder", {"coefficient": 3.0}),
        Planted("payload", "elbow", {"mass": 1.2, "position": [0.0, 0.03, -0.3]}),
    ]

    result = found_in(Case("crane", "rich", 41), *planted)

    told = summary(result)
    assert {(f.effect, f.joint) for f in result.findings} == {(p.effect, p.joint) for p in planted}, told
    for f in result.findings:
        wanted = next(p.parameters for p in planted if (p.effect, p.joint) == (f.effect, f.joint))
        main = next(iter(wanted))
        assert f.parameters[main].value == pytest.approx(wanted[main], rel=TOLERANCE), told
    assert result.explained > 0.99, told


def test_numbers_off_by_their_tolerance_are_no_cause() -> None:
    result = diagnosis(Case("crane", "rich", 51, inexact=0.02))

    assert result.verdict == "healthy", summary(result)
    assert not result.findings, summary(result)


@thorough
def test_a_cause_is_named_beside_numbers_that_are_off() -> None:
    result = found_in(
        Case("crane", "rich", 51, inexact=0.02), Planted("backlash", "shoulder", {"gap": 0.009})
    )

    told = summary(result)
    assert result.verdict == "causes", told
    assert [(f.effect, f.joint) for f in result.findings] == [("backlash", "shoulder")], told
    # a stiffness that is 2 % off stretches the twist by as much
    assert result.findings[0].parameters["gap"].value == pytest.approx(0.009, rel=0.1), told


@pytest.mark.parametrize(
    ("planted", "excluded"),
    [
        pytest.param("backlash", {"backlash"}, marks=exhaustive),
        # the second contains the first
        pytest.param("load_friction", {"load_friction", "drive_efficiency"}, marks=exhaustive),
        pytest.param("hardening_spring", {"hardening_spring"}, marks=thorough),
        pytest.param("payload", {"payload"}, marks=thorough),
    ],
)
def test_without_the_true_effect_no_wrong_one_is_claimed(planted: str, excluded: set[str]) -> None:
    case = next(s for s in SINGLES if s.cause.effect == planted)

    result = found_in(case.case, case.cause, excluded=frozenset(excluded))

    claims = [f.effect for f in result.findings if f.probability > SURE]
    assert not (result.verdict == "causes" and claims), summary(result)
    assert result.verdict != "healthy", summary(result)


@thorough
def test_the_same_recording_gives_the_same_diagnosis() -> None:
    case = next(s for s in SINGLES if s.cause.effect == "backlash")

    first, second = (to_json(found_in(case.case, case.cause)) for _ in range(2))

    assert json.dumps(first) == json.dumps(second)


@thorough
def test_a_joint_without_a_command_tells_nothing_of_its_neighbours_coupling() -> None:
    rubs = Planted("motor_coulomb_friction", "elbow", {"level": 1.0})
    whole = as_recording(Case("crane", "rich", 3).with_causes(rubs))
    lacking = {("tau_m", "shoulder"), ("tau_ff", "shoulder")}
    recording = replace(whole, columns={k: v for k, v in whole.columns.items() if k not in lacking})
    result = diagnose(nominal("crane"), [recording], refine=False)

    assert [f.effect for f in result.findings] == ["motor_coulomb_friction"]
    assert ("joint_coupling", "elbow") in result.not_excited
