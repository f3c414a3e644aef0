"""A prismatic joint: metres for radians, newtons for newton metres. The machine is a mass on a screw, stepped
here by equations of its own."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from support.diagnose_cases import summary
from support.thorough import thorough

import flexjoint
from flexjoint import report
from flexjoint.core.units import of_joint
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.deviations import judged_energy
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.search.criteria import price
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, catalogue, effect
from flexjoint.recording.table import Recording, make
from flexjoint.report import terminal
from flexjoint.robot.robot import Robot

RATE, SUBSTEPS = 500, 20
FRICTIONS = {"motor_coulomb_friction", "asymmetric_friction", "torque_offset"}
MASS, VISCOUS, COULOMB, OFFSET = 95.0, 203.0, 20.4, -3.2  # kg, N s/m, N, N
URDF = """
<robot name="screw">
  <link name="base"/>
  <link name="cart">
    <inertial>
      <mass value="60"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="slide" type="prismatic">
    <parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="400" velocity="1"/>
  </joint>
</robot>
"""
YAML = """
name: screw
urdf: screw.urdf
rates: {physics: 1000, control: 500}
tolerance: {inertial: 0.1, stiffness: 0.05, damping: 0.3, torque: 0.02}
joints:
  slide: {stiffness: .inf, motor_inertia: 35, motor_damping: 200, torque_limit: 400, kp: 20000, kd: 3000}
"""


def robot_in(folder: Path, inertial: float) -> Robot:
    (folder / "screw.urdf").write_text(URDF)
    (folder / "screw.yaml").write_text(YAML.replace("inertial: 0.1", f"inertial: {inertial:g}"))
    return flexjoint.load_robot(str(folder / "screw.yaml"))


@pytest.fixture(scope="module")
def screw(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return robot_in(tmp_path_factory.mktemp("screw"), inertial=0.1)


@pytest.fixture(scope="module")
def sure(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """The robot with a mass that is better known."""
    return robot_in(tmp_path_factory.mktemp("sure"), inertial=0.05)


def recorded(
    coulomb: float,
    offset: float,
    disturbance: float = 0.0,
    mass: float = MASS,
    seed: int = 5,
    jump: float = 1.0,
) -> Recording:
    """A table that goes to and fro under a PD, as its motor's encoder sees it: 1 um steps, 1 um of noise. The
    recorded command differs from the force by a `disturbance` [N], new at each sample. A second motion comes
    in at 3 s, at once or (with no `jump`) by and by."""
    t = np.arange(0.0, 8.0, 1.0 / RATE)
    goal = 0.1 * (1 - np.cos(2 * np.pi * t / 3)) * (0.5 + 0.5 * np.sin(2 * np.pi * t / 8) ** 2)
    late = np.clip((t - 3.0) / 0.5, 0.0, 1.0)
    share = jump * (t > 3.0) + (1.0 - jump) * late**2 * (3.0 - 2.0 * late)
    goal += 0.01 * np.sin(2 * np.pi * 1.3 * t) * share
    goal_speed = np.gradient(goal, t)
    place, speed, h = 0.0, 0.0, 1.0 / RATE / SUBSTEPS
    places, forces = np.empty_like(t), np.empty_like(t)
    for k in range(t.size):
        places[k], forces[k] = place, 20000 * (goal[k] - place) + 3000 * (goal_speed[k] - speed)
        for _ in range(SUBSTEPS):
            pull = forces[k] + offset - VISCOUS * speed
            if speed == 0.0 and abs(pull) <= coulomb:
                continue
            after = speed + h / mass * (pull - coulomb * np.sign(speed or pull))
            after = 0.0 if after * speed < 0.0 else after  # it stops before it turns
            place += 0.5 * h * (speed + after)
            speed = after
    noise, other = np.random.default_rng(seed).normal(size=(2, t.size))
    theta = np.round(places / 1e-6 + noise) * 1e-6
    return make(t, {("theta", "slide"): theta, ("tau_m", "slide"): forces + disturbance * other})


@pytest.fixture(scope="module")
def rubbing() -> Recording:
    return recorded(COULOMB, OFFSET, disturbance=0.5)


@pytest.fixture(scope="module")
def found(screw: Robot, rubbing: Recording) -> Diagnosis:
    return diagnose(screw, [rubbing], refine=False)


def test_the_friction_of_a_linear_drive(found: Diagnosis) -> None:
    """A Coulomb friction and a constant force are, where little rests, two levels of one friction. More than
    the sensors' noise is left, beside which a motor without force and a mass without inertia would do."""
    named = {f.planned.effect.name: f for f in found.findings}
    if "asymmetric_friction" in named:
        levels = named["asymmetric_friction"].parameters
        told = [levels[name].value for name in ("level_positive", "level_negative")]  # type: ignore[union-attr]
    else:
        level, force = (
            named[name].parameters[key].value  # type: ignore[union-attr]
            for name, key in (("motor_coulomb_friction", "level"), ("torque_offset", "offset"))
        )
        told = [level - force, level + force]  # type: ignore[operator]
    assert told == pytest.approx([COULOMB - OFFSET, COULOMB + OFFSET], rel=0.02)
    assert not {tie.effect for f in found.findings for tie in f.indistinguishable} & {
        "torque_gain",
        "motor_inertia",
    }


def test_nothing_is_named_on_a_linear_drive_as_its_model_has_it(screw: Robot) -> None:
    """Its reference jumps at 3 s, and the machine, by its own steps, is 0.05 ms early then: more than noise,
    of which a motor without force and a mass without inertia would leave nothing."""
    assert diagnose(screw, [recorded(0.0, 0.0)], refine=False).findings == ()


def test_what_is_said_of_a_linear_drive_is_in_metres_and_newtons(
    screw: Robot, rubbing: Recording, found: Diagnosis
) -> None:
    units = {p["unit"] for f in to_json(found)["findings"] for p in f["parameters"].values()}
    assert units == {"N"}
    said = io.StringIO()
    terminal.summary(found, Console(file=said, width=200))
    page = report.render(found, screw, rubbing, before=compare(screw, rubbing))
    text = re.sub(
        r"<style.*?</style>|<script.*?</script>|<svg.*?</svg>|base64,[^\"]*|<[^>]*>",
        "",
        page,
        flags=re.DOTALL,
    )
    text = re.sub(r"phase \S+ rad|SI, radians", "", text)
    for words in (said.getvalue(), text):
        assert re.search(r"\d N\b", words) and not re.search(r"\bN m\b|\brad\b", words), words


@pytest.mark.parametrize(
    ("turning", "sliding"),
    [
        ("rad", "m"),
        ("rad/s²", "m/s²"),
        ("N m", "N"),
        ("N m s/rad", "N s/m"),
        ("N m s^2/rad^2", "N s^2/m^2"),
        ("kg m^2", "kg"),
        ("kg", "kg"),
        ("1", "1"),
    ],
)
def test_units_of_a_joint_that_slides(turning: str, sliding: str) -> None:
    assert (of_joint(turning, False), of_joint(turning, True)) == (turning, sliding)


def test_a_phase_is_an_angle_at_any_joint() -> None:
    ripple = {p.name: p.unit_at(True) for p in catalogue()["cogging"].params}
    assert (ripple["amplitude"], ripple["phase"]) == ("N", "rad")


def test_less_of_everything_is_no_better(screw: Robot) -> None:
    """An equation times 0.6 (torque, inertia and frictions) is as wrong as before."""
    told = effect("motor_coulomb_friction", "slide", level=COULOMB)
    less = [
        effect("torque_gain", "slide", gain=-0.4),
        effect("payload", "slide", mass=-0.4 * 60.0),
        effect("motor_inertia", "slide", scale=-0.4),
        effect("motor_viscous_friction", "slide", coefficient=-0.4 * 200.0),
        told.with_values({"level": 0.6 * COULOMB}),
    ]
    problem = Problem(balances_of(screw, recorded(COULOMB, 0.0, disturbance=5.0)))
    problem = problem.at(problem.plausible_level(problem.residual([told])))
    all_of_it, of_less = (judged_energy(problem, problem.residual(e), e) for e in ([told], less))
    # 1.27 (what tolerances take on is counted along the nominal model's columns), and not 0.36
    assert all_of_it < of_less < 1.4 * all_of_it


@thorough
def test_a_mass_on_a_linear_drive(sure: Robot) -> None:
    """It is an inertia of the motor as well, and, with a viscous friction that is off, nearly less torque and
    less friction, too: that alone is not its name."""
    result = diagnose(sure, [recorded(COULOMB, OFFSET, mass=MASS + 45.0, jump=0.0)], refine=False)
    named = {f.effect for f in result.findings}
    cause = {"payload", "motor_inertia"} & named
    assert cause and named <= {*cause, *FRICTIONS}, summary(result)


def test_where_a_payload_sits_that_only_moves_straight_costs_nothing(sure: Robot) -> None:
    problem = Problem(balances_of(sure, recorded(0.0, 0.0, mass=MASS + 20.0)))
    load, inertia = (
        fit(problem, [Planned.of(name, "slide", {number: value})])
        for name, number, value in (("payload", "mass", 20.0), ("motor_coulomb_friction", "level", 1.0))
    )
    assert price(load) == price(inertia) == USUAL.search.price
