"""Which joints move together, by shafts that several of them turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flexjoint.effects import Planned, Site
from flexjoint.model.shafts import joined
from flexjoint.robot.robot import Robot


@dataclass(frozen=True)
class Turning:
    """A shaft: turns of it for a turn of each joint, its torque by those of the joints (empty: it has none of
    its own, and sees those of its joint), and the effects on it."""

    joint: int
    turns: Mapping[int, float]
    takes: Mapping[int, float]
    laws: tuple[Planned, ...]

    @property
    def projection(self) -> dict[int, float]:
        """The shaft's torque from those at the joints, of one without own ones by least squares."""
        size = sum(n**2 for n in self.turns.values())
        return dict(self.takes) or {j: n / size for j, n in self.turns.items()}


class Ties:
    """Which joints move together by the robot file's couplings, and by effects."""

    def __init__(self, robot: Robot) -> None:
        self._names = robot.joint_names
        self.coupled: dict[int, tuple[dict[int, float], dict[int, float]]] = {}
        self._stated = [coupling.joints for coupling in robot.couplings]
        for coupling in robot.couplings:
            for r, i in enumerate(coupling.joints):
                takes = dict(zip(coupling.joints, coupling.inverse[:, r].tolist(), strict=True))
                self.coupled[i] = dict(zip(coupling.joints, coupling.matrix[r], strict=True)), takes

    def turns(self, i: int) -> dict[int, float]:
        """By how much the motor of joint i turns for a turn of each joint that moves it."""
        stated = self.coupled[i][0] if i in self.coupled else {i: 1.0}
        return {j: n for j, n in stated.items() if n != 0.0}

    def on_shaft(self, e: Planned) -> bool:
        """Whether an effect acts on a shaft, and not on its joint alone."""
        if e.joint is None or e.effect.site not in (Site.MOTOR, Site.COMMAND):
            return False
        return e.effect.reaches_before or self._names.index(e.joint) in self.coupled

    def mates(self, effects: Sequence[Planned]) -> dict[int, frozenset[int]]:
        """By joint, those that are tied to it; joints without are left out. An effect on the first joint has
        no joint before it, and ties none."""
        reached = [self._names.index(str(e.joint)) for e in effects if e.effect.reaches_before]
        groups = joined([*self._stated, *((i - 1, i) for i in reached if i > 0)])
        return {i: frozenset(some) for some in groups for i in some}

    def shafts(self, joints: frozenset[int], effects: Sequence[Planned]) -> list[Turning]:
        """The shafts of a group of joints."""
        out = []
        for i in sorted(joints & set(self.coupled)):
            own = tuple(e for e in effects if e.joint == self._names[i] and self.on_shaft(e))
            out.append(Turning(i, *self.coupled[i], tuple(e for e in own if not e.effect.reaches_before)))
        for e in effects:
            if e.effect.reaches_before and e.joint is not None and (i := self._names.index(e.joint)) > 0:
                share, before = e.effect.shares(e.p)
                out.append(Turning(i, {i: float(share), i - 1: float(before)}, {}, (e,)))
        return out
