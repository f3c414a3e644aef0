"""A simulation that runs while one looks at it: step it, command it, read it, change its gains.

It is the plugin of Kameduła et al. 2016, section 4.2.1, as an object: per joint a command (position,
velocity, feed-forward torque), a state, and named gains. The same calls give the same numbers, bit for bit,
so that whole-body dynamics can be tested like any other code:

    sim = LiveSimulation(FlexibleJointModel(load_robot("rrbot_last_joint")))
    sim.aim({"joint2": 0.5})
    sim.run(2.0)
    assert abs(sim.state("joint2").q - 0.5) < 1e-3
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from flexjoint.core.errors import SimulationError, unknown
from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.springs import VariableSpring
from flexjoint.model.statics.standing import holding
from flexjoint.model.statics.start import at_rest, initial_positions
from flexjoint.simulation.compiled import CompiledModel, compiled_for
from flexjoint.simulation.compiled.engine import LONG, adaptive, choose
from flexjoint.simulation.compiled.live import LiveRun
from flexjoint.simulation.controllers import gains_of, law_of, with_gain
from flexjoint.simulation.loop import REFERENCES, Runner, Ticks, segments
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.schemes import find
from flexjoint.simulation.schemes.stability import check_stability

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


@dataclass(frozen=True)
class JointCommand:
    """The command of a joint: position [rad] (of the link, and of the motor), velocity [rad/s], feed-forward
    torque [N m], and of a variable spring stiffness [N m/rad] and damping [N m s/rad]."""

    q_ref: float
    theta_ref: float
    dtheta_ref: float
    tau_ff: float
    stiffness: float
    damping: float


class LiveSimulation:
    """A model under its control law, at rest until it is stepped.

    Commands and gains act from the next control tick on. The first command is the start itself: its link
    positions with the torques that carry them.

    Args:
        options: the controller ticks at the robot's `rates.control`, whatever the physics rate (see
            `flexjoint.simulation.loop.Ticks`); the engine auto compiles however few the steps will be.
        start: default: at rest at the robot file's `initial` positions, springs carrying the load.
        law: default: the robot's.

    Raises what Runner raises and warns as it does; UnknownNameError for joints, gains and laws.
    """

    def __init__(
        self,
        model: FlexibleJointModel,
        options: RunOptions = DEFAULTS,
        *,
        start: State | None = None,
        law: Any = None,
    ) -> None:
        self.joints: tuple[str, ...] = model.robot.joint_names
        self._commands = Commands(law_of(model.robot) if law is None else law)
        start = at_rest(model, initial_positions(model)) if start is None else replace(start)
        self._rate = options.rate_for(model.robot)
        for joint, flow in zip(model.joints, model.flows, strict=True):
            stiffness, damping = flow.spring_at(start.t)
            self._commands.joints[joint.name] = JointCommand(0.0, 0.0, 0.0, 0.0, stiffness, damping)
        compiled = None
        if find(options.scheme).adaptive:
            model = adaptive(model, LONG, options)
        else:
            compiled = choose(model, LONG, options, self._commands.law, REFERENCES)
        self.model = model
        ticks = Ticks(self._rate, model.robot.rates.control)
        self._loop: Loop
        if compiled is None:
            rows = max(KEPT, math.ceil(longest_delay(model) * self._rate) + 2)
            runner = Runner(model, start, rows, options)
            self._loop = PinLoop(self._commands, ticks, runner)
        else:
            check_stability(model, start, 1.0 / self._rate, options.scheme)
            self._loop = CompiledLoop(self._commands, ticks, compiled, model, start)
        self.aim({joint.name: float(start.q[joint.idx_q]) for joint in model.joints})

    # --- run -------------------------------------------------------------------------------------
    @property
    def time(self) -> float:
        """The present time [s]."""
        return self._loop.time

    def step(self, steps: int = 1) -> None:
        """Run a number of physics steps. Raises SimulationError when numbers are no longer finite."""
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
        """Change the command of a joint; what is not named stays.

        position [rad] is that of the link and of the motor alike, as the law reads it (`aim` sets them
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
            if joint not in self._commands.cells:
                self._make_variable(joint)
        self._commands.joints[joint] = replace(self._commands.joints[joint], **values)

    def aim(self, positions: Mapping[str, float]) -> None:
        """Command links to positions [rad] as equation 4 does: theta_ref = q_ref + g(q_ref)/K and
        tau_ff = g(q_ref), of the model at hand with its other joints where they are commanded. On contacts
        g - J_c' lambda stands for g; raises ModelError for a pose that they cannot carry."""
        for name in positions:
            self._place(name)
        goal = {name: positions.get(name, self._commands.joints[name].q_ref) for name in self.joints}
        q = self._loop.x.q.copy()
        for joint in self.model.joints:
            q[joint.idx_q] = goal[joint.name]
        theta, tau = holding(self._loop.model, q)
        for i, name in enumerate(self.joints):
            self._commands.joints[name] = replace(
                self._commands.joints[name],
                q_ref=goal[name],
                theta_ref=float(theta[i]),
                tau_ff=float(tau[i]),
                dtheta_ref=0.0 if name in positions else self._commands.joints[name].dtheta_ref,
            )

    def commanded(self, joint: str) -> JointCommand:
        """The command of a joint."""
        self._place(joint)
        return self._commands.joints[joint]

    def _make_variable(self, joint: str) -> None:
        command = self._commands.joints[joint]
        self._commands.cells[joint] = Cell(command.stiffness, command.damping)
        springs = {
            **self.model.springs,
            **{name: cell.spring() for name, cell in self._commands.cells.items()},
        }
        robot, effects = self.model.robot, self.model.effects
        self.model = FlexibleJointModel(robot, effects, springs=springs)
        self._loop.take(self.model)

    # --- gains -----------------------------------------------------------------------------------
    def gains(self, joint: str) -> dict[str, float]:
        """The gains of a joint's law by name, its torque limit among them."""
        return gains_of(self._commands.law, self._place(joint))

    def set_gain(self, joint: str, name: str, value: float) -> None:
        """Change a gain from the next tick on. Raises UnknownNameError, or RobotError for a bad value."""
        self._commands.law = with_gain(self._commands.law, self._place(joint), name, value)
        self._loop.take_law()

    # --- state -----------------------------------------------------------------------------------
    def state(self, joint: str) -> JointState:
        """The true state of a joint now; tau_m is the torque commanded last (0 before the first step)."""
        i = self._place(joint)
        model, x = self._loop.model, self._loop.x
        tau_m = float(self._loop.last_command[i]) if self._loop.done else 0.0
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


# --- what steps it: the pin loop or the compiled clockwork, behind one interface --------------------------
class Cell:
    """A commanded stiffness and damping, constant until the next tick."""

    def __init__(self, stiffness: float, damping: float) -> None:
        self.stiffness, self.damping = stiffness, damping

    @property
    def numbers(self) -> tuple[float, float]:
        return self.stiffness, self.damping

    def spring(self) -> VariableSpring:
        return VariableSpring(lambda _t: self.stiffness, lambda _t: self.damping)


@dataclass
class Commands:
    """The commands of a simulation, read by its loop at every tick: the law with its gains, a command per
    joint (in their order), and the joints whose springs are commanded."""

    law: Any
    joints: dict[str, JointCommand] = field(default_factory=dict)
    cells: dict[str, Cell] = field(default_factory=dict)

    def references(self) -> dict[str, np.ndarray]:
        """(n,) references by name."""
        joints = self.joints.values()
        return {name: np.array([getattr(one, name) for one in joints]) for name in REFERENCES}

    def spring_changes(self) -> bool:
        """Whether the command of a spring has changed."""
        return any(cell.numbers != self._spring(name) for name, cell in self.cells.items())

    def take_springs(self) -> bool:
        """Take the commands of springs from now on; whether any has changed."""
        new = self.spring_changes()
        for name, cell in self.cells.items():
            cell.stiffness, cell.damping = self._spring(name)
        return new

    def _spring(self, joint: str) -> tuple[float, float]:
        return self.joints[joint].stiffness, self.joints[joint].damping


class Loop(Protocol):
    """A simulation that runs: its present state x, time [s], steps done, the torque (n,) commanded last, and
    the model in force now."""

    @property
    def x(self) -> State: ...
    @property
    def time(self) -> float: ...
    @property
    def done(self) -> int: ...
    @property
    def last_command(self) -> np.ndarray: ...
    @property
    def model(self) -> FlexibleJointModel: ...

    def step(self, steps: int) -> None:
        """Run a number of physics steps."""

    def take(self, model: FlexibleJointModel) -> None:
        """Go on with this model, which has another spring commanded."""

    def take_law(self) -> None:
        """Go on with the law of the commands, which may be of another kind."""


class PinLoop:
    """The clockwork in Python."""

    def __init__(self, commands: Commands, ticks: Ticks, runner: Runner) -> None:
        self._commands, self._ticks, self._runner = commands, ticks, runner

    @property
    def x(self) -> State:
        return self._runner.x

    @property
    def time(self) -> float:
        return float(self._runner.tape.time[self._runner.row])

    @property
    def done(self) -> int:
        return self._runner.done

    @property
    def last_command(self) -> np.ndarray:
        return self._runner.last_command

    @property
    def model(self) -> FlexibleJointModel:
        return self._runner.model

    def step(self, steps: int) -> None:
        with self._runner.watched():
            for _ in range(steps):
                self._runner.step(self._command)

    def take(self, model: FlexibleJointModel) -> None:
        self._runner.take(model)

    def take_law(self) -> None:
        """Nothing to take: the law is read at every tick."""

    def _command(self, now: Runner) -> np.ndarray:
        if not self._ticks.acts(now.done):
            return now.last_command
        if self._commands.take_springs():
            check_stability(now.model, now.x, now.h, now.options.scheme)
        law = self._commands.law
        return np.asarray(law.torque(self._commands.references(), now.readings(law)))


class CompiledLoop:
    """The clockwork in C: one call for all steps between two changes of the commands.

    Args:
        compiled: the compiled model of `model` under the law of the commands, with its references.
        All others as for LiveSimulation.
    """

    def __init__(
        self,
        commands: Commands,
        ticks: Ticks,
        compiled: CompiledModel,
        model: FlexibleJointModel,
        start: State,
    ) -> None:
        self._commands, self._ticks, self._compiled = commands, ticks, compiled
        self._whole = self._plain = model
        self._begin = start.t
        self._run = LiveRun(compiled, model, start)
        self._taken: list[JointCommand] = []
        self._row = np.zeros(0)  # references of these commands
        self._springs: dict[str, tuple[float, float]] = {}
        self._values, self._gains = compiled.values(model), compiled.gains(commands.law)

    @property
    def x(self) -> State:
        return self._run.x

    @property
    def time(self) -> float:
        return self._run.time

    @property
    def done(self) -> int:
        return self._run.done

    @property
    def last_command(self) -> np.ndarray:
        return self._run.last_command

    @property
    def model(self) -> FlexibleJointModel:
        step = max(self.done - 1, 0)
        spans = segments(self._whole, self._begin, sys.maxsize, 1.0 / self._compiled.rate)
        return next(model for model, until in spans if step < until)

    def step(self, steps: int) -> None:
        commands, compiled = self._commands, self._compiled
        joints = list(commands.joints.values())
        if joints != self._taken:  # quick: of the same objects
            self._taken, self._row = joints, np.concatenate([*commands.references().values()])
        while steps > 0:
            now, count = self.done, steps
            if self._ticks.acts(now) and commands.take_springs():
                check_stability(self.model, self.x, 1.0 / compiled.rate, compiled.options.scheme)
            if commands.spring_changes():  # from the next tick on
                count = min(steps, self._ticks.steps(self._ticks.last(now) + 1) - now)
            springs = {name: cell.numbers for name, cell in commands.cells.items()}
            if springs != self._springs:
                self._springs, self._values = springs, compiled.values(self._plain, springs)
            self._run.advance(count, self._values, self._row, self._gains)
            steps -= count

    def take(self, model: FlexibleJointModel) -> None:
        self._whole = model
        springs = {name: spring for name, spring in model.springs.items() if name not in self._commands.cells}
        self._plain = FlexibleJointModel(model.robot, model.effects, springs=springs)
        self.take_law()

    def take_law(self) -> None:
        compiled = compiled_for(
            self._plain,
            self._compiled.options,
            law=self._commands.law,
            references=REFERENCES,
            commanded=tuple(self._commands.cells),
        )
        if compiled is not self._compiled:
            self._compiled, self._springs = compiled, {}
            self._run.use(compiled)
        self._gains = compiled.gains(self._commands.law)
