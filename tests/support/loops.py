"""The same run by the pin loop and by the compiled clockwork."""

from __future__ import annotations

import numpy as np

from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.robot.robot import Robot
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.schemes import DEFAULT
from flexjoint.simulation.trajectory import Trajectory
from support.robots.arms import waves

# Both evaluate the same expressions in double precision; sines, powers and the order of sums in the
# articulated-body algorithm differ in the last digit, and a motion of 1 s carries that on.
ATOL = 1e-9
GAINS = {"kp_link": 5.0, "kd_link": 0.3, "k_torque": 0.5, "kd_spring": 0.2}
FRICTIONS = [
    effect("link_coulomb_friction", "yaw", level=0.3),
    effect("motor_coulomb_friction", "roll", level=0.5),
    effect("link_coulomb_friction", "pitch", level=0.2),
]


def moving(model: FlexibleJointModel, size: float = 1.0) -> State:
    start = model.rest()
    start.v = start.v + size * np.linspace(0.5, -1.0, model.nv)
    start.dtheta = start.dtheta + size * np.linspace(0.4, -0.9, model.nf)
    return start


def references(robot: Robot, seconds: float = 1.0, size: float = 0.5) -> dict[str, np.ndarray]:
    n, rate = len(robot.joints), robot.rates.control
    ticks = round(seconds * rate)
    table = {name: waves(n, ticks, rate, size) for name in ("q_ref", "theta_ref")}
    return {**table, "dtheta_ref": waves(n, ticks, rate, size), "tau_ff": waves(n, ticks, rate, 6 * size)}


def agree(one: Trajectory, other: Trajectory, atol: float = ATOL) -> None:
    for name in ("time", "q", "v", "theta", "dtheta", "z", "tau_rigid", "tau_m"):
        a, b = getattr(one, name), getattr(other, name)
        scale = max(1.0, float(np.max(np.abs(a), initial=0.0)))  # torques of 100 N m have coarser digits
        np.testing.assert_allclose(b, a, rtol=0, atol=atol * scale, err_msg=name)
    assert np.max(np.abs(one.q[-1] - one.q[0])) > 1e-3  # it moved


def loops_agree(
    robot: Robot,
    effects: list[Planned] | None,
    rate: float = 1000.0,
    scheme: str = DEFAULT,
    width: float | None = None,
    seconds: float = 1.0,
    atol: float = ATOL,
) -> None:
    """A second under the robot's controller, by both."""
    model = FlexibleJointModel(robot, effects)
    pin_loop, compiled = (
        closed_loop(
            model,
            moving(model),
            law_of(robot),
            references(robot, seconds),
            RunOptions(rate=rate, scheme=scheme, width=width, engine=kind),
        )
        for kind in ("pin", "compiled")
    )
    agree(pin_loop, compiled, atol)
