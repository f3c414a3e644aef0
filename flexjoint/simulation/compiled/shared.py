"""Compiled models shared within a process, so that a fit or a loop compiles once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.compiled.model import RATES_FREE, CompiledModel, RatesProgram
from flexjoint.simulation.compiled.program import numbers_of
from flexjoint.simulation.controllers import Law, Mixed
from flexjoint.simulation.options import DEFAULTS, RunOptions

KEPT = 64  # programs; the least recently used one goes

_made: OrderedDict[Any, Any] = OrderedDict()
_lock = threading.Lock()
Made = TypeVar("Made")


def compiled_for(
    model: FlexibleJointModel,
    options: RunOptions = DEFAULTS,
    *,
    law: Law | None = None,
    references: Sequence[str] = (),
    free: Collection[str] = ("drives",),
    commanded: Collection[str] = (),
    many: bool = False,
) -> CompiledModel:
    """The compiled model of this structure, made if need be. Arguments and errors as for CompiledModel."""
    timing = (options.rate_for(model.robot), options.scheme, options.width)
    key = (*_structure(model, timing, law, references, free), tuple(commanded), many)

    def make() -> CompiledModel:
        return CompiledModel(
            model, options, law=law, references=references, free=free, commanded=commanded, many=many
        )

    return _shared(key, make)


def rates_for(model: FlexibleJointModel, at: float | None) -> RatesProgram:
    """The compiled right-hand side of this structure, made if need be; errors as for RatesProgram."""
    key = (*_structure(model, ("rates",), None, (), RATES_FREE), at)
    return _shared(key, lambda: RatesProgram(model, at))


def _shared(key: Any, make: Callable[[], Made]) -> Made:
    with _lock:
        if key not in _made:
            # what is made holds its model's robot, so that the ids in the key stay taken
            _made[key] = make()
            if len(_made) > KEPT:
                _made.popitem(last=False)
        _made.move_to_end(key)
        made: Made = _made[key]
        return made


def _structure(
    model: FlexibleJointModel,
    timing: tuple[object, ...],
    law: Law | None,
    references: Sequence[str],
    free: Collection[str],
) -> Any:
    """All that the program depends on. Numbers of joints count unless they are free."""
    robot = model.robot
    joints = tuple(
        (j.name, j.idx_q, j.idx_v, j.pin_id, j.rigid, None if "drives" in free else j.drive)
        for j in model.joints
    )
    effects = tuple(
        (
            *item.key,
            tuple(getattr(item.p, word.name) for word in item.effect.words),
            item.since,
            item.switches,
        )
        for item in model.effects
    )
    control = None
    if law is not None:
        sizes = tuple((name, len(value)) for name, value in numbers_of(law).items())
        control = (_words(law), sizes, tuple(references))
    springs = tuple(sorted((name, id(s.stiffness), id(s.damping)) for name, s in model.springs.items()))
    timing = (*timing, robot.rates.control, robot.file.sensing_delay)
    ground = robot.contacts, robot.ground
    return id(robot.model), ground, robot.couplings, joints, effects, springs, control, timing, tuple(free)


def _words(law: Any) -> Any:
    """What of a law is not numbers: its kind, switches, and which joints the parts of a `Mixed` one drive."""
    if isinstance(law, Mixed):
        return tuple((places, _words(part)) for places, part in law.parts)
    numbers = numbers_of(law)
    words = tuple((f.name, getattr(law, f.name)) for f in fields(law) if f.name not in numbers)
    return type(law), words
