"""How a simulation is run: one frozen set of options, which every run takes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from flexjoint.core.errors import SimulationError, unknown
from flexjoint.robot.robot import Robot
from flexjoint.simulation.schemes import DEFAULT, find

Engine = Literal["auto", "compiled", "pin"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How a simulation is run.

    Args:
        rate: physics steps per second [Hz]; default: the robot's `rates.physics`.
        scheme: name of the integration scheme, one of `flexjoint.simulation.schemes.SCHEMES`.
        width: velocity [rad/s] over which dry friction is smoothed, for schemes in which it does not stick.
        engine: compiled runs the steps as C; pin runs them in Python with Pinocchio; auto compiles long runs
            and takes pin for short ones (`flexjoint.simulation.compiled.engine`).

    Raises:
        UnknownNameError: no such scheme or engine.
        SimulationError: a rate that is not above 0.
    """

    rate: float | None = None
    scheme: str = DEFAULT
    width: float | None = None
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        find(self.scheme)
        if self.engine not in ENGINES:
            raise unknown("engine", self.engine, ENGINES)
        if self.rate is not None and not 0.0 < self.rate < math.inf:
            raise SimulationError(f"rates: expected physics steps per second above 0 [Hz], got {self.rate}")

    def rate_for(self, robot: Robot) -> float:
        """Physics steps per second [Hz] of a run of this robot."""
        return robot.rates.physics if self.rate is None else self.rate


DEFAULTS = RunOptions()
