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
        self._rigid = [joint.rigid for joint in robot.joints]
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

    def _pair(self, e: Planned) -> tuple[int, int] | None:
        """The joint of an effect that acts on the one before as well, and that one. None where there is none,
        or where one is rigid and the other not, which no model has: there it acts on nothing."""
        if not e.effect.reaches_before or e.joint is None:
            return None
        i = self._names.index(e.joint)
        return (i, i - 1) if i > 0 and self._rigid[i] == self._rigid[i - 1] else None

    def mates(self, effects: Sequence[Planned]) -> dict[int, frozenset[int]]:
        """By joint, those that are tied to it; joints without are left out."""
        pairs = [pair for e in effects if (pair := self._pair(e)) is not None]
        return {i: frozenset(some) for some in joined([*self._stated, *pairs]) for i in some}

    def shafts(self, joints: frozenset[int], effects: Sequence[Planned]) -> list[Turning]:
        """The shafts of a group of joints. Dead times of coupled motors are not modelled, and do nothing."""
        out = []
        for i in sorted(joints & set(self.coupled)):
            own = [e for e in effects if e.joint == self._names[i] and self.on_shaft(e)]
            laws = tuple(e for e in own if not (e.effect.reaches_before or e.effect.overrides("delay")))
            out.append(Turning(i, *self.coupled[i], laws))
        for e in effects:
            if (pair := self._pair(e)) is not None:
                for part in e.parts:
                    share, before = part.effect.shares(part.p)
                    out.append(Turning(pair[0], {pair[0]: float(share), pair[1]: float(before)}, {}, (part,)))
        return out
