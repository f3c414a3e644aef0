"""Friction of the two motors of a differential."""

from collections.abc import Mapping
from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site
from flexjoint.effects.coupled_friction import CoupledFriction

SHAFT = CoupledFriction()


class DifferentialFriction(Effect):
    """Friction of the two motors of a differential, of which one turns with the sum and one with the
    difference of this joint and the one before it: each acts on both joints, and it sticks.

    Such are wrists that two motors bend together and turn against each other. Each motor has the law of
    coupled_friction. Before is in the robot's order of joints. Other ratios are stated in the robot file,
    under `couplings`."""

    site, against = Site.MOTOR, "dtheta"
    reference = "Siciliano et al. 2009, section 5.1 (transmissions)"
    law = (
        r"f_\pm = \tau_\pm \operatorname{sgn} w_\pm + d_\pm w_\pm,\ w_\pm = \dot\theta \pm"
        r" \dot\theta_\mathrm{before}:\ f_+ + f_-,\ \mathrm{and}\ f_+ - f_-\ \mathrm{on\ the\ joint\ before}"
    )
    params = (
        Parameter("level_sum", "N m", r"\tau_+", value=0.2, low=0.0, high=1e4),
        Parameter("coefficient_sum", "N m s/rad", "d_+", value=0.1, low=0.0, high=1e5),
        Parameter("level_difference", "N m", r"\tau_-", value=0.2, low=0.0, high=1e4),
        Parameter("coefficient_difference", "N m s/rad", "d_-", value=0.1, low=0.0, high=1e5),
    )
    contains = ("coupled_friction",)

    def shafts(self, p: Any) -> tuple[tuple[Effect, Mapping[str, Any]], ...]:
        return (
            (SHAFT, {"level": p.level_sum, "coefficient": p.coefficient_sum, "speed": "sum"}),
            (
                SHAFT,
                {"level": p.level_difference, "coefficient": p.coefficient_difference, "speed": "difference"},
            ),
        )

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        """What both hold at this joint, at most."""
        return p.level_sum + p.level_difference
