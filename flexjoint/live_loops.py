"""What steps a live simulation: the pin loop or the compiled clockwork, behind one interface."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from flexjoint.clockwork import REFERENCES, Runner, Ticks, _segments
from flexjoint.compiled import CompiledModel, compiled_for
from flexjoint.compiled.live import LiveRun
from flexjoint.model import FlexibleJointModel, State
from flexjoint.springs import VariableSpring
from flexjoint.stability import check_stability


@dataclass(frozen=True)
class JointCommand:
    """What a joint is told: position [rad] (of the link, and of the motor), velocity [rad/s], feed-forward
    torque [N m], and of a variable spring stiffness [N m/rad] and damping [N m s/rad]."""

    q_ref: float
    theta_ref: float
    dtheta_ref: float
    tau_ff: float
    stiffness: float
    damping: float


class Cell:
    """A commanded stiffness and damping, held until the next tick."""

    def __init__(self, stiffness: float, damping: float) -> None:
        self.stiffness, self.damping = stiffness, damping

    @property
    def numbers(self) -> tuple[float, float]:
        return self.stiffness, self.damping

    def spring(self) -> VariableSpring:
        return VariableSpring(lambda _t: self.stiffness, lambda _t: self.damping)


@dataclass
class Told:
    """What a simulation is told, read by its loop at every tick: the law with its gains, a command per joint
    (in the order of the joints), and the joints whose springs are commanded."""

    law: Any
    commands: dict[str, JointCommand] = field(default_factory=dict)
    cells: dict[str, Cell] = field(default_factory=dict)

    def references(self) -> dict[str, np.ndarray]:
        """(n,) references by name."""
        told = self.commands.values()
        return {name: np.array([getattr(one, name) for one in told]) for name in REFERENCES}

    def spring_changes(self) -> bool:
        """Whether a spring is told anything new."""
        return any(cell.numbers != self._spring(name) for name, cell in self.cells.items())

    def take_springs(self) -> bool:
        """Hold what springs are told from now on; whether it is anything new."""
        new = self.spring_changes()
        for name, cell in self.cells.items():
            cell.stiffness, cell.damping = self._spring(name)
        return new

    def _spring(self, joint: str) -> tuple[float, float]:
        return self.commands[joint].stiffness, self.commands[joint].damping


class Loop(Protocol):
    """A simulation that runs: its present state x, time [s], steps done, the torque (n,) commanded last, and
    the model that holds now."""

    @property
    def x(self) -> State: ...
    @property
    def time(self) -> float: ...
    @property
    def done(self) -> int: ...
    @property
    def held(self) -> np.ndarray: ...
    @property
    def model(self) -> FlexibleJointModel: ...

    def step(self, steps: int) -> None:
        """Run so many physics steps."""

    def take(self, model: FlexibleJointModel) -> None:
        """Go on with this model, which has another spring commanded."""

    def take_law(self) -> None:
        """Go on with the law that is told, which may be of another kind."""


class PinLoop:
    """The clockwork in Python."""

    def __init__(self, told: Told, ticks: Ticks, runner: Runner) -> None:
        self._told, self._ticks, self._runner = told, ticks, runner

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
    def held(self) -> np.ndarray:
        return self._runner.held

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
            return now.held
        if self._told.take_springs():
            check_stability(now.model, now.x, now.h, now.scheme)
        law = self._told.law
        return np.asarray(law.torque(self._told.references(), now.readings(law)))


class CompiledLoop:
    """The clockwork in C: one call for all steps between two changes of what it is told.

    Args:
        compiled: the compiled model of `model` under the law that is told, with its references.
        width: see `flexjoint.integrate`. All others as for LiveSimulation.
    """

    def __init__(
        self,
        told: Told,
        ticks: Ticks,
        compiled: CompiledModel,
        model: FlexibleJointModel,
        start: State,
        width: float | None,
    ) -> None:
        self._told, self._ticks, self._compiled, self._width = told, ticks, compiled, width
        self._whole = self._plain = model
        self._begin = start.t
        self._run = LiveRun(compiled, model, start)
        self._commands: list[JointCommand] = []
        self._row = np.zeros(0)  # references of these commands
        self._springs: dict[str, tuple[float, float]] = {}
        self._values, self._gains = compiled.values(model), compiled.gains(told.law)

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
    def held(self) -> np.ndarray:
        return self._run.held

    @property
    def model(self) -> FlexibleJointModel:
        step = max(self.done - 1, 0)
        segments = _segments(self._whole, self._begin, sys.maxsize, 1.0 / self._compiled.rate)
        return next(model for model, until in segments if step < until)

    def step(self, steps: int) -> None:
        told, compiled = self._told, self._compiled
        commands = list(told.commands.values())
        if commands != self._commands:  # quick: of the same objects
            self._commands, self._row = commands, np.concatenate([*told.references().values()])
        while steps > 0:
            now, count = self.done, steps
            if self._ticks.acts(now) and told.take_springs():
                check_stability(self.model, self.x, 1.0 / compiled.rate, compiled.scheme)
            if told.spring_changes():  # from the next tick on
                count = min(steps, self._ticks.steps(self._ticks.last(now) + 1) - now)
            springs = {name: cell.numbers for name, cell in told.cells.items()}
            if springs != self._springs:
                self._springs, self._values = springs, compiled.values(self._plain, springs)
            self._run.advance(count, self._values, self._row, self._gains)
            steps -= count

    def take(self, model: FlexibleJointModel) -> None:
        self._whole = model
        springs = {name: spring for name, spring in model.springs.items() if name not in self._told.cells}
        self._plain = FlexibleJointModel(model.robot, model.effects, springs=springs)
        self.take_law()

    def take_law(self) -> None:
        rate, scheme, commanded = self._compiled.rate, self._compiled.scheme, tuple(self._told.cells)
        compiled = compiled_for(
            self._plain, rate, self._told.law, REFERENCES, scheme, self._width, commanded=commanded
        )
        if compiled is not self._compiled:
            self._compiled, self._springs = compiled, {}
            self._run.use(compiled)
        self._gains = compiled.gains(self._told.law)
