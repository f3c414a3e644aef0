"""Implicit midpoint for the compiled clockwork: its equations as generated functions for newton.c."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from flexjoint.model.dynamics import State
from flexjoint.simulation.schemes import implicit
from flexjoint.simulation.schemes.base import slipped
from flexjoint.simulation.schemes.discrete import DiscreteModel
from flexjoint.simulation.schemes.implicit import Equations

OUTPUTS = ("fj_guess", "fj_missing", "fj_end")


def unknowns(layout: DiscreteModel) -> ca.SX:
    """Symbols for the velocities and internal states at the midpoint."""
    model = layout.symbolic.model
    return ca.SX.sym("u", model.nv + model.nf + model.nz)


def equations(
    layout: DiscreteModel, state: State, u: ca.SX, h: float, width: float | None
) -> tuple[ca.SX, ...]:
    """Expressions of OUTPUTS: the guess, the residual of u, and the state row at the end of the step."""
    model = layout.symbolic.model
    step = Equations(model, state, layout.symbolic.u, h, width)
    return step.guess, step.missing(u), layout.pack(slipped(model, step.end(u)))


def sizes(functions: Sequence[ca.Function]) -> dict[str, int]:
    """Sizes that newton.c wants of the functions of OUTPUTS."""
    count = functions[0].numel_out(0)
    generated = max(function.sz_w() for function in functions)
    return {
        "FJ_UNKNOWNS": count,
        "FJ_STEP_ARG": max(function.sz_arg() for function in functions),
        "FJ_STEP_RES": max(function.sz_res() for function in functions),
        "FJ_STEP_W": count * (count + 6) + generated + 1,
    }


def numbers() -> dict[str, float]:
    """When the iteration of flexjoint.simulation.schemes.implicit ends, for newton.c."""
    return {
        "FJ_ITERATIONS": implicit.ITERATIONS,
        "FJ_CONVERGED": implicit.CONVERGED,
        "FJ_STALLED": implicit.STALLED,
        "FJ_SLOW": implicit.SLOW,
        "FJ_HALVINGS": implicit.HALVINGS,
        "FJ_NUDGE": implicit.NUDGE,
    }
