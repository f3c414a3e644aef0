"""casadi.Functions as compiled code, from the same cache as the compiled models."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import casadi as ca

from flexjoint.core.functions import c_source
from flexjoint.simulation.compiled.cache import library
from flexjoint.simulation.compiled.compiler import FUNCTIONS, CompilerError, compilers

# a compiler takes some 0.2 ms an operation, CasADi's virtual machine some 10 ns more than compiled code does
BREAK_EVEN = 20_000  # evaluations from which compiling is quicker than not compiling
LARGEST = 60_000  # operations: a compiler takes more than proportional time for more
EXPORT = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n'


def compiling_pays(operations: int, evaluations: int) -> bool:
    """Whether so many evaluations of so many operations are quicker with the compiler's time than without
    both."""
    return evaluations > BREAK_EVEN and operations < LARGEST


def compiled(functions: Sequence[ca.Function]) -> list[ca.Function]:
    """The same functions as compiled code, made side by side; each itself where there is no C compiler that
    works."""
    with ThreadPoolExecutor() as threads:  # they wait for a compiler
        return list(threads.map(_compiled, functions, [c_source([f]) for f in functions]))


def _compiled(function: ca.Function, source: str) -> ca.Function:
    for compiler in compilers():
        try:
            return ca.external(function.name(), str(library(EXPORT + source, compiler, FUNCTIONS)))
        except (CompilerError, RuntimeError):
            continue
    return function
