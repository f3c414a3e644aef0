"""Dry friction as a set: the forces, each within its level, that stop what they can stop."""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.core import ops
from flexjoint.core.ops import Value

SWEEPS = 50  # of Gauss-Seidel over link frictions; each shrinks the error by the coupling through M^-1
TINY = 1e-12  # [rad/s] carries the direction of a velocity of 0


def friction_forces(
    free: Sequence[Value],
    levels: Sequence[Value],
    coupling: Sequence[Sequence[Value]],
    sweeps: int,
    symbolic: bool,
) -> list[Value]:
    """Forces f with |f_j| <= level_j, and f_j = level_j sgn v_j where the velocity v = free - coupling f is
    not 0: projected Gauss-Seidel (Moreau 1988; Jean 1999).

    Args:
        free: velocities without friction [rad/s].
        levels: bounds of the forces [N m].
        coupling: coupling[j][k] is the change of velocity j by a unit of force k.
        sweeps: the largest number of sweeps; expressions get them all, numbers stop when no force changes.
    """
    count = range(len(free))
    force: list[Value] = [0.0 for _ in count]
    for _ in range(sweeps):
        moved = 0.0
        for j in count:
            left = free[j] - sum(coupling[j][k] * force[k] for k in count)
            before = force[j]
            force[j] = ops.clip(before + left / coupling[j][j], -levels[j], levels[j])
            moved = moved if symbolic else max(moved, abs(force[j] - before) / (levels[j] + TINY))
        if not symbolic and moved < TINY:
            break
    return force


def directed(size: Value, direction: Value) -> Value:
    """|size|, at least TINY, with the sign of direction: dry friction resists the motion to come."""
    size = ops.maximum(ops.absolute(size), TINY)
    return ops.where(direction < 0.0, -size, size)


def rubbed(start: Value, midpoint: Value, free: Value, shed: Value, h: float) -> tuple[Value, Value]:
    """Velocity and acceleration at the end of a step with dry friction, from the velocities at its start
    and midpoint and the accelerations without friction and by its level alone.

    A motion that comes to rest within the step stays there, or turns and goes on for what is left of it:
    the midpoint rule alone would ring about rest for ever.
    """
    side = ops.where(start < 0.0, -1.0, 1.0)
    braking = shed - side * free
    onward = ops.maximum(-side * free - shed, 0.0)
    speed = ops.absolute(start)
    rests = ops.both(speed > 0.0, speed < h * braking)
    left = h - speed / ops.maximum(braking, TINY)
    end = ops.where(rests, -side * onward * left, 2.0 * midpoint - start)
    return end, ops.where(rests, -side * onward, (midpoint - start) / (0.5 * h))
