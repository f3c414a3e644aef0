"""The sets with another effect in the place of one of the chosen ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

from flexjoint.diagnosis.regression.fit import Fit, fit_tried, held_beside, refit_without
from flexjoint.diagnosis.search.criteria import score
from flexjoint.effects import Planned

Key = tuple[str, str | None]  # of an effect on a joint


@dataclass(frozen=True)
class Rival:
    """What takes an effect's place, with its own numbers of the effects beside it, and the keys of those
    that it makes unnecessary."""

    effects: tuple[Planned, ...]  # itself last
    less: frozenset[Key]

    @property
    def key(self) -> Key:
        return self.effects[-1].key


@dataclass(frozen=True)
class Rivals(Sequence[Fit]):
    """The rivals of an effect in a set, fitted beside that set when one of them is first looked at: while a
    set still changes none is. The best comes first."""

    best: Fit
    replaced: Key
    every: tuple[Rival, ...]

    @staticmethod
    def of(best: Fit, replaced: Key, sets: Sequence[Sequence[Planned]]) -> Rivals:
        """Sets that are known beside a set: each ends with what takes the place of the effect."""
        had = {e.key for e in best.effects} - {replaced}
        every = (Rival(tuple(one), frozenset(had - {e.key for e in one})) for one in sets)
        return Rivals(best, replaced, tuple(one for one in every if one.key not in had))

    @staticmethod
    def known(best: Fit, replaced: Key, fits: Sequence[Fit]) -> Rivals:
        """Fits beside a set."""
        return fits if isinstance(fits, Rivals) else Rivals.of(best, replaced, [f.effects for f in fits])

    @property
    def sets(self) -> tuple[tuple[Planned, ...], ...]:
        return tuple(one.effects for one in self.every)

    def beside(self, best: Fit) -> Rivals:
        """Those of the effect in another set, without what that set has gained or lost."""
        gone = {e.key for e in self.best.effects} - {e.key for e in best.effects}
        taken = {e.key for e in best.effects} | gone
        return Rivals(best, self.replaced, tuple(one for one in self.every if one.key not in taken))

    @cached_property
    def fits(self) -> tuple[Fit, ...]:
        if not self.every:
            return ()
        effect = next(e for e in self.best.effects if e.key == self.replaced)
        without = refit_without(self.best, effect)
        return tuple(sorted((_fitted(without, one) for one in self.every), key=score))

    def __len__(self) -> int:
        return len(self.every)

    @overload
    def __getitem__(self, k: int) -> Fit: ...
    @overload
    def __getitem__(self, k: slice) -> tuple[Fit, ...]: ...
    def __getitem__(self, k: int | slice) -> Fit | tuple[Fit, ...]:
        return self.fits[k]


def _fitted(without: Fit, rival: Rival) -> Fit:
    """A rival beside a set without the effect whose place it takes; what acts within other joints is held."""
    added, own = rival.effects[-1], {e.key: e for e in rival.effects}
    held = {e.key for e in held_beside(without.effects, added)}
    beside = [e if e.key in held else own.get(e.key, e) for e in without.effects if e.key not in rival.less]
    return fit_tried(without.problem, [*beside, added], added)
