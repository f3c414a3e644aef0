"""What an integration scheme is: an object that knows its properties, its step and its step matrix."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import scipy.linalg

from flexjoint.core.errors import SimulationError
from flexjoint.core.ops import Value
from flexjoint.model.dynamics import FlexibleJointModel, State

Step = Callable[[State, Value], State]
DEFAULT = "linearly_implicit_midpoint"  # name of the scheme that is used where none is named


class Scheme(ABC):
    """An integration scheme. It steps numbers and, unless it iterates, CasADi expressions.

    Attributes:
        name: as users write it.
        order: of its error in the step h, on smooth effects; None where a tolerance decides instead.
        sticks: whether dry friction is a set, so that it sticks; otherwise level tanh(velocity / width)
            stands for it, and a model with dry friction needs a width [rad/s].
        any_stiffness: whether it is stable for any stiffness and damping of the joints.
        aba_calls: calls of the articulated-body algorithm a step, without dry friction of links; None where
            the motion decides.
        newton: whether a step solves equations by Newton's method (compiled, newton.c does).
        repeats: whether it repeats a step of numbers whose prediction failed (compiled, midpoint.c does).
        adaptive: whether it chooses its own steps within h by an error estimate.
        rigid_ground: whether its step takes the impulses of rigid ground.
        slips: whether its step lets the anchors of contacts slip; otherwise they slip after each step.
        keeps_energy, keeps_momentum: the largest omega h of a spring that rings undamped, up to which energy
            grows by less than 1 %, and what flies freely makes less than 1e-6 of its bodies' momentum, in
            20 s (docs/explained/simulation.md has the measurement); infinite where it always holds, 0 where
            it never does.
        contact_damping: the largest tangential damping c of a contact as c h/m, m the mass that it moves;
            None where none is known.
    """

    name: ClassVar[str]
    order: ClassVar[int | None]
    sticks: ClassVar[bool] = False
    any_stiffness: ClassVar[bool] = False
    aba_calls: ClassVar[int | None] = None
    newton: ClassVar[bool] = False
    repeats: ClassVar[bool] = False
    adaptive: ClassVar[bool] = False
    rigid_ground: ClassVar[bool] = False
    slips: ClassVar[bool] = False
    keeps_energy: ClassVar[float] = math.inf
    keeps_momentum: ClassVar[float] = math.inf
    contact_damping: ClassVar[float | None] = None

    @property
    def expressions(self) -> bool:
        """Whether it steps CasADi expressions: those who iterate until something has converged cannot."""
        return not (self.newton or self.adaptive)

    def step(self, model: FlexibleJointModel, h: float, width: float | None = None) -> Step:
        """The step function (state, tau_m) -> state, h seconds later, under motor torques tau_m (n,) [N m]
        held over the step, delays aside.

        Raises as `check`; ModelError where the model holds expressions and the scheme takes numbers only.
        """
        self.check(model, width)
        step = self._step(model, h, width)
        if model.ground is None or self.slips:
            return step
        return lambda x, tau_m: slipped(model, step(x, tau_m))

    def check(self, model: FlexibleJointModel, width: float | None) -> None:
        """Raises SimulationError for a scheme that smooths dry friction and has no width > 0, and for rigid
        ground where the step takes none."""
        if model.rubs and not self.sticks and not (width is not None and width > 0.0):
            raise SimulationError(
                f"{self.name} smooths dry friction as level tanh(velocity / width): give a width > 0 [rad/s],"
                f" or use {DEFAULT}, where it sticks (got width={width})"
            )
        if model.ground is not None and not model.ground.springy and not self.rigid_ground:
            raise SimulationError(
                f"{self.name} takes no rigid ground, whose impulses belong to the step of {DEFAULT}: use"
                " that, or ground: compliant"
            )

    @abstractmethod
    def _step(self, model: FlexibleJointModel, h: float, width: float | None) -> Step:
        """As `step`, without checks and without the slip of contacts."""

    @abstractmethod
    def step_matrix(self, A: np.ndarray, h: float, links: int) -> np.ndarray:
        """What one step of h seconds does to the state (q, theta, v, dtheta) of dx/dt = A x, the velocities
        of the links first among them (`links` of them). Its eigenvalues tell which modes grow."""


def midpoint_matrix(A: np.ndarray, h: float) -> np.ndarray:
    """(1 - hA/2)^-1 (1 + hA/2): the step matrix of midpoint rules."""
    eye = np.eye(len(A))
    return np.linalg.solve(eye - 0.5 * h * A, eye + 0.5 * h * A)


def exact_matrix(A: np.ndarray, h: float) -> np.ndarray:
    """exp(hA): what time itself does."""
    return np.asarray(scipy.linalg.expm(h * A))


def slipped(model: FlexibleJointModel, x: State) -> State:
    """The state with the anchors of contacts where they slip to."""
    if model.ground is not None:
        x.z = model.ground.slipped(model.body, x.q, x.v, x.z)
    return x
