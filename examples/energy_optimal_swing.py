"""Energy-optimal swing of a soft pendulum: the symbolic model in a user's own optimal control problem.

The last joint of rrbot, on a soft spring and with little friction, hangs still and is to stand upright after
2 s, with the least loss in the motor (the integral of tau_m^2). Its torque limit is below what would hold it
horizontal: it has to swing. Run: python examples/energy_optimal_swing.py
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.robot.robot import load
from flexjoint.simulation.schemes.discrete import DiscreteModel

RATE = 200.0  # steps per second
HOLD = 4  # steps for which a torque is held
INTERVALS = 100  # of HOLD steps: 2 s
LIMIT = 3.0  # N m; holding it horizontal takes 4.4
SOFT = {
    "drive.joint2.stiffness": 30.0,
    "drive.joint2.motor_damping": 0.1,
    "link_viscous_friction.joint2.coefficient": 0.05,
}


def swing() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,) [s], states (N + 1, 4): q, dq, theta, dtheta, and motor torques (N,) [N m]."""
    robot = load("rrbot_last_joint")
    symbolic, numeric = SymbolicModel(robot, free=("drives",)), FlexibleJointModel(robot)
    parameters = symbolic.set_values(SOFT)
    discrete = DiscreteModel(symbolic, RATE)
    step = discrete.step()

    x0, u, t = ca.MX.sym("x", discrete.size), ca.MX.sym("u", 1), ca.MX.sym("t")
    x = x0
    for k in range(HOLD):
        x = step(x, u, parameters, t + k / RATE)
    interval = ca.Function("interval", [x0, u, t], [x])

    times = np.arange(INTERVALS) * HOLD / RATE
    opti = ca.Opti()
    states, torque = opti.variable(discrete.size, INTERVALS + 1), opti.variable(1, INTERVALS)
    opti.minimize(ca.sumsqr(torque) * HOLD / RATE)
    opti.subject_to(states[:, 1:] == interval.map(INTERVALS)(states[:, :-1], torque, times[None, :]))
    hanging = discrete.start(numeric.rest(np.array([math.pi])), np.zeros(1))  # q = 0 is upright
    opti.subject_to(states[:, 0] == hanging)
    opti.subject_to(states[:4, -1] == 0.0)
    opti.subject_to(opti.bounded(-LIMIT, torque, LIMIT))
    guess = np.tile(hanging[:, None], (1, INTERVALS + 1))
    guess[[0, 2]] *= np.linspace(1.0, 0.0, INTERVALS + 1)
    opti.set_initial(states, guess)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 500})
    found = opti.solve()
    return times, found.value(states)[:4].T, np.ravel(found.value(torque))


if __name__ == "__main__":
    times, states, torque = swing()
    print(
        f"loss {np.sum(torque**2) * HOLD / RATE:.2f} (N m)^2 s, torque up to {np.max(np.abs(torque)):.2f} N m"
    )
    for time, q, tau in zip(times[::5], states[::5, 0], torque[::5], strict=False):
        print(f"t {time:4.2f} s   q {q:6.2f} rad   tau_m {tau:6.2f} N m")
