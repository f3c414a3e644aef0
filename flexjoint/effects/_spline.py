"""A smooth law without a name: a cubic spline of few numbers, which learned effects share.

Uniform B-splines (Eilers and Marx 1996): over [start, start + span], with h = span / (COUNT - 3),

    f(x) = sum_k c_k b((x - start)/h + 1 - k),    b(u) = (max(2 - |u|, 0)^3 - 4 max(1 - |u|, 0)^3) / 6,

linear in c, with two continuous derivatives. Outside of that range f keeps its value at the end, so that no
motion that was never recorded can make it large.
"""

from __future__ import annotations

from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter

COUNT = 12  # coefficients: a period and a half of a sine over the range to 1 %; a fit's penalty frees fewer
SIDE = 6  # of a law of two signals, by either: the product of two parabolas to a per cent
START = Parameter("start", "of the signal", "x_0", value=-1.0, low=-1e6, high=1e6, null=None)
SPAN = Parameter("span", "of the signal", "w", value=2.0, low=1e-6, high=1e6, null=None)


def spline(x: Value, p: Any, coefficients: Any) -> Value:
    """f(x) for coefficients (COUNT,)."""
    total: Value = 0.0
    for coefficient, piece in zip(coefficients, pieces(x, p.start, p.span, COUNT), strict=True):
        total = total + coefficient * piece
    return total


def surface(x: Value, y: Value, p: Any, coefficients: Any) -> Value:
    """f(x, y) = sum_jk c_jk b_j(x) b_k(y) for coefficients (SIDE^2,), those of one x together. A sum of a law
    of x and one of y is such a law, as the pieces add up to 1."""
    total: Value = 0.0
    across = pieces(y, p.other_start, p.other_span, SIDE)
    for j, piece in enumerate(pieces(x, p.start, p.span, SIDE)):
        row: Value = 0.0
        for coefficient, other in zip(coefficients[SIDE * j : SIDE * (j + 1)], across, strict=True):
            row = row + coefficient * other
        total = total + piece * row
    return total


def pieces(x: Value, start: Any, span: Any, count: int) -> list[Value]:
    """The B-splines at x, of which four are not 0."""
    u = ops.clip((x - start) * ((count - 3) / span), 0.0, count - 3.0)
    out: list[Value] = []
    for k in range(count):
        away = ops.absolute(u + (1.0 - k))
        outer, inner = ops.maximum(2.0 - away, 0.0), ops.maximum(1.0 - away, 0.0)
        out.append((outer * outer * outer - 4.0 * inner * inner * inner) / 6.0)
    return out


def spline_slope(x: Value, p: Any, coefficients: Any) -> Value:
    """df/dx; 0 outside of the range."""
    rate = (COUNT - 3) / p.span
    place = (x - p.start) * rate
    u = ops.clip(place, 0.0, COUNT - 3.0)
    total: Value = 0.0
    for k, coefficient in enumerate(coefficients):
        offset = u + (1.0 - k)
        away = ops.absolute(offset)
        outer, inner = ops.maximum(2.0 - away, 0.0), ops.maximum(1.0 - away, 0.0)
        steep = 2.0 * inner * inner - 0.5 * outer * outer
        total = total + coefficient * steep * ops.sign(offset)
    return ops.where(u == place, total * rate, 0.0)
