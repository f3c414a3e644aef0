"""A model whose time derivative is compiled: what adaptive solvers evaluate in C.

The scheme `reference` and `schemes.reference.continuous_control` choose their steps by the motion. So their
solver (scipy's) stays in Python and calls the model's right-hand side, which is C. An implicit solver takes
its Jacobian from difference quotients of that.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexjoint.core.ops import Value
from flexjoint.model.dynamics import FlexibleJointModel, Rates, State
from flexjoint.simulation.compiled.compiler import Compiler
from flexjoint.simulation.compiled.shared import rates_for

ANY_WIDTH = 1.0  # where there is no dry friction to smooth


class CompiledRates(FlexibleJointModel):
    """A numeric model whose `rates` run as C; all else is the model's own. For one thread.

    Args:
        model: the model that it is like. at: see FlexibleJointModel.

    Raises as RatesProgram.
    """

    def __init__(self, model: FlexibleJointModel, at: float | None = None) -> None:
        super().__init__(model.robot, model.effects, at=at, springs=model.springs)
        self._program = rates_for(self, at)
        self._constants = self._program.constants(self)
        self._x, self._u = np.empty(self.nx), np.empty(len(self.joints))
        ends = np.cumsum([0, self.nv, self.nf, self.nz, len(self.joints)])
        self._parts = [slice(*pair) for pair in pairwise(ends.tolist())]
        self._out = np.empty(int(ends[-1]))
        buffers = (self._x, self._u, self._constants)
        self._inputs = tuple(buffer.ctypes.data for buffer in buffers)
        self._output = self._out.ctypes.data

    @cached_property
    def phases(self) -> tuple[tuple[float, FlexibleJointModel], ...]:
        """As FlexibleJointModel.phases, compiled as well."""
        if not self.onsets:
            return ((-math.inf, self),)
        return self.by_phase(lambda t: CompiledRates(self, t))

    @property
    def compiler(self) -> Compiler:
        """The compiler that made the C a library."""
        return self._program.compiler

    def rates(self, state: State, tau_m: Value, width: Value | None) -> Rates:
        """As FlexibleJointModel.rates, with which it agrees to rounding."""
        if width is None and self.rubs:
            return super().rates(state, tau_m, width)
        self._x[:] = self.pack(state)
        self._u[:] = tau_m
        self._program.rates(*self._inputs, state.t, ANY_WIDTH if width is None else width, self._output)
        acc, ddtheta, dz, tau_t = (self._out[part].copy() for part in self._parts)
        return Rates(state.v, acc, state.dtheta, ddtheta, dz, tau_t)
