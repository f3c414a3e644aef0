"""C source of casadi.Functions of SX expressions."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca


def renamed(function: ca.Function, name: str) -> ca.Function:
    """The function under another name."""
    inputs = function.sx_in()
    outputs = function.call(inputs, True, False)
    return ca.Function(name, inputs, outputs, function.name_in(), function.name_out())


def c_source(functions: Sequence[ca.Function]) -> str:
    """C99 source of functions, each `int name(const double** arg, double** res, ...)` as CasADi makes it."""
    generator = ca.CodeGenerator("flexjoint", {"with_mem": False, "with_header": False})
    for function in functions:
        generator.add(function)
    return generator.dump()


def unguarded(source: str) -> str:
    """The source without CasADi's guard of every access against null pointers: arg and res must be whole."""
    source = re.sub(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0", r"arg[\1][\2]", source)
    return re.sub(r"if \(res\[(\d+)\]!=0\) ", "", source)
