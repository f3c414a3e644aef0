"""Springs whose stiffness and damping are commanded: variable-impedance actuators.

The transmission torque is K(t) phi + D(t) dphi. Turning K up while the spring is deflected does work on it:
its energy K phi^2 / 2 changes by K'(t) phi^2 / 2 per second on top of what its ends do (Vanderborght et al.
2013, section 2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexjoint.core.ops import Value

Signal = Callable[[Value], Value]


@dataclass(frozen=True)
class VariableSpring:
    """Stiffness [N m/rad] and damping [N m s/rad] as functions of the time t [s]; without `damping` it stays
    the joint's. On CasADi models t is an expression: write the functions with `flexjoint.core.ops`. What is
    worked out ahead of a motion takes one value: the static law that at t = 0, the estimate of stability that
    at the start."""

    stiffness: Signal
    damping: Signal | None = None
