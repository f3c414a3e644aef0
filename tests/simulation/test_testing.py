"""flexjoint.simulation.testing: every check passes where it should, fails where it should, and says why."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.robots.arms import PENDULUM, SPATIAL, make, waves

from flexjoint import testing
from flexjoint.core.errors import FlexJointError, UnknownNameError
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import renumbered
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop, rollout
from flexjoint.simulation.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
TOLERANCES: dict[str, float | testing.Tolerance] = {
    "q": testing.Tolerance(1e-9, "the last bit moves 1e-14, a spring off by 1 % 1e-4"),
    "theta": 1e-9,
    "tau_t": 1e-7,
    "tau_m": 1e-7,
}


@pytest.fixture(autouse=True)
def nothing_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where somebody records golden files of other tests."""
    monkeypatch.delenv("FLEXJOINT_GOLDEN", raising=False)


def arm(*effects: Planned, K: float = 1.0) -> FlexibleJointModel:
    """A pendulum on a spring, K times as stiff as it should be."""
    robot = make(PENDULUM)
    changes = {"drive.joint.stiffness": K * robot.joints[0].drive.K}
    return FlexibleJointModel(*renumbered(robot, effects, changes))


def swinging(model: FlexibleJointModel, seconds: float = 1.0, scheme: str | None = None) -> Trajectory:
    """Under torques that vary, from a push."""
    start = model.rest()
    start.v = start.v + 1.0
    torque = waves(len(model.joints), round(seconds * 1000), 1000.0, 10.0)
    return rollout(
        model, start, torque, RunOptions(rate=1000.0, scheme=scheme or "linearly_implicit_midpoint")
    )


def held(model: FlexibleJointModel, q: float = 0.5, seconds: float = 3.0) -> tuple[Trajectory, np.ndarray]:
    """Told to hold without its gravity torque; theta_ref."""
    ticks, n = round(seconds * model.robot.rates.control), len(model.joints)
    rest = equilibrium(model, np.full(model.nq, q))
    rows = {"q_ref": np.full((ticks, n), q), "theta_ref": np.full((ticks, n), q)}
    rows |= {"dtheta_ref": np.zeros((ticks, n)), "tau_ff": np.zeros((ticks, n))}
    start = model.rest(np.full(model.nq, q))
    start.theta = rest.theta[0, list(model.flexible)]
    return closed_loop(model, start, law_of(model.robot), rows, RunOptions(rate=1000.0)), np.full(n, q)


def kept(model: FlexibleJointModel) -> testing.GoldenRun:
    return testing.golden_run(model, swinging(model), 50.0, settings={"push": 1.0})


# --- golden runs -----------------------------------------------------------------------------------------
def test_a_run_equals_its_own_golden_file(tmp_path: Path) -> None:
    path, run = tmp_path / "new" / "arm.parquet", kept(arm())
    testing.record_golden(run, path)
    again = testing.read_golden(path)
    assert again.about == run.about
    assert all(np.array_equal(again.signals[name], run.signals[name]) for name in run.signals)
    testing.assert_golden(kept(arm()), path, TOLERANCES)
    assert [p.name for p in path.parent.iterdir()] == ["arm.parquet"]


def test_a_stiffness_that_is_off_is_named_with_signal_time_and_size(tmp_path: Path) -> None:
    path = tmp_path / "arm.parquet"
    testing.record_golden(kept(arm()), path)
    with pytest.raises(AssertionError) as failure:
        testing.assert_golden(kept(arm(K=1.01)), path, TOLERANCES)
    said = str(failure.value)
    assert re.search(r"3 of 4 signals differ, first \S+ at 0\.\d+ s", said)  # the torque was given
    rows = [line.split() for line in said.splitlines() if re.match(r"  (q|theta|tau_t)\.joint \[", line)]
    times = [float(row[-8].rstrip("s")) for row in rows]
    assert len(times) == 3 and times == sorted(times, reverse=True)
    assert "drive.joint.stiffness: 340 then, 343.4 now" in said
    assert "tolerance of q: the last bit" in said
    assert "FLEXJOINT_GOLDEN=record" in said


def test_differences_are_sorted_and_measured() -> None:
    run = kept(arm())
    off = run.signals["q.joint"].copy()
    off[10:] += 3e-3
    off[20] += 1e-3
    other = replace(run, signals={**run.signals, "q.joint": off})
    found = testing.differences(other, run, {**TOLERANCES, "q.joint": 1e-6})
    assert found[0].signal == "q.joint"
    assert found[0].largest == pytest.approx(4e-3)
    assert found[0].times == pytest.approx(4e3)
    assert (found[0].first, found[0].at) == pytest.approx((0.2, 0.4))
    assert found[0].rms == pytest.approx(3e-3 * np.sqrt(41 / 51), rel=0.01)
    assert all(item.first is None and item.largest == 0.0 for item in found[1:])


def test_a_run_that_is_not_finite_differs() -> None:
    run = kept(arm())
    broken = replace(run, signals={**run.signals, "q.joint": np.full(len(run.time), np.nan)})
    assert testing.differences(broken, run, TOLERANCES)[0].largest == np.inf
    with pytest.raises(FlexJointError, match="not finite"):
        testing.record_golden(broken, "never.parquet")
    assert not Path("never.parquet").exists()


def test_a_motion_is_refused_with_what_to_pass() -> None:
    model = arm()
    with pytest.raises(FlexJointError, match=r"got a Trajectory; pass golden_run\(model, trajectory"):
        testing.assert_golden(swinging(model), "x.parquet", TOLERANCES)  # type: ignore[arg-type]


def test_a_missing_file_fails_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=r"does not exist.*FLEXJOINT_GOLDEN=record"):
        testing.assert_golden(kept(arm()), tmp_path / "arm.parquet", TOLERANCES)
    assert not list(tmp_path.iterdir())


def test_the_environment_records_anew_and_the_test_fails_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "arm.parquet"
    testing.record_golden(kept(arm()), path)
    monkeypatch.setenv("FLEXJOINT_GOLDEN", "record")
    with pytest.raises(AssertionError, match="recorded, nothing was compared"):
        testing.assert_golden(kept(arm(K=1.01)), path, TOLERANCES)
    monkeypatch.setenv("FLEXJOINT_GOLDEN", "please")
    with pytest.raises(FlexJointError, match="expected record or nothing, got 'please'"):
        testing.assert_golden(kept(arm(K=1.01)), path, TOLERANCES)
    monkeypatch.delenv("FLEXJOINT_GOLDEN")
    testing.assert_golden(kept(arm(K=1.01)), path, TOLERANCES)


def test_a_run_of_other_settings_is_not_compared(tmp_path: Path) -> None:
    path = tmp_path / "arm.parquet"
    testing.record_golden(kept(arm()), path)
    other = testing.golden_run(arm(), swinging(arm()), 50.0, settings={"push": 2.0})
    with pytest.raises(AssertionError, match=r"another run(.|\n)*push: 1.0 then, 2.0 now"):
        testing.assert_golden(other, path, TOLERANCES)


def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    run = kept(arm())
    shorter = replace(run, time=run.time[:-1], signals={n: v[:-1] for n, v in run.signals.items()})
    with pytest.raises(FlexJointError, match="51 rows from 0 to 1 s, the run 50 rows"):
        testing.differences(shorter, run, TOLERANCES)
    with pytest.raises(FlexJointError, match=r"with height.hand that the run lacks"):
        testing.differences(run, run.with_signals({"height.hand": run.time}), {**TOLERANCES, "height": 1e-3})
    with pytest.raises(FlexJointError, match=r"none for theta.joint"):
        testing.differences(run, run, {"q": 1e-9})
    with pytest.raises(UnknownNameError, match="did you mean 'tau_t'"):
        testing.differences(run, run, {**TOLERANCES, "tau": 1e-9})
    with pytest.raises(FlexJointError, match="expected a number >= 0, got -1"):
        testing.differences(run, run, {**TOLERANCES, "q": -1.0})
    with pytest.raises(FlexJointError, match="one of this name"):
        run.with_signals({"q.joint": run.time})
    with pytest.raises(FlexJointError, match="expected 51 values"):
        run.with_signals({"height": run.time[1:]})
    with pytest.raises(FlexJointError, match="divisor of the physics rate 1000 Hz, got 300"):
        testing.golden_run(arm(), swinging(arm()), 300.0)
    with pytest.raises(UnknownNameError, match="channel 'base'"):
        testing.golden_run(arm(), swinging(arm()), 50.0, ["base"])
    (tmp_path / "no.parquet").write_bytes(b"nothing")
    with pytest.raises(FlexJointError, match="is no golden file"):
        testing.read_golden(tmp_path / "no.parquet")
    with pytest.raises(FlexJointError, match=r"ends in .parquet"):
        testing.record_golden(run, tmp_path / "run.csv")


# --- determinism -----------------------------------------------------------------------------------------
def seeded() -> dict[str, np.ndarray]:
    return {"noise": np.random.default_rng(3).standard_normal(5)}


def simulated() -> Trajectory:
    return swinging(arm(), 0.1)


def unseeded() -> dict[str, np.ndarray]:
    return {"noise": np.random.default_rng().standard_normal(5)}


def of_this_process() -> dict[str, np.ndarray]:
    """Alike within a process: what a hash of strings, or a cache, does to a simulation."""
    return {"q": np.array([0.0, float(hash("q"))])}


def test_determinism_is_of_bits_and_of_processes() -> None:
    testing.assert_deterministic(simulated)
    testing.assert_deterministic(seeded, new_process=True)
    with pytest.raises(AssertionError, match="a second call gives other bits in noise, first in row 0 of 5"):
        testing.assert_deterministic(unseeded)
    zeros = iter([0.0, -0.0])
    with pytest.raises(AssertionError, match="other bits in q"):
        testing.assert_deterministic(lambda: {"q": np.array([next(zeros)])})
    testing.assert_deterministic(of_this_process)


def test_a_process_that_differs_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", "random")
    with pytest.raises(AssertionError, match="a new process gives other bits in q, first in row 1"):
        testing.assert_deterministic(of_this_process, new_process=True)


def test_what_a_new_process_cannot_import_is_said() -> None:
    with pytest.raises(FlexJointError, match="stands by its name in a module"):
        testing.assert_deterministic(lambda: {"q": np.zeros(3)}, new_process=True)
    with pytest.raises(FlexJointError, match="got float"):
        testing.assert_deterministic(lambda: 1.0)  # type: ignore[arg-type, return-value]


# --- energy ----------------------------------------------------------------------------------------------
# measured shares: 2e-7 linearly implicit midpoint, 1e-5 RK4, 1.2e-3 semi-implicit Euler, all at 1 kHz
@pytest.mark.parametrize("scheme, share", [("linearly_implicit_midpoint", 1e-6), ("rk4", 5e-5)])
def test_the_energy_balance_closes(scheme: str, share: float) -> None:
    model = FlexibleJointModel(make(SPATIAL))
    balance = testing.assert_energy_balance(model, swinging(model, scheme=scheme), share)
    assert balance.exchanged > 1.0
    assert np.max(np.abs(balance.lost)) > 0.1
    assert np.ptp(balance.springs) > 0.01


def test_torques_of_effects_are_counted() -> None:
    model = arm(effect("cable_spring", "joint"), effect("link_viscous_friction", "joint", coefficient=0.3))
    balance = testing.assert_energy_balance(model, swinging(model), 1e-6)
    assert np.max(np.abs(balance.effects)) > 0.1


def test_energy_from_nowhere_is_found() -> None:
    """A motion judged by a model whose motor is 1 % lighter: its energy no longer adds up."""
    tape = swinging(arm())
    robot = make(PENDULUM)
    lighter = {"drive.joint.motor_inertia": 0.99 * robot.joints[0].drive.B}
    with pytest.raises(AssertionError, match=r"energy is not kept by \S+ J at") as failure:
        testing.assert_energy_balance(FlexibleJointModel(*renumbered(robot, (), lighter)), tape, 1e-5)
    assert "work of motors" in str(failure.value)


def test_dry_friction_takes_energy_and_never_gives() -> None:
    rubs = arm(effect("motor_coulomb_friction", "joint", level=0.3))
    tape = swinging(rubs)
    assert testing.assert_energy_balance(rubs, tape, 1e-6).missing[-1] > 0.1
    with pytest.raises(AssertionError, match="energy is not kept"):
        testing.assert_energy_balance(arm(), tape)
    # the same motion run backwards: friction would drive
    back = replace(tape, **{n: getattr(tape, n)[::-1].copy() for n in ("q", "v", "theta", "dtheta", "tau_m")})
    back = replace(back, v=-back.v, dtheta=-back.dtheta)
    with pytest.raises(AssertionError, match="only take energy, but it grew"):
        testing.assert_energy_balance(rubs, back)


def test_energy_that_is_not_counted_is_refused() -> None:
    for law in ("backlash", "torque_gain", "hardening_spring"):
        model = arm(effect(law, "joint"))
        with pytest.raises(FlexJointError, match=law):
            testing.energy_balance(model, swinging(arm()))
    stiffer = arm(effect("spring_stiffness", "joint", scale=0.1))
    testing.assert_energy_balance(stiffer, swinging(stiffer), 1e-6)


# --- rest and limits -------------------------------------------------------------------------------------
def test_the_static_law_holds_at_rest_and_not_otherwise() -> None:
    model = FlexibleJointModel(make(SPATIAL))
    tape, theta_ref = held(model)
    none = np.zeros(3)
    testing.assert_static_law(model, tape, theta_ref, none, tolerance=1e-5)  # after 3 s 2e-6 are left
    soft = FlexibleJointModel(*renumbered(model.robot, (), {"drive.roll.stiffness": 240.0}))
    with pytest.raises(AssertionError, match=r"in 1 joints:\n  roll: rests at") as failure:
        testing.assert_static_law(soft, tape, theta_ref, none)
    assert "N m" in str(failure.value)
    testing.assert_static_law(soft, tape, theta_ref, none, joints=["yaw", "pitch"])
    with pytest.raises(AssertionError, match=r"not at rest in the last 0.5 s(.|\n)*yaw moves"):
        testing.assert_static_law(model, swinging(model), theta_ref, none)
    with pytest.raises(FlexJointError, match=r"tau_ff: expected \(3,\)"):
        testing.assert_static_law(model, tape, theta_ref, none[:2])
    with pytest.raises(FlexJointError, match="at least 10 s"):
        testing.assert_static_law(model, tape, theta_ref, none, seconds=10.0)


def test_broken_limits_are_named() -> None:
    robot = make(PENDULUM)
    limits = robot.model.copy()
    limits.velocityLimit, limits.upperPositionLimit = np.array([2.0]), np.array([0.4])
    model = FlexibleJointModel(replace(robot, model=limits))
    tape = swinging(model)
    with pytest.raises(AssertionError) as failure:
        testing.assert_limits(model, tape)
    said = str(failure.value)
    assert re.search(
        r"position of joint: q reaches 0\.\d+ rad at .*limits \S+ to 0.4; first at 0\.\d+ s", said
    )
    assert "torque" not in said
    free = FlexibleJointModel(robot)
    testing.assert_limits(free, tape)
    testing.assert_limits(free, tape, ["spring torque"])
    at_limit = replace(tape, tau_m=np.full_like(tape.tau_m, robot.joints[0].torque_limit))
    with pytest.raises(AssertionError, match="torque of joint: tau_m reaches 45 N m"):
        testing.assert_limits(free, at_limit, ["torque"])
    with pytest.raises(UnknownNameError, match="kind of limit 'power'"):
        testing.assert_limits(free, tape, ["power"])


# --- the example -----------------------------------------------------------------------------------------
def test_the_example_of_the_page_is_the_file_and_passes(tmp_path: Path) -> None:
    """In a folder of its own, as a user's."""
    example = ROOT / "examples" / "test_my_robot.py"
    (shown,) = re.findall(
        r"^```python\n(.*?)^```",
        (ROOT / "docs" / "howto" / "testing.md").read_text(),
        re.DOTALL | re.MULTILINE,
    )
    assert shown == example.read_text(encoding="utf-8")
    shutil.copy(example, tmp_path)
    shutil.copytree(example.parent / "golden", tmp_path / "golden")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", example.name]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout
    assert "5 passed" in done.stdout
