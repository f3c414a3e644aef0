"""Shafts that turn with the motors of several joints: coupled drives.

With motor positions theta seen at the joints, a shaft turns by m = sum_j n_j theta_j. Its torque T acts on
every joint by the same number, n_j T, because the power T dm/dt = sum_j (n_j T) dtheta_j is the same on both
sides (virtual work; Siciliano et al. 2009, section 5.1, on transmissions). So a shaft's inertia B and damping
D_m are n B n' and n D_m n' at the joints, and its friction acts there as n f(n dtheta).

A motor whose robot file states a coupling is such a shaft, with its row of the coupling's matrix; so is what
an effect acts on that turns with a neighbour, too. Joints that shafts tie together are a `Group`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.effects import Signals
from flexjoint.model.joint import JointFlow

KINEMATIC = ("q", "dq", "theta", "dtheta", "phi", "dphi")
TORQUES = ("tau_t", "tau_m")


@dataclass(frozen=True, eq=False)
class Shaft:
    """What turns by `turns[j]` for a turn of joint j's motor, and carries the laws of `flow`.

    A motor's own shaft has the joint's command and drive numbers: its torque is the sum of `takes[j]` times
    that of joint j. Another one (`takes` empty) has neither inertia nor command, and sees the torques of its
    joint."""

    joint: int
    turns: Mapping[int, Value]
    takes: Mapping[int, float]
    flow: JointFlow

    @property
    def B(self) -> Value:
        return self.flow.drive.B if self.takes else 0.0

    @property
    def D_m(self) -> Value:
        return self.flow.drive.D_m if self.takes else 0.0

    def share(self, joint: int) -> Value:
        return self.turns.get(joint, 0.0)

    def turned(self, by_joint: Mapping[int, Value]) -> Value:
        """The shaft's position, velocity or acceleration from those of the motors."""
        return sum((share * by_joint[j] for j, share in self.turns.items()), 0.0)

    def torque(self, by_joint: Mapping[int, Value]) -> Value:
        """The shaft's torque from those at the joints."""
        if not self.takes:
            return by_joint[self.joint]
        return sum((share * by_joint[j] for j, share in self.takes.items()), 0.0)

    def signals(self, of: Mapping[int, Signals]) -> Signals:
        """What the laws of the shaft see, from the signals of its group's joints."""
        own = of[self.joint]
        values = {field.name: getattr(own, field.name) for field in fields(Signals)}
        for name in KINEMATIC:
            values[name] = self.turned({j: getattr(of[j], name) for j in self.turns})
        for name in TORQUES if self.takes else ():
            values[name] = self.torque({j: getattr(of[j], name) for j in self.takes})
        return Signals(**values)


@dataclass(frozen=True, eq=False)
class Group:
    """Joints, all rigid or all flexible, that shafts tie together."""

    joints: tuple[int, ...]
    shafts: tuple[Shaft, ...]
    rigid: bool

    def at_joints(self, torques: Sequence[Value]) -> dict[int, Value]:
        """Torques at the joints from those of the shafts."""
        return {
            j: sum((shaft.share(j) * T for shaft, T in zip(self.shafts, torques, strict=True)), 0.0)
            for j in self.joints
        }

    def matrix(self, numbers: Sequence[Value]) -> list[list[Value]]:
        """sum_k n_k x_k n_k' at the joints, of a number x_k of each shaft (an inertia, a damping)."""
        pairs = list(zip(self.shafts, numbers, strict=True))
        return [
            [sum((s.share(i) * x * s.share(j) for s, x in pairs), 0.0) for j in self.joints]
            for i in self.joints
        ]

    @property
    def inertia(self) -> list[list[Value]]:
        return self.matrix([shaft.B for shaft in self.shafts])


class Tie:
    """Inertias between joints, which no articulated-body algorithm with an armature per joint takes.

    (M + A + E)^-1 tau by the Woodbury identity, E being `blocks` at the places of the groups: a = a0 - C f,
    f = E (1 + C_pp E)^-1 a0_p with the responses C = (M + A)^-1 of those places (Hager 1989).
    """

    def __init__(
        self,
        accelerate: Callable[[Value], Value],
        blocks: Sequence[tuple[Sequence[int], Sequence[Sequence[Value]]]],
        size: int,
        symbolic: bool,
    ) -> None:
        """`accelerate` gives the accelerations (size,) without E under joint forces (size,); each block is
        the places of a group's joints, and E there with zeros on its diagonal."""
        self._accelerate, self._symbolic = accelerate, symbolic
        self._places = [place for places, _ in blocks for place in places]
        count = len(self._places)
        extra: list[list[Value]] = [[0.0] * count for _ in range(count)]
        begin = 0
        for places, block in blocks:
            for i in range(len(places)):
                for j in range(len(places)):
                    extra[begin + i][begin + j] = block[i][j] if i != j else 0.0
            begin += len(places)
        none = ops.zeros(size, symbolic)
        still = accelerate(none)
        self._columns = []
        for place in self._places:
            unit = ops.zeros(size, symbolic)
            unit[place] = 1.0
            self._columns.append(accelerate(unit) - still)
        E = ops.matrix(extra, symbolic)
        C = ops.matrix([[column[p] for column in self._columns] for p in self._places], symbolic)
        one = ops.matrix([[float(i == j) for j in range(count)] for i in range(count)], symbolic)
        self._forces = E @ ops.solve(one + C @ E, one)

    def __call__(self, tau: Value) -> Value:
        """Accelerations under the joint forces tau."""
        acc = self._accelerate(tau)
        force = self._forces @ ops.vector((acc[place] for place in self._places), self._symbolic)
        for k, column in enumerate(self._columns):
            acc = acc - column * force[k]
        return acc


def joined(some: Iterable[Iterable[int]]) -> list[set[int]]:
    """Sets of joints, those that share one joined, in the order of their first joints."""
    out: list[set[int]] = []
    for joints in some:
        own = set(joints)
        for other in [x for x in out if x & own]:
            out.remove(other)
            own |= other
        out.append(own)
    return sorted(out, key=min)
