"""Numbers of causes refined on the simulation: exact sensitivities, standard errors that cover, refusals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from planting import NO_COMMAND, ROBOTS, Planted, plant
from support.diagnose_cases import Case, as_recording, findings_of, nominal
from support.thorough import thorough

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.refinement import refined, sensitivities
from flexjoint.diagnosis.refinement.open_model import OpenModel
from flexjoint.diagnosis.refinement.sensitivities import (
    Directions,
    Inputs,
    Run,
    StepDerivatives,
    link_load,
)
from flexjoint.diagnosis.refinement.shooting import Reduced, Shooting
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis, Estimation, Finding, Fitted, sentences, to_json
from flexjoint.diagnosis.search.criteria import at_own_level
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, load, shipped_robots
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import rollout
from flexjoint.simulation.sensors import readings

RATE = 1000.0
STEPS = 60
READINGS = ("q.shoulder", "theta.elbow", "tau_t.shoulder", "tau_t.elbow")
VARIED = (
    "motor_coulomb_friction.elbow.level",
    "spring_hysteresis.shoulder.scale",
    "encoder_eccentricity.shoulder.amplitude",
    "payload.elbow.mass",
    "drive.elbow.stiffness",
    "drive.shoulder.motor_inertia",
)
PLACE = (0.02, 0.0, -0.25)  # m, of a payload


def defects(payload: float = 0.2) -> list[Planned]:
    return [
        effect("motor_coulomb_friction", "elbow", level=2.0),
        effect("spring_hysteresis", "shoulder", level=1.5, scale=3e-3),
        effect("encoder_eccentricity", "shoulder", amplitude=0.01, phase=0.4, channel="q"),
        effect("payload", "elbow", mass=payload, position=PLACE),
    ]


@cache
def stepped() -> tuple[SymbolicModel, StepDerivatives]:
    robot = nominal("crane")
    loads = [link_load(name) for name in robot.joint_names]
    symbolic = SymbolicModel(robot, [*defects(), *loads], free=("drives",))
    return symbolic, StepDerivatives(symbolic, VARIED, READINGS, steps=0)


def moving() -> Inputs:
    """Two windows of fast motion: what sticks or turns sits on a switch, where no derivative exists."""
    random = np.random.default_rng(5)
    symbolic, _ = stepped()
    names = symbolic.state_names
    start = np.zeros((2, len(names)))
    for k, name in enumerate(names):
        start[:, k] = random.uniform(-0.3, 0.3, 2) if name.startswith("q.") else 0.0
        if name.startswith(("dq.", "dtheta.")):
            start[:, k] = (2.0, -1.5)
    for joint in ("shoulder", "elbow"):
        start[:, names.index(f"theta.{joint}")] = start[:, names.index(f"q.{joint}")] + 0.02
    torque = random.uniform(-3.0, 3.0, (2, 1, 2)) + np.zeros((2, STEPS, 2))
    return Inputs(start, np.array([0.0, 1.0]), torque, np.zeros((2, STEPS, 2)))


def simulated(inputs: Inputs, numbers: np.ndarray) -> np.ndarray:
    _, derivatives = stepped()
    nothing = Directions(np.zeros((inputs.start.shape[1], 0)), np.zeros((len(VARIED), 0)))
    return derivatives.run(inputs, numbers, nothing, RATE).readings


def differentiated() -> Run:
    """By every entry of the start, then by every varied parameter, then by both motors' torques."""
    symbolic, derivatives = stepped()
    inputs, nx, v = moving(), len(symbolic.state_names), len(VARIED)
    columns = nx + v + 2
    start, parameters = np.zeros((nx, columns)), np.zeros((v, columns))
    torque = np.zeros((2, STEPS, 2, columns))
    start[:, :nx], parameters[:, nx : nx + v] = np.eye(nx), np.eye(v)
    torque[..., nx + v :] = np.eye(2)
    return derivatives.run(inputs, symbolic.values, Directions(start, parameters, torque), RATE)


# --------------------------------------------------------------------------- sensitivities
@pytest.mark.usefixtures("one_pass")  # as windows are stepped
def test_the_windows_run_as_the_simulation_does() -> None:
    symbolic, _ = stepped()
    inputs = moving()
    model = FlexibleJointModel(nominal("crane"), defects())

    ours = simulated(inputs, symbolic.values)

    for k in range(2):
        tape = rollout(
            model, model.unpack(inputs.start[k], inputs.time[k]), inputs.torque[k], RunOptions(rate=RATE)
        )
        for column, name in enumerate(READINGS):
            expected = readings(model, tape)[tuple(name.split("."))]
            # the same operations in another order
            np.testing.assert_allclose(ours[k, :, column], expected, rtol=1e-9, atol=1e-11)


def test_sensitivities_are_those_of_finite_differences() -> None:
    symbolic, _ = stepped()
    inputs, run = moving(), differentiated()
    nx = len(symbolic.state_names)
    columns = []
    for k in range(nx):
        step = 1e-6 * np.eye(nx)[k]
        ahead, behind = (replace(inputs, start=inputs.start + side * step) for side in (1, -1))
        columns.append((simulated(ahead, symbolic.values) - simulated(behind, symbolic.values)) / 2e-6)
    for name in VARIED:
        size = 1e-4 * abs(symbolic.values[symbolic.parameters.index(name)])
        numbers = [
            symbolic.set_values({name: symbolic.values[symbolic.parameters.index(name)] + side * size})
            for side in (1, -1)
        ]
        columns.append((simulated(inputs, numbers[0]) - simulated(inputs, numbers[1])) / (2.0 * size))
    for k in range(2):
        ahead, behind = (
            replace(inputs, torque=inputs.torque + side * 1e-4 * np.eye(2)[k]) for side in (1, -1)
        )
        columns.append((simulated(ahead, symbolic.values) - simulated(behind, symbolic.values)) / 2e-4)

    expected = np.stack(columns, axis=-1)

    assert np.all(np.max(np.abs(expected), axis=(0, 1, 2)) > 0.0)  # nothing is compared with nothing
    # central differences err by the square of their step and by rounding over it: 1e-6 of the largest each
    scale = np.max(np.abs(expected), axis=(0, 1), keepdims=True) + 1e-9
    np.testing.assert_allclose(run.by / scale, expected / scale, atol=2e-5)


def test_inertial_parameters_act_as_a_load() -> None:
    """A payload's mass at null is one direction of its link's inertial parameters."""
    robot = nominal("crane")
    weightless = effect("payload", "elbow", mass=0.0, position=PLACE)
    loads = [link_load(name) for name in robot.joint_names]
    symbolic = SymbolicModel(robot, [weightless, *loads])
    derivatives = StepDerivatives(symbolic, ("payload.elbow.mass",), READINGS, steps=0)
    inputs = moving()
    start = np.delete(inputs.start, -1, axis=1)  # no hysteresis here
    unit = np.array(
        weightless.effect.edit_inertial(
            [0.0] * 10, replace(weightless, values={**weightless.values, "mass": 1.0}).p
        )
    )
    inertial = np.zeros((20, 2))
    inertial[10:, 1] = unit

    run = derivatives.run(
        replace(inputs, start=start),
        symbolic.values,
        Directions(np.zeros((start.shape[1], 2)), np.array([[1.0, 0.0]]), None, inertial),
        RATE,
    )

    # the scheme sees the load at its predicted midpoint, the regressor at the true one: O(h^2) apart
    scale = np.max(np.abs(run.by[..., 0]))
    assert scale > 1e-3
    np.testing.assert_allclose(run.by[..., 1], run.by[..., 0], atol=1e-4 * scale)


def test_compiled_sensitivities_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    symbolic, interpreted = stepped()
    monkeypatch.setattr(sensitivities, "compiling_pays", lambda _function, _steps: True)
    compiled = StepDerivatives(symbolic, VARIED, READINGS, steps=10**6)
    nx = len(symbolic.state_names)
    directions = Directions(np.eye(nx), np.zeros((len(VARIED), nx)))

    one, other = (d.run(moving(), symbolic.values, directions, RATE) for d in (interpreted, compiled))

    np.testing.assert_allclose(one.readings, other.readings, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(one.by, other.by, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["rrbot", "kr300"])
def test_the_cost_of_a_step_is_known_before_its_derivatives_are_made(name: str) -> None:
    robot = load(shipped_robots()[name])
    symbolic = SymbolicModel(robot, [link_load(joint) for joint in robot.joint_names], free=("drives",))
    derivatives = StepDerivatives(symbolic, list(symbolic.parameters)[:4], symbolic.reading_names[:2], 0)

    counted = derivatives.cost(columns=0) / sensitivities.INTERPRETED
    made = sum(function.n_instructions() for function in derivatives._functions)

    assert 0.4 < counted / made < 2.5  # it decides how many windows are simulated, not what they say


# --------------------------------------------------------------------------- numbers
def cause(name: str, joint: str, **values: object) -> Planted:
    return Planted(name, joint, values)


COVERED = (
    (Case("lever", "rich", 61), cause("backlash", "swing", gap=0.009)),
    (Case("crane", "rich", 62), cause("load_friction", "elbow", coefficient=0.13)),
    (Case("crane", "rich", 63), cause("spring_hysteresis", "elbow", level=2.0, scale=0.0035)),
    (Case("crane", "rich", 64), cause("link_viscous_friction", "elbow", coefficient=1.75)),
    (Case("turret", "rich", 65, inexact=0.02), cause("motor_coulomb_friction", "turn", level=0.5)),
    (Case("lever", "rich", 66), cause("torque_delay", "swing", delay=0.0045)),
    (
        Case("turret", "slow", 67),
        cause("stribeck_friction", "turn", level=0.48, static_extra=0.48, velocity=0.06),
    ),
    (Case("crane", "rich", 68, "ragged"), cause("torque_gain", "shoulder", gain=-0.1)),
)


def recorded(k: int) -> tuple[Robot, Recording]:
    """The nominal robot and the recording of a case in COVERED."""
    case, planted = COVERED[k]
    return nominal(case.robot), as_recording(case.with_causes(planted))


@cache
def balanced(k: int) -> Fit:
    """What the diagnosis has of a case in COVERED once its cause is named."""
    _, planted = COVERED[k]
    problem = Problem(balances_of(*recorded(k)))
    effects = [Planned.of(planted.effect, planted.joint, dict(planted.parameters))]
    return at_own_level(fit(problem, effects))


@cache
def result(k: int) -> tuple[Finding, Estimation]:
    best = balanced(k)
    found, estimation = refined.refine(best, findings_of(best))
    return found[0], estimation


def deviations(finding: Finding, planted: Planted) -> list[float]:
    """Errors in their own standard errors."""
    out = []
    for name, true in planted.parameters.items():
        fitted = finding.parameters[name]
        assert isinstance(fitted, Fitted)
        out.append((float(np.ravel(fitted.value)[0]) - float(true)) / float(np.ravel(fitted.std)[0]))
    return out


@thorough
def test_standard_errors_cover_the_truth() -> None:
    """Eleven numbers of eight machines: their errors in standard errors are a standard normal sample or
    smaller (where a tolerance widens the error but the machine does not use it)."""
    z = np.array([x for k, (_, planted) in enumerate(COVERED) for x in deviations(result(k)[0], planted)])

    assert len(z) == 11
    # the simulation confirms numbers that no filter harms: a gap, frictions of a motor, a gain
    assert sum(result(k)[1].method == "output_error" for k in range(len(COVERED))) >= 4
    # of normal samples of this size 3 % hold one beyond 3, 1 % more than two beyond 2, 1 % an RMS above 1.5
    assert np.max(np.abs(z)) < 3.0, z
    assert np.sum(np.abs(z) > 2.0) <= 2, z
    assert np.sqrt(np.mean(z**2)) < 1.5, z


@thorough
def test_errors_are_smaller_than_those_of_the_balances() -> None:
    shares = []
    for k, (_, planted) in enumerate(COVERED):
        if result(k)[1].method != "output_error":
            continue
        best = balanced(k)
        for name, true in planted.parameters.items():
            before = abs(float(best.effects[0].values[name]) - float(true))
            after = abs(float(result(k)[0].parameters[name].value) - float(true))
            shares.append(after / before)

    # a filter rounds kinks off; a simulation does not
    assert np.median(shares) < 0.7, shares


def test_the_same_recording_gives_the_same_numbers() -> None:
    best = balanced(1)

    again = refined.refine(best, findings_of(best))[0][0]

    assert again.parameters == result(1)[0].parameters


def test_the_extended_model_holds_the_refined_numbers() -> None:
    finding, _ = result(1)

    assert finding.planned.values["coefficient"] == finding.parameters["coefficient"].value


def test_a_number_at_its_bound_is_reported() -> None:
    """Coulomb friction told as Stribeck's: there is no extra level to be found."""
    best = balanced(4)
    values = {"level": 0.5, "static_extra": 0.0, "velocity": 0.06}
    told = fit(best.problem, [Planned.of("stribeck_friction", "turn", values)], iterations=0)

    estimation = refined.from_balances(told, "")

    assert estimation.at_bounds == (("stribeck_friction.turn.static_extra", "lower"),)


def test_without_the_motors_torque_the_balances_numbers_stay() -> None:
    recorded = plant(
        ROBOTS / "lever.yaml",
        [Planted("spring_stiffness", "swing", {"scale": -0.2})],
        "rich",
        6.0,
        71,
        replace(NO_COMMAND, noisy_feedback=False),
    )
    robot, recording = nominal("lever"), as_recording(recorded)
    problem = Problem(balances_of(robot, recording))
    best = fit(problem, [effect("spring_stiffness", "swing", scale=-0.2)])
    before = findings_of(best)

    found, estimation = refined.refine(best, before)

    assert found == before
    assert (estimation.method, estimation.why) == ("balances", "not every motor torque is recorded")


def test_a_model_that_does_not_follow_keeps_the_balances_numbers() -> None:
    """Windows of a machine with twice the stiffness that is told to harden a little."""
    robot = nominal("lever")
    recording = as_recording(
        Case("lever", "rich", 72).with_causes(cause("spring_stiffness", "swing", scale=1.0))
    )
    problem = Problem(balances_of(robot, recording))
    best = at_own_level(fit(problem, [effect("hardening_spring", "swing", cubic=10.0)]))
    before = findings_of(best)

    found, estimation = refined.refine(best, before)

    assert found == before
    assert estimation.method == "balances"
    assert estimation.why


def test_windows_that_the_recordings_time_does_not_allow_are_left_out() -> None:
    best = balanced(0)
    every = Shooting(OpenModel(best.problem, best.effects, best.slots), 0.2)

    def slow(share: float) -> Fit:
        refinement = replace(USUAL.refinement, linearisation=share)
        balances = balances_of(*recorded(0), replace(USUAL, refinement=refinement))
        return fit(Problem(balances), best.effects)

    some = slow(0.5 * USUAL.refinement.linearisation * cost_share(every))
    few = Shooting(OpenModel(some.problem, some.effects, some.slots), 0.2)
    assert len(few.windows) == pytest.approx(0.5 * len(every.windows), abs=1)
    # from the begin to the end
    assert few.windows[-1].start > every.windows[-3].start

    found, estimation = refined.refine(slow(1e-9), findings_of(best))
    assert found == tuple(findings_of(best))
    assert "can be simulated in its own time" in estimation.why


def cost_share(shooting: Shooting) -> float:
    """What one linearisation of all windows costs, as a share of what it may."""
    opened, time = shooting.opened, shooting.recording.time
    seconds = shooting.steps * len(shooting.windows) * opened.derivatives(0).cost(shooting.columns)
    return float(seconds / (USUAL.refinement.linearisation * np.ptp(time)))


@pytest.mark.parametrize("later", [0, 2, 3])
def test_where_nothing_can_be_simulated_the_balances_numbers_stay(
    later: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From some linearisation on every window leaves the finite numbers: at the start, in the search, or when
    the error of the steps is asked for."""
    best = balanced(0)
    linearise, count = Shooting.linearise, 0

    def lost(self: Shooting, *given: object) -> list[Reduced]:
        nonlocal count
        count += 1
        windows = linearise(self, *given)  # type: ignore[arg-type]
        return [replace(w, energy=np.nan) for w in windows] if count > later else list(windows)

    monkeypatch.setattr(Shooting, "linearise", lost)
    before = findings_of(best)
    found, estimation = refined.refine(best, before)
    assert found == before
    assert estimation.why == "no window of the recording can be simulated with these numbers"


@thorough
def test_a_diagnosis_refines_unless_told_not_to() -> None:
    robot, recording = recorded(1)

    plain, fine = (diagnose(robot, [recording], refine=refine) for refine in (False, True))

    assert [(f.effect, f.joint) for f in fine.findings] == [(f.effect, f.joint) for f in plain.findings]
    assert fine.estimation is not None
    assert fine.estimation.method == "output_error"
    assert plain.estimation is not None
    assert (plain.estimation.method, plain.estimation.why) == ("balances", "no refinement was asked for")
    assert fine.findings[0].parameters != plain.findings[0].parameters
    held = fine.extend(robot).effects[-1].values["coefficient"]
    assert held == fine.findings[0].parameters["coefficient"].value


# --------------------------------------------------------------------------- what is said
def test_correlated_numbers_and_bounds_are_told() -> None:
    correlation = np.array([[1.0, -0.97, 0.1], [-0.97, 1.0, 0.2], [0.1, 0.2, 1.0]])
    names = ("end_stop.elbow.position", "end_stop.elbow.stiffness", "backlash.a.b.gap")
    estimation = Estimation(
        "output_error", "", names, correlation, (("backlash.a.b.gap", "lower"),), 0.2, 1.0
    )
    diagnosis = Diagnosis("causes", "", estimation=estimation)

    told = sentences.numbers(diagnosis)

    assert len(told) == 2
    assert "stiffness of end stop at elbow and position of end stop at elbow" in told[0]
    assert "-0.97" in told[0]
    assert "gap of backlash at a.b (lower)" in told[1]
    assert "0.2 s" in sentences.found_by(diagnosis)
    table = to_json(diagnosis)["estimation"]
    assert table["correlation"][0][1] == -0.97
    assert table["at_bounds"] == [{"parameter": "backlash.a.b.gap", "bound": "lower"}]
    assert to_json(Diagnosis("healthy", ""))["estimation"] is None
