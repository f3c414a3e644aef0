"""A prismatic joint: metres for radians, newtons for newton metres. The machine is a mass on a screw, stepped
here by equations of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexjoint
from flexjoint.diagnose import diagnose
from flexjoint.recording import Recording, make
from flexjoint.robot import Robot

RATE, SUBSTEPS = 500, 20
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


@pytest.fixture(scope="module")
def screw(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    folder: Path = tmp_path_factory.mktemp("screw")
    (folder / "screw.urdf").write_text(URDF)
    (folder / "screw.yaml").write_text(YAML)
    return flexjoint.load_robot(str(folder / "screw.yaml"))


def recorded(coulomb: float, offset: float, disturbance: float = 0.0) -> Recording:
    """A table that goes to and fro under a PD, as its motor's encoder sees it: 1 um steps, 1 um of noise. The
    recorded command differs from the force by a `disturbance` [N], new at each sample."""
    t = np.arange(0.0, 8.0, 1.0 / RATE)
    goal = 0.1 * (1 - np.cos(2 * np.pi * t / 3)) * (0.5 + 0.5 * np.sin(2 * np.pi * t / 8) ** 2)
    goal += 0.01 * np.sin(2 * np.pi * 1.3 * t) * (t > 3.0)
    goal_speed = np.gradient(goal, t)
    place, speed, h = 0.0, 0.0, 1.0 / RATE / SUBSTEPS
    places, forces = np.empty_like(t), np.empty_like(t)
    for k in range(t.size):
        places[k], forces[k] = place, 20000 * (goal[k] - place) + 3000 * (goal_speed[k] - speed)
        for _ in range(SUBSTEPS):
            pull = forces[k] + offset - VISCOUS * speed
            if speed == 0.0 and abs(pull) <= coulomb:
                continue
            after = speed + h / MASS * (pull - coulomb * np.sign(speed or pull))
            speed = 0.0 if after * speed < 0.0 else after  # it stops before it turns
            place += h * speed
    noise, other = np.random.default_rng(5).normal(size=(2, t.size))
    theta = np.round(places / 1e-6 + noise) * 1e-6
    return make(t, {("theta", "slide"): theta, ("tau_m", "slide"): forces + disturbance * other})


def test_the_friction_of_a_linear_drive(screw: Robot) -> None:
    """A Coulomb friction and a constant force are, where little rests, two levels of one friction. More than
    the sensors' noise is left, beside which a motor without force and a mass without inertia would do."""
    found = diagnose(screw, [recorded(COULOMB, OFFSET, disturbance=0.5)], refine=False)
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
