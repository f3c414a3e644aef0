"""Planted recordings bear their effects and nothing else, and cases of them are complete."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pyarrow.parquet
import pytest
from planting import BEYOND, CATALOGUE, FULL, PERFECT, ROBOTS, Planted, plant, read_robot
from planting.cases import all_cases, single_cases, usual_effect, usual_excitation, write_case
from planting.catalogue import TWO_JOINTS
from planting.machine.by_hand import JOINT, LEVER, lever_gravity
from planting.machine.drive import Drive
from planting.machine.sensing import robot_noise

NAMES = ("lever", "turret", "crane", "gimbal", "scara", "reach")
GIMBAL = ROBOTS / "gimbal.yaml"


@cache
def lever_recording(
    excitation="rich", effect=None, sensors=PERFECT, seconds=3.0, rate=1000.0, since=None, **_
):
    effects = [] if effect is None else [replace(effect_of(effect), since=since)]
    return plant(LEVER, effects, excitation, seconds, 11, sensors, rate=rate)


def effect_of(name):
    q = lever_recording("steps").true["q"]
    special = {
        "torque_saturation": {"limit": 12.0},
        "end_stop": {"position": 0.5 * q.flat[np.abs(q).argmax()], "stiffness": 4000.0},
        "torque_speed_limit": {"stall": 12.0, "drop": 1.0},
        "rough_spot": {"level": 9.6, "position": 0.2, "width": 0.1},
    }
    if name in special:
        return Planted(name, JOINT, special[name])
    return usual_effect(name, "lever", JOINT, np.random.default_rng(5))


@pytest.mark.parametrize("effect", [e for e in (*CATALOGUE, *BEYOND) if e not in TWO_JOINTS])
def test_every_effect_leaves_a_mark_above_the_noise(effect):
    kind = usual_excitation(effect)
    changed, healthy = lever_recording(kind, effect), lever_recording(kind)
    noise = robot_noise("lever")
    marks = {
        name: np.sqrt(np.mean((changed.columns[name] - healthy.columns[name]) ** 2))
        / noise[name.split(".")[0]]
        for name in changed.columns
        if name.split(".")[0] in noise
    }
    assert max(marks.values()) > 3, marks


def test_a_healthy_machine_closes_its_balances():
    robot = read_robot(GIMBAL)
    recorded = plant(GIMBAL, [], "rich", 4, 3, PERFECT, rate=1000)
    channel = {
        c: np.stack([recorded.columns[f"{c}.{j}"] for j in robot.joints], 1)
        for c in ("q", "dq", "theta", "dtheta", "tau_t", "tau_m")
    }
    step = 1e-3
    mean_spring = (channel["tau_t"][1:] + channel["tau_t"][:-1]) / 2
    inertial = robot.motor_inertia * np.diff(channel["dtheta"], axis=0) / step
    viscous = robot.motor_damping * np.diff(channel["theta"], axis=0) / step
    motor = channel["tau_m"][:-1] - inertial - viscous - mean_spring
    assert np.abs(motor).max() < 5e-3  # the trapezoid's error of tau_t over a tick, against 30 N m of torque
    phi, dphi = channel["theta"] - channel["q"], channel["dtheta"] - channel["dq"]
    np.testing.assert_allclose(channel["tau_t"], robot.stiffness * phi + robot.damping * dphi, atol=1e-9)
    model = pin.buildModelFromUrdf(str(ROBOTS / "gimbal.urdf"))
    data, dq = model.createData(), channel["dq"]
    ddq = (8 * (dq[3:-1] - dq[1:-3]) - (dq[4:] - dq[:-4])) / (12 * step)
    link = [pin.rnea(model, data, *x) for x in zip(channel["q"][2:-2], dq[2:-2], ddq, strict=True)]
    # jumps of the held command reach the third derivative of dq, which the difference quotient feels
    np.testing.assert_allclose(link, channel["tau_t"][2:-2], atol=1e-2)


@pytest.mark.parametrize("noisy", [True, False])
def test_the_controller_follows_its_law(noisy):
    robot = read_robot(LEVER)
    sensors = replace(FULL, noisy_feedback=noisy)
    recorded = plant(LEVER, [], "steps", 3, 2, sensors, rate=1000)
    column = {
        c: recorded.columns[f"{c}.{JOINT}"]
        for c in ("theta", "dtheta", "tau_m", "theta_ref", "tau_ff", "q_ref")
    }
    theta, dtheta = (column[c] if noisy else recorded.true[c][:, 0] for c in ("theta", "dtheta"))
    law = column["tau_ff"] + robot.kp[0] * (column["theta_ref"] - theta) - robot.kd[0] * dtheta
    np.testing.assert_allclose(column["tau_m"], np.clip(law, -120, 120), atol=1e-9)
    np.testing.assert_allclose(column["tau_ff"], lever_gravity(column["q_ref"]), atol=1e-9)
    np.testing.assert_allclose(
        column["theta_ref"], column["q_ref"] + column["tau_ff"] / robot.stiffness[0], atol=1e-12
    )


def test_the_command_is_clipped_by_the_controller(tmp_path):
    text = LEVER.read_text().replace("torque_limit: 120", "torque_limit: 9")
    (tmp_path / "lever.urdf").write_text((ROBOTS / "lever.urdf").read_text())
    (tmp_path / "weak.yaml").write_text(text)
    # reference shares shrink with the limit, so a payload is what drives it into the clip
    load = Planted("payload", JOINT, {"mass": 6.0, "position": [0, 0, -0.4]})
    recorded = plant(tmp_path / "weak.yaml", [load], "rich", 3, 2, PERFECT)
    assert np.abs(recorded.columns[f"tau_m.{JOINT}"]).max() == 9.0


@pytest.mark.parametrize(
    ("effect", "parameters", "law"),
    [
        ("torque_gain", {"gain": -0.1}, lambda tau: 0.9 * tau),
        ("torque_offset", {"offset": 2.0}, lambda tau: tau + 2.0),
        ("torque_saturation", {"limit": 10.0}, lambda tau: np.clip(tau, -10, 10)),
    ],
)
def test_command_laws_act_after_the_recorded_command(effect, parameters, law):
    recorded = plant(LEVER, [Planted(effect, JOINT, parameters)], "steps", 3, 2, PERFECT, rate=1000)
    commanded = recorded.columns[f"tau_m.{JOINT}"]
    np.testing.assert_allclose(recorded.true["tau"][:, 0], law(commanded), atol=1e-12)
    assert np.abs(commanded).max() > 10


def test_torque_delay_shifts_the_held_command():
    delay = 0.0034  # 3 whole ticks and 2 of the 5 substeps
    recorded = plant(
        LEVER, [Planted("torque_delay", JOINT, {"delay": delay})], "rich", 2, 2, PERFECT, rate=1000
    )
    commanded, applied = recorded.columns[f"tau_m.{JOINT}"], recorded.true["tau"][:, 0]
    np.testing.assert_array_equal(
        applied[4:], commanded[:-4]
    )  # at a tick, the command of 3.4 ticks ago: the 4th
    within = Drive(read_robot(LEVER), [Planted("torque_delay", JOINT, {"delay": 0.0033})], np.zeros(1), 9, 5)
    torque = [within.apply(k, k * 1e-3, np.array([float(k)]))[:, 0] for k in range(9)]
    # switch at 3.3 ticks: the second substep of a tick is half old, half new
    np.testing.assert_allclose(torque[8], [4, 4.5, 5, 5, 5], atol=1e-9)


def test_backlash_is_free_inside_its_gap():
    gap, robot = 0.01, read_robot(LEVER)
    recorded = plant(LEVER, [Planted("backlash", JOINT, {"gap": gap})], "rich", 4, 6, PERFECT)
    phi = (recorded.true["theta"] - recorded.true["q"])[:, 0]
    dphi = (recorded.true["dtheta"] - recorded.true["dq"])[:, 0]
    inside = np.abs(phi) < gap / 2 - 1e-8
    assert inside.any() and not inside.all()
    assert np.abs(recorded.true["tau_t"][inside, 0]).max() == 0.0
    engaged = robot.stiffness[0] * (phi - np.sign(phi) * gap / 2) + robot.damping[0] * dphi
    np.testing.assert_allclose(recorded.true["tau_t"][~inside, 0], engaged[~inside], atol=1e-9)


@pytest.mark.parametrize(
    "effect",
    [
        "motor_coulomb_friction",
        "torque_gain",
        "payload",
        "end_stop",
        "link_encoder_offset",
        "dahl_friction",
        "periodic_disturbance",
        "torque_speed_limit",
        "quadratic_drag",
    ],
)
def test_since_switches_on_during_the_recording(effect):
    kind = usual_excitation(effect)
    healthy, always = lever_recording(kind), lever_recording(kind, effect)
    late = lever_recording(kind, effect, since=1.5)
    before, last = late.columns["time"] < 1.5, slice(-200, None)
    change = {}
    for name in ("q", "theta"):
        a, b, c = (r.columns[f"{name}.{JOINT}"] for r in (late, healthy, always))
        # locating the reversals of an absent friction moves the state by rounding only
        np.testing.assert_allclose(a[before], b[before], atol=1e-9)
        change[name] = np.abs(a - b)[~before].max()
        assert np.abs(a - c)[last].max() < 0.1 * change[name] + 2e-4  # what 1.3 s leave of the transients
    assert max(change.values()) > 5e-4  # 20 times the encoders' noise


@pytest.mark.parametrize("name", NAMES)
def test_the_robots_follow_their_references_from_rest(name):
    robot = read_robot(ROBOTS / f"{name}_exact.yaml")
    recorded = plant(ROBOTS / f"{name}_exact.yaml", [], "rich", 3, 8, PERFECT)
    q_ref = np.stack([recorded.columns[f"q_ref.{j}"] for j in robot.joints], 1)
    assert np.abs(recorded.true["dq"][0]).max() < 1e-2  # settled
    assert np.abs(np.gradient(q_ref, 2e-3, axis=0)[0]).max() < 1e-2
    assert np.abs(recorded.true["q"] - q_ref).max() < 0.2
    assert (np.abs(recorded.true["tau"]) < robot.torque_limit).all()


def test_what_cannot_be_planted_is_refused():
    with pytest.raises(ValueError, match="unknown effect 'friktion'"):
        Planted("friktion", JOINT, {})
    with pytest.raises(ValueError, match="backlash takes"):
        Planted("backlash", JOINT, {"width": 0.1})
    with pytest.raises(ValueError, match="belongs to a joint"):
        Planted("backlash", None, {"gap": 0.1})
    gap = Planted("backlash", JOINT, {"gap": 0.01})
    with pytest.raises(ValueError, match="planted twice"):
        plant(LEVER, [gap, gap], "rich", 1, 1, FULL)
    with pytest.raises(ValueError, match="lever has no joint 'knee'; it has swing"):
        plant(LEVER, [Planted("backlash", "knee", {"gap": 0.01})], "rich", 1, 1, FULL)
    with pytest.raises(ValueError, match="unknown excitation 'wild'"):
        plant(LEVER, [], "wild", 1, 1, FULL)
    with pytest.raises(ValueError, match="at most the control rate"):
        plant(LEVER, [], "rich", 1, 1, FULL, rate=2000)


def test_cases_cover_the_catalogue_and_repeat():
    cases = all_cases(1)
    assert len({case.name for case in cases}) == len(cases)
    singles = [case for case in cases if case.name.startswith("single_")]
    assert {case.effects[0].effect for case in singles} == set(CATALOGUE)
    later = single_cases(1, effects=tuple(BEYOND))
    assert [case.effects[0].effect for case in later] == list(BEYOND)
    few = ("backlash", "payload", "torque_gain")
    assert single_cases(1, effects=few) == single_cases(1, effects=few) != single_cases(2, effects=few)


def test_a_written_case_has_the_layout_of_a_case_folder(tmp_path):
    case = replace(single_cases(1, effects=("encoder_eccentricity",))[0], seconds=1.0)
    late = replace(
        case, name="late", effects=(replace(effect_of("torque_gain"), since=0.5),), robot="lever_exact"
    )
    for each in (case, late):
        write_case(each, tmp_path)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert sorted(truth) == ["late", "single_encoder_eccentricity"]
    entry = truth[case.name]["truth"][0]
    assert entry["since"] is None and set(entry["parameters"]) == {"amplitude", "phase"}
    assert entry["words"]["channel"] in ("q", "theta")
    assert truth["late"]["truth"][0]["since"] == 0.5
    for name, table in truth.items():
        assert (tmp_path / "robots" / f"{table['robot']}.yaml").exists()
        rows = [
            pyarrow.parquet.read_table(tmp_path / name / f"{part}.parquet").num_rows
            for part in ("train", "fresh")
        ]
        assert rows == [500, 250]
