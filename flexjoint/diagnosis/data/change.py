"""A way in which columns may be wrong: what has to be done to them so that they are what they say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

Key = tuple[str, str]  # channel and joint


@dataclass(frozen=True)
class Source:
    """The right values of a joint's columns: scale times those of a joint, plus an offset of positions."""

    joint: str
    scale: float = 1.0
    shift: float = 0.0  # rad or m


def _empty() -> Mapping[Any, Any]:
    return MappingProxyType({})


@dataclass(frozen=True)
class Change:
    """One error of the data, and what it takes to undo it.

    `positions` by joint, `torques` by (channel, joint): where the right values are of what is not right as it
    is. `gravity` in the base frame [m/s^2], where the robot file's is wrong.
    """

    error: str
    joints: tuple[str, ...]
    positions: Mapping[str, Source] = field(default_factory=_empty)
    torques: Mapping[Key, Source] = field(default_factory=_empty)
    gravity: tuple[float, float, float] | None = None
    said: str = ""  # what is known of it beyond its kind


@dataclass(frozen=True)
class View:
    """The data with several changes made, one after the other."""

    positions: Mapping[str, Source] = field(default_factory=_empty)
    torques: Mapping[Key, Source] = field(default_factory=_empty)
    gravity: tuple[float, float, float] | None = None

    @classmethod
    def of(cls, changes: Iterable[Change]) -> View:
        view = cls()
        for change in changes:
            view = view.after(change)
        return view

    def after(self, change: Change) -> View:
        """The data with one more change made."""
        positions, torques = dict(self.positions), dict(self.torques)
        for joint, new in change.positions.items():
            old = self.positions.get(new.joint, Source(new.joint))
            positions[joint] = Source(old.joint, new.scale * old.scale, new.scale * old.shift + new.shift)
        for (channel, joint), new in change.torques.items():
            old = self.torques.get((channel, new.joint), Source(new.joint))
            torques[channel, joint] = Source(old.joint, new.scale * old.scale)
        return View(positions, torques, change.gravity or self.gravity)

    @property
    def motion(self) -> tuple[Any, ...]:
        """What the torques that the motion takes depend on, as a key."""
        moved = sorted((joint, s.joint, s.scale, s.shift) for joint, s in self.positions.items())
        return (*moved, self.gravity)
