"""Linearly implicit midpoint for the compiled clockwork: its passes as generated functions for midpoint.c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from flexjoint.model.dynamics import State
from flexjoint.simulation.schemes import midpoint
from flexjoint.simulation.schemes.conservation import Conservation
from flexjoint.simulation.schemes.discrete import DiscreteModel

PASS = "fj_pass"
REST = ("fj_totals", "fj_right")
FLOATING, FIXED = 17, 4  # totals of a robot


@dataclass(frozen=True)
class Symbols:
    """Arguments of the functions besides a state row, torques, constants and time: way and guess (nv,) of a
    pass, a configuration q (nq,) and velocities passed and end (nv,), totals before and after, a work."""

    way: ca.SX
    guess: ca.SX
    q: ca.SX
    passed: ca.SX
    end: ca.SX
    before: ca.SX
    after: ca.SX
    work: ca.SX


def symbols(layout: DiscreteModel) -> Symbols:
    model = layout.symbolic.model
    nv, count = model.nv, FLOATING if _conservation(layout).floating else FIXED
    return Symbols(
        way=ca.SX.sym("way", nv),
        guess=ca.SX.sym("guess", nv),
        q=ca.SX.sym("q", model.nq),
        passed=ca.SX.sym("passed", nv),
        end=ca.SX.sym("end", nv),
        before=ca.SX.sym("before", count),
        after=ca.SX.sym("after", count),
        work=ca.SX.sym("work"),
    )


def arguments(own: Symbols, x: ca.SX, u: ca.SX, c: ca.SX, t: ca.SX) -> dict[str, list[ca.SX]]:
    """Of the functions, of a state row, torques, constants and time."""
    ends = [own.before, own.after, own.q, own.passed, own.end, own.work, c]
    return {PASS: [x, u, c, t, own.way, own.guess], "fj_totals": [own.q, own.passed, c], "fj_right": ends}


def passed(layout: DiscreteModel, state: State, own: Symbols) -> ca.SX:
    """The state row at a pass's end, its midpoint velocity and the work of the torques on the links."""
    scheme = midpoint.Midpoint(layout.symbolic.model, 1.0 / layout.rate)
    made = scheme.one_pass(state, layout.symbolic.u, own.way, own.guess)
    return ca.SX(ca.vertcat(layout.pack(made.end), made.v_mid, made.work))


def kept(layout: DiscreteModel, own: Symbols) -> tuple[ca.SX, ca.SX]:
    """Totals of q and passed; the end velocity that is put right, and whether it is sound."""
    keeps = _conservation(layout)
    totals = ca.vertcat(*keeps.totals(own.q, own.passed))
    right, fits = keeps.put_right(own.before, own.after, own.q, own.passed, own.end, own.work)
    return ca.SX(totals), ca.SX(ca.vertcat(right, fits))


def sizes(layout: DiscreteModel, functions: Sequence[ca.Function]) -> dict[str, int]:
    """Sizes that midpoint.c wants; functions: the pass and REST."""
    model, keeps = layout.symbolic.model, _conservation(layout)
    return {
        "FJ_STEP_ARG": max(function.sz_arg() for function in functions),
        "FJ_STEP_RES": max(function.sz_res() for function in functions),
        "FJ_STEP_W": max(function.sz_w() for function in functions) + 1,
        "FJ_TOTALS": functions[1].numel_out(0),
        "FJ_TURNING": 3 if keeps.floating else 0,
        "FJ_FREE": int(keeps.free),
        "FJ_ACC": model.nx,
    }


def numbers(layout: DiscreteModel) -> dict[str, float]:
    """The step, and when a pass is repeated (flexjoint.simulation.schemes.midpoint)."""
    h = 1.0 / layout.rate
    return {
        "FJ_H": h,
        "FJ_HALF": 0.5 * h,
        "FJ_MISSED": midpoint.MISSED,
        "FJ_STAYS": midpoint.STAYS,
        "FJ_LEAST": midpoint.NEGLIGIBLE / (midpoint.MISSED * h),
        "FJ_ALONE": int(not midpoint.Midpoint(layout.symbolic.model, h).repeats),
        "FJ_REPEATS": midpoint.REPEATS,
        "FJ_GROWS": midpoint.GROWS,
        "FJ_FOLLOWED": midpoint.FOLLOWED,
    }


def _conservation(layout: DiscreteModel) -> Conservation:
    return Conservation(layout.symbolic.model, 1.0 / layout.rate)
