"""Rollouts by the compiled clockwork or the pin loop: the same arguments, the same result to rounding.

`auto` takes the compiled one for runs long enough to be worth a compilation, the pin loop for short ones
and where there is no C compiler or no symbolic model; which, does not depend on what is in the cache, so a
run repeats bit by bit.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, TypeVar

import numpy as np

from flexjoint import clockwork
from flexjoint.clockwork import REFERENCES, Ticks, check_references, check_torque
from flexjoint.compiled import CompiledModel, CompiledRates, CompilerError, Job, compiled_for
from flexjoint.compiled.model import row_of
from flexjoint.control import Law
from flexjoint.errors import FlexJointError, SimulationError, unknown
from flexjoint.integrate import DEFAULT
from flexjoint.model import FlexibleJointModel, State
from flexjoint.stability import check_stability
from flexjoint.trajectory import Past, Trajectory

Engine = Literal["auto", "compiled", "pin"]
ADAPTIVE = "reference"
Made = TypeVar("Made", CompiledModel, CompiledRates)
ENGINES = ("auto", "compiled", "pin")
LONG = 20_000  # steps from which `auto` compiles any model
PER_JOINT = 2_500  # and of small ones, joint by joint: about the pin loop's time for a compilation
LEAST = 5_000

log = logging.getLogger("flexjoint")
_said: set[str] = set()


def rollout(
    model: FlexibleJointModel,
    start: State,
    torque: np.ndarray,
    rate: float,
    past: Past | None = None,
    scheme: str = DEFAULT,
    width: float | None = None,
    engine: Engine = "auto",
    runs: int = 1,
) -> Trajectory:
    """`flexjoint.clockwork.rollout` by the engine: auto, compiled or pin. `auto` counts the steps of all
    `runs` of this length that the caller is about to make.

    Raises what that raises, UnknownNameError for another engine, and for `compiled` CompilerError where
    there is no compiler.
    """
    torque = check_torque(model, torque)
    if scheme == ADAPTIVE:
        model = adaptive(model, runs * len(torque), engine)
        return clockwork.rollout(model, start, torque, rate, past, scheme, width)
    compiled = choose(model, runs * len(torque), rate, None, (), scheme, width, engine)
    if compiled is None:
        return clockwork.rollout(model, start, torque, rate, past, scheme, width)
    return _run(compiled, model, start, None, torque, past)


def closed_loop(
    model: FlexibleJointModel,
    start: State,
    law: Law,
    references: Mapping[str, np.ndarray],
    rate: float,
    past: Past | None = None,
    scheme: str = DEFAULT,
    width: float | None = None,
    engine: Engine = "auto",
    runs: int = 1,
) -> Trajectory:
    """`flexjoint.clockwork.closed_loop` by the engine: as `rollout`."""
    ticks = check_references(references, len(model.joints))
    steps = Ticks(rate, model.robot.rates.control).steps(ticks)
    if scheme == ADAPTIVE:
        model = adaptive(model, runs * steps, engine)
        return clockwork.closed_loop(model, start, law, references, rate, past, scheme, width)
    compiled = choose(model, runs * steps, rate, law, REFERENCES, scheme, width, engine)
    if compiled is None:
        return clockwork.closed_loop(model, start, law, references, rate, past, scheme, width)
    return _run(compiled, model, start, law, compiled.references(references), past)


def long(model: FlexibleJointModel) -> int:
    """Steps from which `auto` compiles the model."""
    return min(LONG, max(LEAST, PER_JOINT * len(model.joints)))


def choose(
    model: FlexibleJointModel,
    steps: int,
    rate: float,
    law: Law | None,
    references: Sequence[str],
    scheme: str,
    width: float | None,
    engine: Engine,
) -> CompiledModel | None:
    """The compiled model that `engine` asks for, or None for the pin loop. Says the choice of `auto` once,
    at info level."""

    def made() -> CompiledModel:
        return compiled_for(model, rate, law, references, scheme, width)

    return _chosen(made, steps >= long(model), engine, scheme)


def adaptive(model: FlexibleJointModel, steps: int, engine: Engine) -> FlexibleJointModel:
    """The model as the engine runs it under the scheme `reference`, whose solver stays in Python: with its
    right-hand side compiled, or as it is."""

    def made() -> CompiledRates:
        rates = CompiledRates(model)
        rates.phases  # noqa: B018  compiles them
        return rates

    return _chosen(made, steps >= long(model), engine, ADAPTIVE) or model


def _chosen(make: Callable[[], Made], worthwhile: bool, engine: Engine, scheme: str) -> Made | None:
    """What `make` makes, or None, as `choose` says."""
    if engine not in ENGINES:
        raise unknown("engine", engine, ENGINES)
    if engine == "compiled":
        return make()
    if engine == "pin" or not worthwhile:
        return None
    try:
        made = make()
    except SimulationError:
        raise  # the pin loop would refuse it, too
    except CompilerError as error:
        _say(f"simulating by the pin loop: {error}")
    except FlexJointError as error:
        _say(f"simulating by the pin loop, for there is no symbolic model: {error}")
    except (TypeError, RuntimeError, NotImplementedError) as error:
        # CasADi raises these at a scheme or law that does not take its expressions
        line = " ".join(str(error).split())[:200]
        _say(f"simulating by the pin loop, for {scheme} or the control law takes numbers only: {line}")
    else:
        _say(f"simulating long runs as C, compiled by {made.compiler.name}")
        return made
    return None


def job_of(
    compiled: CompiledModel,
    model: FlexibleJointModel,
    start: State,
    law: Law | None,
    drive: np.ndarray,
    past: Past | None = None,
) -> Job:
    """The job of a run; drive: torques (N, n) without a law, else `compiled.references(...)`."""
    return Job(
        row=row_of(model, start),
        t=float(start.t),
        values=compiled.values(model),
        drive=drive,
        gains=compiled.gains(law),
        steps=compiled.ticks.steps(len(drive)),
        before=None if past is None else compiled.before(model, start, past),
    )


def _run(
    compiled: CompiledModel,
    model: FlexibleJointModel,
    start: State,
    law: Law | None,
    drive: np.ndarray,
    past: Past | None,
) -> Trajectory:
    check_stability(model, start, 1.0 / compiled.rate, compiled.scheme)
    job = job_of(compiled, model, start, law, drive, past)
    return compiled.trajectory(job, compiled.run(job))


def _say(message: str) -> None:
    if message not in _said:
        _said.add(message)
        log.info(message)
