"""Compiled models shared within a process, so that a fit or a loop compiles once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from flexjoint.compiled.model import CompiledModel
from flexjoint.compiled.program import numbers_of
from flexjoint.compiled.rates import FREE, RatesProgram
from flexjoint.control import Law, Mixed
from flexjoint.integrate import DEFAULT
from flexjoint.model import FlexibleJointModel

KEPT = 64  # programs; the least recently used one goes

_made: OrderedDict[Any, Any] = OrderedDict()
_lock = threading.Lock()
Made = TypeVar("Made")


def compiled_for(
    model: FlexibleJointModel,
    rate: float,
    law: Law | None = None,
    references: Sequence[str] = (),
    scheme: str = DEFAULT,
    width: float | None = None,
    free: Collection[str] = ("drives",),
    commanded: Collection[str] = (),
) -> CompiledModel:
    """The compiled model of this structure, made if need be. Arguments and errors as for CompiledModel."""
    key = (*_structure(model, rate, law, references, scheme, width, free), tuple(commanded))
    return _shared(
        key, lambda: CompiledModel(model, rate, law, references, scheme, width, free, None, commanded)
    )


def rates_for(model: FlexibleJointModel, at: float) -> RatesProgram:
    """The compiled right-hand side of this structure, made if need be; errors as for RatesProgram."""
    key = (*_structure(model, 0.0, None, (), "rates", None, FREE), at)
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
    rate: float,
    law: Law | None,
    references: Sequence[str],
    scheme: str,
    width: float | None,
    free: Collection[str],
) -> Any:
    """All that the program depends on. Numbers of joints count unless they are free."""
    robot = model.robot
    joints = tuple(
        (j.name, j.idx_q, j.idx_v, j.pin_id, j.rigid, None if "drives" in free else j.drive)
        for j in model.joints
    )
    effects = tuple(
        (*item.key, tuple(getattr(item.p, word.name) for word in item.effect.words), item.since)
        for item in model.effects
    )
    control = None
    if law is not None:
        sizes = tuple((name, len(value)) for name, value in numbers_of(law).items())
        control = (_words(law), sizes, tuple(references))
    springs = tuple(sorted((name, id(s.stiffness), id(s.damping)) for name, s in model.springs.items()))
    timing = (rate, robot.rates.control, robot.file.sensing_delay, scheme, width)
    ground = robot.contacts, robot.ground
    return id(robot.model), ground, joints, effects, springs, control, timing, tuple(free)


def _words(law: Any) -> Any:
    """What of a law is not numbers: its kind, switches, and which joints the parts of a `Mixed` one drive."""
    if isinstance(law, Mixed):
        return tuple((places, _words(part)) for places, part in law.parts)
    numbers = numbers_of(law)
    words = tuple((f.name, getattr(law, f.name)) for f in fields(law) if f.name not in numbers)
    return type(law), words
