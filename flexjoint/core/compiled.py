"""Functions compiled to machine code when they are first called (Numba), with what was compiled kept for the
next run. For plain loops over samples that a computation spends its time in."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """The function compiled. Its arguments are floats, integers, booleans, and arrays and tuples of these;
    operations keep the order in which they are written, so that results are the same bits as without."""
    try:
        made = njit(cache=True)(function)
    except RuntimeError:  # neither the package's folder nor the user's own can be written
        made = njit(function)
    return cast(Function, made)
