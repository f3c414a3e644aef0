"""The only place that switches between NumPy and CasADi.

Laws of effects are written once with these functions and take floats, NumPy arrays or CasADi
expressions alike. `np.where`, `np.clip`, `np.maximum` and `np.sum` misbehave on CasADi SX: a law
uses these instead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import casadi as ca
import numpy as np

Value = Any  # float | np.ndarray | ca.SX | ca.MX: the laws are elementwise in all of them

_SYMBOLIC = (ca.SX, ca.MX, ca.DM)


def is_symbolic(*values: Value) -> bool:
    """Whether any of the values is a CasADi expression."""
    for value in values:  # noqa: SIM110  several times quicker than any() with a generator
        if isinstance(value, _SYMBOLIC):
            return True
    return False


def where(condition: Value, yes: Value, no: Value) -> Value:
    """Elementwise choice; both branches are evaluated."""
    if condition is True or condition is False:
        return yes if condition else no
    if is_symbolic(condition, yes, no):
        return ca.if_else(condition, yes, no)
    if isinstance(condition, (bool, np.bool_)):
        return yes if condition else no
    return np.where(condition, yes, no)


def both(a: Value, b: Value) -> Value:
    """Elementwise logical and."""
    return ca.logic_and(a, b) if is_symbolic(a, b) else np.logical_and(a, b)


def sign(x: Value) -> Value:
    return ca.sign(x) if is_symbolic(x) else np.sign(x)


def absolute(x: Value) -> Value:
    if isinstance(x, float):  # a scalar in a simulation's step: NumPy would take ten times as long
        return abs(x)
    return ca.fabs(x) if is_symbolic(x) else np.abs(x)


def minimum(a: Value, b: Value) -> Value:
    if isinstance(a, float) and isinstance(b, float):
        return min(a, b)
    return ca.fmin(a, b) if is_symbolic(a, b) else np.minimum(a, b)


def maximum(a: Value, b: Value) -> Value:
    if isinstance(a, float) and isinstance(b, float):
        return max(a, b)
    return ca.fmax(a, b) if is_symbolic(a, b) else np.maximum(a, b)


def clip(x: Value, low: Value, high: Value) -> Value:
    return minimum(maximum(x, low), high)


def _unary(name: str) -> Any:
    symbolic, numeric, scalar = getattr(ca, name), getattr(np, name), getattr(math, name)

    def apply(x: Value) -> Value:
        if isinstance(x, float):
            return scalar(x)
        return symbolic(x) if is_symbolic(x) else numeric(x)

    apply.__name__ = name
    return apply


sin = _unary("sin")
cos = _unary("cos")
sqrt = _unary("sqrt")
tanh = _unary("tanh")


def exp(x: Value) -> Value:
    """exp, with its argument held above -300: below it the value is 0 for any use, and the underflow
    of its products would be raised as a floating-point error."""
    if isinstance(x, float):
        return math.exp(max(x, -300.0))
    return ca.exp(ca.fmax(x, -300.0)) if is_symbolic(x) else np.exp(np.maximum(x, -300.0))


def vector(values: Iterable[Value], symbolic: bool) -> Value:
    """A vector of scalars: of expressions where `symbolic`, else of numbers."""
    entries = list(values)
    return ca.SX(ca.vertcat(*entries)) if symbolic else np.array(entries, dtype=float)


def zeros(size: int, symbolic: bool) -> Value:
    """A vector of zeros: of expressions where `symbolic`, else of numbers."""
    return ca.SX.zeros(size) if symbolic else np.zeros(size)


def matrix(rows: Sequence[Sequence[Value]], symbolic: bool) -> Value:
    """A matrix of rows of scalars: of expressions where `symbolic`, else of numbers."""
    return ca.SX(ca.blockcat([list(row) for row in rows])) if symbolic else np.array(rows, dtype=float)


def solve(matrix: Value, right: Value) -> Value:
    """matrix^-1 right, of a small matrix that is not singular."""
    return ca.solve(matrix, right) if is_symbolic(matrix, right) else np.linalg.solve(matrix, right)


def items(vector: Value) -> Any:
    """A vector's entries as scalars (Python floats: their arithmetic is several times quicker)."""
    return vector.tolist() if isinstance(vector, np.ndarray) else vector


def stack(entries: Sequence[Value]) -> Value:
    """Scalars, or rows of equal shape, as one vector or array."""
    return ca.vertcat(*entries) if is_symbolic(*entries) else np.array(entries)


def join(vectors: Sequence[Value]) -> Value:
    """Vectors one after the other."""
    return ca.vertcat(*vectors) if is_symbolic(*vectors) else np.concatenate(vectors)


def dot(a: Value, b: Value) -> Value:
    """Sum of products of the entries of two vectors."""
    return ca.dot(a, b) if is_symbolic(a, b) else float(a @ b)


def copy(vector: Value) -> Value:
    """A vector that may be written on."""
    return vector.copy() if isinstance(vector, np.ndarray) else type(vector)(vector)
