"""The engine of a run: the compiled clockwork or the pin loop, with the same result to rounding.

`auto` takes the compiled one for runs long enough that compiling pays, the pin loop for short ones
and where there is no C compiler or no symbolic model. The choice does not depend on what is in the cache, so
a run repeats bit by bit.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from flexjoint.core.errors import FlexJointError, SimulationError
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.simulation.compiled import (
    CompiledModel,
    CompiledRates,
    CompilerError,
    Job,
    compiled_for,
)
from flexjoint.simulation.compiled.model import row_of
from flexjoint.simulation.controllers import Law
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.trajectory import Past

Made = TypeVar("Made", CompiledModel, CompiledRates)
LONG = 20_000  # steps from which `auto` compiles any model
PER_JOINT = 2_500  # and of small ones, joint by joint: about the pin loop's time for a compilation
# where a step solves dry friction, which takes the pin loop long: of a KR300 and a TX40 at rest, six joints
# each, compiling takes as long as some 3100 steps
PER_RUBBING_JOINT = 1_000
LEAST = 5_000

log = logging.getLogger("flexjoint")
_said: set[str] = set()


def long(model: FlexibleJointModel) -> int:
    """Steps from which `auto` compiles the model."""
    each = PER_RUBBING_JOINT if model.rubs else PER_JOINT
    return min(LONG, max(LEAST, each * len(model.joints)))


def choose(
    model: FlexibleJointModel,
    steps: int,
    options: RunOptions,
    law: Law | None = None,
    references: Sequence[str] = (),
    many: bool = False,
) -> CompiledModel | None:
    """The compiled model that the options ask for, or None for the pin loop; with `many`, one that runs
    several jobs side by side. Says the choice of `auto` once, at info level."""

    def made() -> CompiledModel:
        return compiled_for(model, options, law=law, references=references, many=many)

    return _chosen(made, steps >= long(model), options)


def adaptive(model: FlexibleJointModel, steps: int, options: RunOptions) -> FlexibleJointModel:
    """The model as the engine runs it under an adaptive scheme, whose solver stays in Python: with its
    right-hand side compiled, or as it is."""

    def made() -> CompiledRates:
        rates = CompiledRates(model)
        rates.phases  # noqa: B018  compiles them
        return rates

    return _chosen(made, steps >= long(model), options) or model


def _chosen(make: Callable[[], Made], pays: bool, options: RunOptions) -> Made | None:
    """What `make` makes, or None, as `choose` says."""
    if options.engine == "compiled":
        return make()
    if options.engine == "pin" or not pays:
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
        _say(
            f"simulating by the pin loop, for {options.scheme} or the control law takes numbers only: {line}"
        )
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


def _say(message: str) -> None:
    if message not in _said:
        _said.add(message)
        log.info(message)
