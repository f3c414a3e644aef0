"""Effects at work on joints, and the catalogue of all effects by name."""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Site


@dataclass(frozen=True)
class Planned:
    """An effect at work on a joint: what a robot's YAML lists under `effects`.

    `since` [s] is the time at which it sets in (None: always on), `switches` [s] are the times after that at
    which it ceases, acts again, ceases, and so on; one that acts from the start and ceases later has set in
    at -inf. `nominal` marks what the nominal model already claims. `std` holds the standard errors of fitted
    parameters.
    """

    effect: Effect
    joint: str | None
    values: Mapping[str, Any]
    since: float | None = None
    nominal: bool = False
    std: Mapping[str, Any] = field(default_factory=dict)
    switches: tuple[float, ...] = ()

    @property
    def key(self) -> tuple[str, str | None]:
        return self.effect.name, self.joint

    @cached_property
    def identity(self) -> tuple[object, ...]:
        """What makes two planned effects the same to a law."""
        values = tuple(tuple(v) if isinstance(v, (list, tuple)) else v for v in self.values.values())
        return self.effect.name, self.joint, tuple(self.values), values, self.since, self.switches

    @property
    def changes(self) -> tuple[float, ...]:
        """The times [s] at which it sets in, ceases, and so on, as far as they are within a recording."""
        return tuple(t for t in (self.since, *self.switches) if t is not None and math.isfinite(t))

    def acts(self, t: Any) -> Any:
        """Whether it is at work at times t [s], a number or an array."""
        if self.since is None:
            return np.full(np.shape(t), True)[()]
        return np.searchsorted((self.since, *self.switches), t, side="right") % 2 == 1

    @property
    def during(self) -> tuple[tuple[float, float], ...]:
        """The spans [s] in which it acts; from -inf where it acts from the start, to inf where it goes on."""
        begin = -math.inf if self.since is None else self.since
        times = (begin, *self.switches, *(() if len(self.switches) % 2 else (math.inf,)))
        return tuple(zip(times[::2], times[1::2], strict=True))

    @cached_property
    def place(self) -> tuple[object, ...]:
        """Where signals meet it (`signal_order`)."""
        law = self.effect
        play = law.site is Site.DEFLECTION and law.overrides("slope") and law.is_cause
        same = repr(self.identity)  # one effect on two channels, or on two joints
        return list(Site).index(law.site), not law.overrides("delay"), play, law.name, same

    @property
    def parts(self) -> tuple[Planned, ...]:
        """The effects on shafts of their own of which it is made; itself where it is one."""
        made_of = self.effect.shafts(self.p)
        return tuple(replace(self, effect=law, values=values) for law, values in made_of) or (self,)

    def special_cases(self, name: str) -> tuple[Planned, ...]:
        """An effect that its law `contains`, with the numbers that both have; of one made of others, each of
        these."""
        parts = [dict(part.values) for part in self.parts if part.effect.name == name]
        common = {p.name: self.values[p.name] for p in find(name).params if p.name in self.values}
        simple = [Planned.of(name, self.joint, values) for values in parts or [common]]
        return tuple(replace(one, since=self.since, switches=self.switches) for one in simple)

    @property
    def p(self) -> Any:
        """The parameters as the laws take them."""
        return self.effect.parameters(self.values)

    @classmethod
    def of(
        cls,
        name: str,
        joint: str | None,
        values: Mapping[str, Any],
        *,
        since: float | None = None,
        switches: Sequence[float] = (),
        nominal: bool = False,
    ) -> Planned:
        """An effect on a joint from a mapping of parameters, checked: names, shapes, finite numbers, bounds.

        Raises UnknownNameError or ModelError; `effect` is the same with parameters as keywords.
        """
        law = find(name)
        if law.whole_robot and joint is not None:
            raise ModelError(f"{name} acts on the whole robot: leave its joint empty (got {joint!r})")
        if not law.whole_robot and joint is None:
            raise ModelError(f"{name} acts on a joint: name one")
        record = law.parameters(values)
        for param in law.params:
            given = getattr(record, param.name)
            numbers = given if param.size > 1 else (given,)
            if not isinstance(numbers, Sequence) or len(numbers) != param.size:
                raise ModelError(f"{name}.{param.name}: expected {param.size} numbers, got {given!r}")
            for number in numbers:
                param.checked(number, f"{name}.{param.name}")
        times = tuple(float(t) for t in switches)
        begin = -math.inf if since is None else since
        if any(not math.isfinite(t) for t in times) or any(a >= b for a, b in pairwise((begin, *times))):
            raise ModelError(f"{name}: expected switches at increasing times after `since`, got {times}")
        if times and since is None:
            since = begin
        return cls(law, joint, dict(record._asdict()), since, nominal, switches=times)

    def with_values(self, values: Mapping[str, Any]) -> Planned:
        return replace(self, values={**self.values, **values})

    def __str__(self) -> str:
        return f"{self.effect.name} on {self.joint}" if self.joint else self.effect.name


def signal_order(effects: Iterable[Planned]) -> tuple[Planned, ...]:
    """The effects in the order in which signals meet them, whatever order they are listed or found in.

    Sites come in the order of `Site`. At one site a dead time comes first (what follows acts on the late
    signal), then effects by name; among deflections a play comes last, because the error of the gear that
    takes it up comes before it. The simulator and the diagnosis both evaluate effects in this order."""
    return tuple(sorted(effects, key=lambda e: e.place))


@cache
def catalogue() -> Mapping[str, Effect]:
    """Every effect by name, in alphabetical order: one per file in `flexjoint/effects/`."""
    package = importlib.import_module("flexjoint.effects")
    found: dict[str, Effect] = {}
    for module_info in sorted(pkgutil.iter_modules(package.__path__), key=lambda m: m.name):
        if module_info.name.startswith("_"):
            continue
        module = importlib.import_module(f"flexjoint.effects.{module_info.name}")
        for item in vars(module).values():
            if isinstance(item, type) and issubclass(item, Effect) and item.__module__ == module.__name__:
                effect = item()
                if effect.name != module_info.name:
                    raise ModelError(
                        f"effects/{module_info.name}.py defines {effect.name}; name the file after it"
                    )
                found[effect.name] = effect
    return found


def find(name: str) -> Effect:
    """The effect of that name; UnknownNameError lists the valid ones."""
    effects = catalogue()
    if name not in effects:
        raise unknown("effect", name, effects)
    return effects[name]


def numbers_beyond(effect: Effect, simple: str) -> list[Parameter]:
    """Sizes by which an effect goes beyond one that it `contains`; none where it has others instead."""
    own, known = {p.name for p in effect.params}, {p.name for p in find(simple).params}
    return [p for p in effect.nulls if p.name not in known] if known < own else []


def effect(
    name: str,
    joint: str | None = None,
    *,
    since: float | None = None,
    switches: Sequence[float] = (),
    nominal: bool = False,
    **parameters: Any,
) -> Planned:
    """An effect on a joint: `effect("backlash", "elbow", gap=2e-3)`.

    Args:
        name: of the effect (docs/reference/effects.md).
        joint: the joint it acts on; None for an effect of the whole robot.
        since: time in a recording at which it sets in [s]; None: from the start.
        switches: times after that at which it ceases, acts again, ceases, and so on [s]; none: it goes on.
        nominal: whether the nominal model already claims it.
        parameters: the effect's own, in SI units; those not given take their default.

    Raises:
        UnknownNameError: the name or a parameter does not exist; the message lists those that do.
        ModelError: a number is out of its bounds or of the wrong shape, the joint is missing, or the switches
            do not increase.
    """
    return Planned.of(name, joint, parameters, since=since, switches=switches, nominal=nominal)
