"""A single casadi.Function as compiled code, from the same cache as the compiled models."""

from __future__ import annotations

import casadi as ca

from flexjoint.c_code import c_source
from flexjoint.compiled.cache import library
from flexjoint.compiled.compiler import CompilerError, compilers

# a compiler takes some 0.2 ms an operation, CasADi's virtual machine some 10 ns more than compiled code does
BREAK_EVEN = 20_000  # evaluations from which compiling is quicker than not compiling
LARGEST = 60_000  # operations: a compiler takes more than proportional time for more
# GCC's register allocator would colour a graph of conflicts, which takes a third of all time for so long a
# straight line and makes it no quicker (steps in a loop it does); Clang ignores this
STRAIGHT = ("--param=ira-max-conflict-table-size=0",)
EXPORT = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n'


def worth_compiling(function: ca.Function, evaluations: int) -> bool:
    """Whether so many evaluations are quicker with the compiler's time than without both."""
    return evaluations > BREAK_EVEN and function.n_instructions() < LARGEST


def compiled(function: ca.Function) -> ca.Function:
    """The same function as compiled code; itself where there is no C compiler that works."""
    source = EXPORT + c_source([function])
    for compiler in compilers():
        try:
            return ca.external(function.name(), str(library(source, compiler, STRAIGHT)))
        except (CompilerError, RuntimeError):
            continue
    return function
