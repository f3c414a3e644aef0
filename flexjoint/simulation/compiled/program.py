"""The C program of a model: its step, sensors and control law as generated functions, and the driver.

Parameters of robot, effects and law are inputs. What depends on parameters alone (K dt/2 + D, sines of a
base's tilt, ...) is computed once per run by fj_setup and not in every step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import resources
from typing import Any

import casadi as ca
import numpy as np

from flexjoint.core.errors import ModelError
from flexjoint.core.functions import c_source, unguarded
from flexjoint.effects import SENSOR_CHANNELS, Signals
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.rigidbody.symbolic import SymbolicBody
from flexjoint.simulation.compiled import midpoint as passes
from flexjoint.simulation.compiled import newton as implicit_newton
from flexjoint.simulation.compiled.lanes import laned
from flexjoint.simulation.controllers import Law, Mixed
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.schemes import DEFAULT, find
from flexjoint.simulation.schemes.base import Scheme
from flexjoint.simulation.schemes.discrete import DiscreteModel

LARGE = 30_000  # operations of a step: CENTAURO's by the default scheme has 16 000, by RK4 60 000
_ABA = ("q", "v", "tau", "armature")


@dataclass(frozen=True, kw_only=True)
class Program:
    """C source and the sizes of what goes in and out.

    A state row holds x (nx,), acc (nv,), ddtheta (nf,), tau_rigid (nr,). `reads` are the channels of the law,
    `references` the names in a row of reference; gains are the law's fields in `gains`, in their order.
    """

    source: str
    nq: int
    nv: int
    row: int
    inputs: int
    readings: int
    reference: int
    gain: int
    parameters: int
    constants: int
    observed: int
    reads: tuple[str, ...]
    references: tuple[str, ...]
    gains: tuple[str, ...]


def write_program(
    symbolic: SymbolicModel,
    options: RunOptions,
    law: Law | None = None,
    references: Sequence[str] = (),
    many: bool = False,
) -> Program:
    """The program of a symbolic model; without a law it takes given torques. With `many` its numbers are
    lanes, each of another rollout; for schemes that have lanes.

    Raises what the symbolic model and the scheme raise; ModelError, or whatever its code raises on
    expressions, for a law that takes numbers only.
    """
    model, n = symbolic.model, len(symbolic.robot.joints)
    rate, width, used = options.rate_for(symbolic.robot), options.width, find(options.scheme)
    used.check(model, width)
    newton, repeats = used.newton, used.repeats
    # the state's layout is that of every scheme
    discrete = DiscreteModel(symbolic, rate, DEFAULT if newton else used.name, width)
    x = ca.SX.sym("x", discrete.plain)
    state = discrete.unpack(x)
    true = {(channel, i): value for (channel, i), value in symbolic.true(state).items()}
    for place, i in enumerate(model.rigid):
        true["tau_t", i] = state.tau_rigid[place]
    reads = () if law is None else law.reads
    y, r = ca.SX.sym("y", n * len(reads)), ca.SX.sym("r", n * len(references))
    free, gains = (None, {}) if law is None else free_law(law)
    g = ca.vertcat(ca.SX(0, 1), *gains.values())
    torque: ca.SX = ca.SX.zeros(n)
    if free is not None:
        reading = {
            channel: ca.vertcat(
                *(
                    flow.read(channel, Signals(t=symbolic.t), y[k * n + i])
                    for i, flow in enumerate(model.flows)
                )
            )
            for k, channel in enumerate(reads)
        }
        reference = {name: r[k * n : (k + 1) * n] for k, name in enumerate(references)}
        torque = ca.SX(ca.densify(free.torque(reference, reading)))
    w = implicit_newton.unknowns(discrete)
    own_symbols = passes.symbols(discrete)
    names: tuple[str, ...] = implicit_newton.OUTPUTS if newton else ("fj_step",)
    if newton:
        stepped, calls = _with_calls(
            symbolic, lambda: implicit_newton.equations(discrete, state, w, 1.0 / rate, width)
        )
    elif repeats:
        names = (passes.PASS,)
        stepped, calls = _with_calls(symbolic, lambda: (passes.passed(discrete, state, own_symbols),))
    else:
        stepped, calls = _with_calls(symbolic, lambda: (discrete.advanced(state, symbolic.u),))
    outputs = {
        **dict(zip(names, stepped, strict=True)),
        **(dict(zip(passes.REST, passes.kept(discrete, own_symbols), strict=True)) if repeats else {}),
        # at a tick the command to come is not known: a law sees springs without it
        "fj_signals": ca.substitute(
            _column(true[channel, i] for channel in reads for i in range(n)), symbolic.u, ca.SX.zeros(n)
        ),
        "fj_observe": _column(true[channel, i] for channel in SENSOR_CHANNELS for i in range(n)),
        "fj_control": torque,
    }
    # the tree of bodies is large: shared expressions are found once for all functions
    shared = ca.cse([ca.densify(value) for value in outputs.values()])
    rest, symbols, constant = shared, [symbolic.p], [symbolic.p]
    if not calls:  # else CasADi gives constants that hang on one another
        rest, symbols, constant = ca.extract_parametric(shared, symbolic.p, {"extract_trivial": True})
    c = ca.vertcat(ca.SX(0, 1), *symbols)
    bodies = dict(zip(outputs, rest, strict=True))
    arguments = {
        "fj_step": [x, symbolic.u, c, symbolic.t],
        "fj_guess": [x, symbolic.u, c, symbolic.t],
        "fj_missing": [w, x, symbolic.u, c, symbolic.t],
        "fj_end": [w, x, symbolic.u, c, symbolic.t],
        **passes.arguments(own_symbols, x, symbolic.u, c, symbolic.t),
        "fj_signals": [x, c, symbolic.t],
        "fj_observe": [x, symbolic.u, c, symbolic.t],
        "fj_control": [y, r, g, c, symbolic.t],
    }
    parts = {name: [body] for name, body in bodies.items()}
    if repeats:  # the state row apart, straight to where it belongs
        parts[passes.PASS] = ca.vertsplit(
            bodies[passes.PASS], [0, discrete.plain, bodies[passes.PASS].numel()]
        )
    functions = [ca.Function(name, arguments[name], parts[name]) for name in outputs]
    functions.append(ca.Function("fj_setup", [symbolic.p], [ca.vertcat(ca.SX(0, 1), *constant)]))
    sizes = {
        "FJ_NQ": model.nq,
        "FJ_NV": model.nv,
        "FJ_NF": model.nf,
        "FJ_NX": discrete.plain,
        "FJ_NU": n,
        "FJ_NY": n * len(reads),
        "FJ_NR": n * len(references),
        "FJ_NG": g.numel(),
        "FJ_NC": c.numel(),
        "FJ_NO": 7 * n,
    }
    numbers, file = _stepping(discrete, used, functions)
    numbers, files = {**sizes, **numbers}, ["setup.c", *file, "driver.c"]
    return Program(
        source=c_program(functions, numbers, files, many),
        nq=model.nq,
        nv=model.nv,
        row=discrete.plain,
        inputs=n,
        readings=sizes["FJ_NY"],
        reference=sizes["FJ_NR"],
        gain=sizes["FJ_NG"],
        parameters=symbolic.p.numel(),
        constants=sizes["FJ_NC"],
        observed=sizes["FJ_NO"],
        reads=tuple(reads),
        references=tuple(references),
        gains=tuple(gains),
    )


def c_program(
    functions: Sequence[ca.Function], numbers: Mapping[str, float], files: Sequence[str], many: bool = False
) -> str:
    """C source of generated functions, of numbers as macros, and of files in sources/, which use both; with
    `many`, in the lanes of lanes.c.

    Raises ModelError where a law or effect makes no expressions of expressions.
    """
    generated = c_source(functions)
    if "=casadi_nan;" in generated:  # float() and math.sin() of an expression give that, and say nothing
        raise ModelError(
            "the control law, a commanded spring or an effect takes numbers only; write it with"
            " flexjoint.core.ops"
        )
    defines = "".join(f"#define {name} {number}\n" for name, number in numbers.items())
    export = '#define FJ_EXPORT __attribute__((visibility("default")))\n'
    folder = resources.files("flexjoint.simulation.compiled") / "sources"
    lanes, *own = [folder.joinpath(name).read_text(encoding="utf-8") for name in ["lanes.c", *files]]
    generated = unguarded(generated)
    if many:
        lanes, generated = "#define FJ_MANY\n" + lanes, laned(generated)
    return "\n".join([lanes, generated, defines + export, *own])


def _with_calls(
    symbolic: SymbolicModel, make: Callable[[], tuple[ca.SX, ...]]
) -> tuple[tuple[ca.SX, ...], bool]:
    """The expressions that `make` makes of the symbolic model, and whether they hold calls.

    Where a scheme evaluates a large tree of bodies several times, the C has its articulated-body algorithm
    once, as a function: compilers take more than proportional time for one that is several times as long.
    """
    model, body = symbolic.model, symbolic.model.body
    whole = tuple(ca.cse([ca.densify(value) for value in make()]))
    if sum(ca.n_nodes(value) for value in whole) <= LARGE:
        return whole, False
    model.body = _CalledBody(body)
    try:
        return make(), True
    finally:
        model.body = body


def _stepping(
    discrete: DiscreteModel, scheme: Scheme, functions: Sequence[ca.Function]
) -> tuple[dict[str, float], list[str]]:
    """Numbers for the C of a step, and the file that has it where it is not generated; functions: those of a
    step come first."""
    if scheme.newton:
        own = functions[: len(implicit_newton.OUTPUTS)]
        return {**implicit_newton.sizes(own), **implicit_newton.numbers()}, ["newton.c"]
    if scheme.repeats:
        own = functions[: 1 + len(passes.REST)]
        return {**passes.sizes(discrete, own), **passes.numbers(discrete)}, ["midpoint.c"]
    step = functions[0]
    return {"FJ_STEP_ARG": step.sz_arg(), "FJ_STEP_RES": step.sz_res(), "FJ_STEP_W": step.sz_w() + 1}, []


class _CalledBody:
    """A SymbolicBody whose `aba` stays a call in expressions."""

    def __init__(self, body: SymbolicBody) -> None:
        self._body = body
        symbols = ca.symvar(ca.vertcat(ca.vec(body.inertial), body.gravity))
        self._own = ca.vertcat(ca.SX(0, 1), *symbols)  # parameters of effects on the body
        q, v, tau, armature = (ca.SX.sym(name, body.nq if name == "q" else body.nv) for name in _ABA)
        acc = ca.cse(body.aba(q, v, tau, armature))
        inputs = [q, v, tau, armature, self._own]
        self._aba = ca.Function("aba", inputs, [acc], {"never_inline": True})

    def aba(self, q: ca.SX, v: ca.SX, tau: ca.SX, armature: ca.SX) -> ca.SX:
        return ca.SX(self._aba(q, v, tau, armature, self._own))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._body, name)


def free_law(law: Law) -> tuple[Any, dict[str, ca.SX]]:
    """The law with symbols for its numbers, and these by field; words and switches stay."""
    symbols = {name: ca.SX.sym(name, len(value)) for name, value in numbers_of(law).items()}
    return with_numbers(law, symbols), symbols


def numbers_of(law: Any) -> dict[str, np.ndarray]:
    """The law's numbers by field, each (k,); those of the parts of a `Mixed` law as 0.kp, 1.kp, ..."""
    if isinstance(law, Mixed):
        parts = enumerate(part for _, part in law.parts)
        return {f"{k}.{name}": value for k, part in parts for name, value in numbers_of(part).items()}
    found: dict[str, Any] = {field.name: getattr(law, field.name) for field in fields(law)}
    numeric = {
        name: value
        for name, value in found.items()
        if isinstance(value, (int, float, np.ndarray)) and not isinstance(value, bool)
    }
    return {name: np.atleast_1d(np.asarray(value, dtype=float)) for name, value in numeric.items()}


def with_numbers(law: Any, numbers: Mapping[str, Any]) -> Any:
    """The law with some of the numbers of `numbers_of` replaced."""
    if isinstance(law, Mixed):
        parts = []
        for k, (places, part) in enumerate(law.parts):
            own = {name.split(".", 1)[1]: x for name, x in numbers.items() if name.startswith(f"{k}.")}
            parts.append((places, with_numbers(part, own)))
        return Mixed(tuple(parts))
    return replace(law, **numbers)


def _column(values: Any) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *values)
