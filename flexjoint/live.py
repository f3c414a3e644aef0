"""A simulation that runs while one looks at it: step it, command it, read it, change its gains.

It is the plugin of Kashiri et al. 2017, section 4.2.1, as an object: per joint a command (position, velocity,
feed-forward torque), a state, and named gains. The same calls give the same numbers, bit for bit, so that
whole-body dynamics can be tested like any other code:

    sim = LiveSimulation(FlexibleJointModel(load_robot("rrbot_last_joint")))
    sim.aim({"joint2": 0.5})
    sim.run(2.0)
    assert abs(sim.state("joint2").q - 0.5) < 1e-3
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexjoint.clockwork import REFERENCES, Runner, Ticks, longest_delay
from flexjoint.control import gains_of, law_of, with_gain
from flexjoint.engine import ADAPTIVE, LONG, Engine, adaptive, choose
from flexjoint.errors import SimulationError, unknown
from flexjoint.integrate import DEFAULT
from flexjoint.live_loops import Cell, CompiledLoop, JointCommand, Loop, PinLoop, Told
from flexjoint.model import FlexibleJointModel, State
from flexjoint.stability import check_stability
from flexjoint.standing import held
from flexjoint.start import at_rest, initial_positions

KEPT = 4096  # rows of the motion behind the present one; delays need far fewer


@dataclass(frozen=True)
class JointState:
    """True state of a joint: motor theta [rad], dtheta [rad/s] and torque tau_m [N m] in force; link q, dq;
    transmission torque tau_t [N m]."""

    theta: float
    dtheta: float
    tau_m: float
    q: float
    dq: float
    tau_t: float


class LiveSimulation:
    """A model under its control law, at rest until it is stepped.

    Commands and gains act from the next control tick on. What is commanded at first holds the start: its link
    positions with the torques that carry them.

    Args:
        start: default: at rest at the robot file's `initial` positions, springs carrying the load.
        law: default: the robot's.
        rate: physics steps per second, default the robot's `rates.physics`; the controller ticks at
            `rates.control` (see `flexjoint.clockwork.Ticks`).
        scheme, width: see `flexjoint.integrate`.
        engine: auto, compiled or pin, see `flexjoint.engine`; auto compiles however few the steps will be.

    Raises what Runner raises and warns as it does; UnknownNameError for joints, gains and laws.
    """

    def __init__(
        self,
        model: FlexibleJointModel,
        start: State | None = None,
        law: Any = None,
        rate: float | None = None,
        scheme: str = DEFAULT,
        width: float | None = None,
        engine: Engine = "auto",
    ) -> None:
        self.joints: tuple[str, ...] = model.robot.joint_names
        self._told = Told(law_of(model.robot) if law is None else law)
        start = at_rest(model, initial_positions(model)) if start is None else replace(start)
        self._rate = model.robot.rates.physics if rate is None else rate
        for joint, flow in zip(model.joints, model.flows, strict=True):
            stiffness, damping = flow.spring_at(start.t)
            self._told.commands[joint.name] = JointCommand(0.0, 0.0, 0.0, 0.0, stiffness, damping)
        compiled = None
        if scheme == ADAPTIVE:
            model = adaptive(model, LONG, engine)
        else:
            law = self._told.law
            compiled = choose(model, LONG, self._rate, law, REFERENCES, scheme, width, engine)
        self.model = model
        ticks = Ticks(self._rate, model.robot.rates.control)
        self._loop: Loop
        if compiled is None:
            rows = max(KEPT, math.ceil(longest_delay(model) * self._rate) + 2)
            runner = Runner(model, start, self._rate, rows, None, scheme, width)
            self._loop = PinLoop(self._told, ticks, runner)
        else:
            check_stability(model, start, 1.0 / self._rate, scheme)
            self._loop = CompiledLoop(self._told, ticks, compiled, model, start, width)
        self.aim({joint.name: float(start.q[joint.idx_q]) for joint in model.joints})

    # --- run -------------------------------------------------------------------------------------
    @property
    def time(self) -> float:
        """The present time [s]."""
        return self._loop.time

    def step(self, steps: int = 1) -> None:
        """Run so many physics steps. Raises SimulationError when numbers are no longer finite."""
        self._loop.step(steps)

    def run(self, seconds: float) -> None:
        """Run for that long, to the nearest physics step."""
        if not seconds >= 0.0 or math.isinf(seconds):
            raise SimulationError(f"run: expected seconds >= 0, got {seconds}")
        self.step(round(seconds * self._rate))

    # --- command ---------------------------------------------------------------------------------
    def command(
        self,
        joint: str,
        position: float | None = None,
        velocity: float | None = None,
        torque: float | None = None,
        stiffness: float | None = None,
        damping: float | None = None,
    ) -> None:
        """Change what a joint is told; what is not named stays.

        position [rad] is that of the link and of the motor alike, as the law reads it (`aim` tells them
        apart); velocity [rad/s]; torque: feed-forward [N m]; stiffness [N m/rad] and damping [N m s/rad] make
        the joint's spring a variable one.

        Raises UnknownNameError; SimulationError for what is not finite, a stiffness that is not above 0 or a
        damping below 0, or a spring command to a rigid joint.
        """
        place = self._place(joint)
        given = {"dtheta_ref": velocity, "tau_ff": torque, "stiffness": stiffness, "damping": damping}
        given |= {"q_ref": position, "theta_ref": position}
        values = {name: float(value) for name, value in given.items() if value is not None}
        for name, value in values.items():
            low = {"stiffness": math.ulp(0.0), "damping": 0.0}.get(name, -math.inf)
            if not math.isfinite(value) or value < low:
                raise SimulationError(f"command of joint {joint}: {name} cannot be {value}")
        if stiffness is not None or damping is not None:
            if self.model.joints[place].rigid:
                raise SimulationError(f"joint {joint} is rigid: it has no spring to command")
            if joint not in self._told.cells:
                self._make_variable(joint)
        self._told.commands[joint] = replace(self._told.commands[joint], **values)

    def aim(self, positions: Mapping[str, float]) -> None:
        """Tell links to go to positions [rad] as equation 4 does: theta_ref = q_ref + g(q_ref)/K and
        tau_ff = g(q_ref), of the model at hand with its other joints where they are told to be. On contacts
        g - J_c' lambda stands for g; raises ModelError for a pose that they cannot carry."""
        for name in positions:
            self._place(name)
        told = {name: positions.get(name, self._told.commands[name].q_ref) for name in self.joints}
        q = self._loop.x.q.copy()
        for joint in self.model.joints:
            q[joint.idx_q] = told[joint.name]
        theta, tau = held(self._loop.model, q)
        for i, name in enumerate(self.joints):
            self._told.commands[name] = replace(
                self._told.commands[name],
                q_ref=told[name],
                theta_ref=float(theta[i]),
                tau_ff=float(tau[i]),
                dtheta_ref=0.0 if name in positions else self._told.commands[name].dtheta_ref,
            )

    def commanded(self, joint: str) -> JointCommand:
        """What a joint is told."""
        self._place(joint)
        return self._told.commands[joint]

    def _make_variable(self, joint: str) -> None:
        told = self._told.commands[joint]
        self._told.cells[joint] = Cell(told.stiffness, told.damping)
        springs = {**self.model.springs, **{name: cell.spring() for name, cell in self._told.cells.items()}}
        robot, effects = self.model.robot, self.model.effects
        self.model = FlexibleJointModel(robot, effects, springs=springs)
        self._loop.take(self.model)

    # --- gains -----------------------------------------------------------------------------------
    def gains(self, joint: str) -> dict[str, float]:
        """The gains of a joint's law by name, its torque limit among them."""
        return gains_of(self._told.law, self._place(joint))

    def set_gain(self, joint: str, name: str, value: float) -> None:
        """Change a gain from the next tick on. Raises UnknownNameError, or RobotError for a bad value."""
        self._told.law = with_gain(self._told.law, self._place(joint), name, value)
        self._loop.take_law()

    # --- state -----------------------------------------------------------------------------------
    def state(self, joint: str) -> JointState:
        """The true state of a joint now; tau_m is the torque commanded last (0 before the first step)."""
        i = self._place(joint)
        model, x = self._loop.model, self._loop.x
        tau_m = float(self._loop.held[i]) if self._loop.done else 0.0
        s = model.signals(x, i, tau_m)
        tau_t = x.tau_rigid[model.rigid.index(i)] if model.joints[i].rigid else s.tau_t
        return JointState(float(s.theta), float(s.dtheta), tau_m, float(s.q), float(s.dq), float(tau_t))

    def states(self) -> dict[str, JointState]:
        """The true state of every joint by name."""
        return {joint: self.state(joint) for joint in self.joints}

    @property
    def full_state(self) -> State:
        """A copy of the whole state, floating base and internal states of effects included."""
        x = self._loop.x
        names = ("q", "v", "theta", "dtheta", "z", "acc", "ddtheta", "tau_rigid")
        return State(x.t, *(np.array(getattr(x, name)) for name in names))

    def _place(self, joint: str) -> int:
        if joint not in self.joints:
            raise unknown("joint", joint, self.joints)
        return self.joints.index(joint)
