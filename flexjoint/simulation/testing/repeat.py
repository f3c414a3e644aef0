"""The same bits again, in this process and in a new one."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import fields
from multiprocessing import get_context

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.simulation.testing.golden import GoldenRun
from flexjoint.simulation.trajectory import Trajectory

Result = Trajectory | GoldenRun | Mapping[str, np.ndarray]


def assert_deterministic(simulate: Callable[[], Result], new_process: bool = False) -> None:
    """Fail unless a function that simulates gives the same bits when it is called again.

    Args:
        simulate: builds what it needs (models, noise with a seed) and gives a Trajectory, a GoldenRun or
            arrays by name.
        new_process: call it in a new process, too; it must then be a function of a module, by its name
            (no lambda, none in a function), for the new process imports it.

    Raises:
        AssertionError: which signal differs, in which row first, by how much.
        FlexJointError: a result of another kind, or a function that a new process cannot import.
    """
    __tracebackhide__ = True
    first = _arrays(simulate())
    _compare(first, _arrays(simulate()), "a second call")
    if new_process:
        _compare(first, _elsewhere(simulate), "a call in a new process")


def _elsewhere(simulate: Callable[[], Result]) -> dict[str, np.ndarray]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(_call, simulate).result()
        except (pickle.PicklingError, AttributeError, ImportError, BrokenProcessPool) as error:
            name = getattr(simulate, "__qualname__", repr(simulate))
            raise FlexJointError(
                f"{name}: a new process cannot run it ({error}); give a function that stands by its name in a"
                " module"
            ) from None


def _call(simulate: Callable[[], Result]) -> dict[str, np.ndarray]:
    return _arrays(simulate())


def _arrays(result: Result) -> dict[str, np.ndarray]:
    if isinstance(result, Trajectory):
        names = [item.name for item in fields(Trajectory) if item.name != "first"]
        return {name: getattr(result, name) for name in names}
    if isinstance(result, GoldenRun):
        return {"time": result.time, **result.signals}
    if isinstance(result, Mapping):
        return {str(name): np.asarray(values) for name, values in result.items()}
    raise FlexJointError(
        "simulate: expected it to give a Trajectory, a GoldenRun or arrays by name, got"
        f" {type(result).__name__}"
    )


def _compare(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray], what: str) -> None:
    __tracebackhide__ = True
    if one.keys() != other.keys():
        raise AssertionError(
            f"not deterministic: {what} gives other signals: {', '.join(one.keys() ^ other.keys())}"
        )
    for name, values in one.items():
        again = other[name]
        if values.shape != again.shape:
            raise AssertionError(
                f"not deterministic: {what} gives {name} of shape {again.shape}, not {values.shape}"
            )
        # bits, not values: -0.0 is not 0.0 here, and a NaN equals itself
        unlike = np.ascontiguousarray(values).view(np.uint8) != np.ascontiguousarray(again).view(np.uint8)
        if np.any(unlike):
            rows = unlike.reshape(len(values), -1).any(axis=1)
            row = int(np.argmax(rows))
            gap = float(np.max(np.abs(np.asarray(values, dtype=float) - np.asarray(again, dtype=float))))
            raise AssertionError(
                f"not deterministic: {what} gives other bits in {name}, first in row {row} of {len(values)},"
                f" {gap:.3g} apart at most. Look for a random draw without a seed, for something that one"
                " call leaves behind for the next, or for threads"
            )
