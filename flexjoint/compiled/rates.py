"""A model whose time derivative is compiled: what adaptive solvers evaluate in C.

The scheme `reference` and `flexjoint.reference.continuous_control` choose their steps by the motion. So
their solver (scipy's) stays in Python and calls the model's right-hand side, which is C. An implicit solver
takes its Jacobian from difference quotients of that.
"""

from __future__ import annotations

import ctypes
import math
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from flexjoint.compiled.cache import load
from flexjoint.compiled.compiler import Compiler
from flexjoint.compiled.program import c_program
from flexjoint.model import FlexibleJointModel, Rates, State
from flexjoint.ops import Value
from flexjoint.parameters import parameter_table
from flexjoint.symbolic import SymbolicModel

FREE = ("drives",)
ANY_WIDTH = 1.0  # where there is no dry friction to smooth
_DOUBLES = ctypes.c_void_p


class RatesProgram:
    """The compiled right-hand side of all models of one structure, of the effects that are awake at `at`.

    Raises CompilerError; ModelError where the structure has no symbolic model.
    """

    def __init__(self, model: FlexibleJointModel, at: float, compiler: Compiler | None = None) -> None:
        symbolic = SymbolicModel(model.robot, model.effects, FREE, at, model.springs)
        x, width = ca.SX.sym("x", symbolic.model.nx), ca.SX.sym("width")
        r = symbolic.model.rates(symbolic.model.unpack(x, symbolic.t), symbolic.u, width)
        out = ca.cse(ca.densify(ca.vertcat(r.acc, r.ddtheta, r.dz, r.tau_t)))
        (rest,), symbols, constant = ca.extract_parametric([out], symbolic.p, {"extract_trivial": True})
        c = ca.vertcat(ca.SX(0, 1), *symbols)
        rates = ca.Function("fj_rates", [x, symbolic.u, c, symbolic.t, width], [rest])
        setup = ca.Function("fj_setup", [symbolic.p], [ca.vertcat(ca.SX(0, 1), *constant)])
        sizes = {
            "FJ_RATES_ARG": rates.sz_arg(),
            "FJ_RATES_RES": rates.sz_res(),
            "FJ_RATES_W": rates.sz_w() + 1,
        }
        source = c_program([rates, setup], sizes, ["setup.c", "rates.c"])
        self.compiler, library = load(source, compiler)
        self._setup, self.rates = library.flexjoint_setup, library.flexjoint_rates
        self._setup.argtypes, self._setup.restype = [_DOUBLES, _DOUBLES], None
        self.rates.argtypes = [_DOUBLES, _DOUBLES, _DOUBLES, ctypes.c_double, ctypes.c_double, _DOUBLES]
        self.rates.restype = None
        self._constants = c.numel()
        self.model = model  # in shared.py its robot's id stands for it

    def constants(self, model: FlexibleJointModel) -> np.ndarray:
        """What follows from the numbers of a model of this structure alone."""
        table = parameter_table(model.joints, model.effects, model.robot.model, FREE)
        values, constants = np.array(list(table.values())), np.empty(max(self._constants, 1))
        self._setup(values.ctypes.data, constants.ctypes.data)
        return constants


class CompiledRates(FlexibleJointModel):
    """A numeric model whose `rates` run as C; all else is the model's own. For one thread.

    Args:
        model: the model that it is like. at: see FlexibleJointModel.

    Raises as RatesProgram.
    """

    def __init__(self, model: FlexibleJointModel, at: float = math.inf) -> None:
        from flexjoint.compiled.shared import rates_for

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
        self._rubs = any(flow.motor_rubs or flow.link_rubs for flow in self.flows)

    @cached_property
    def phases(self) -> tuple[tuple[float, FlexibleJointModel], ...]:
        """As FlexibleJointModel.phases, compiled as well."""
        if not self.onsets:
            return ((-math.inf, self),)
        return tuple((t, CompiledRates(self, t)) for t in (-math.inf, *self.onsets))

    @property
    def compiler(self) -> Compiler:
        """The compiler that made the C a library."""
        return self._program.compiler

    def rates(self, state: State, tau_m: Value, width: Value | None) -> Rates:
        """As FlexibleJointModel.rates, with which it agrees to rounding."""
        if width is None and self._rubs:
            return super().rates(state, tau_m, width)
        self._x[:] = self.pack(state)
        self._u[:] = tau_m
        self._program.rates(*self._inputs, state.t, ANY_WIDTH if width is None else width, self._output)
        acc, ddtheta, dz, tau_t = (self._out[part].copy() for part in self._parts)
        return Rates(state.v, acc, state.dtheta, ddtheta, dz, tau_t)
