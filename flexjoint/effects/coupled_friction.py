"""Friction of a motor that turns with two joints."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical, Word
from flexjoint.effects._sources import TX40


class CoupledFriction(Effect):
    """Friction of a shaft that turns with the sum, or the difference, of this joint and the one before it: it
    acts on both, and it sticks.

    So does the motor of a wrist whose drive runs through the joint before it, of a differential, and of an
    elbow whose belt comes from the base. Before is in the robot's order of joints. Other ratios are stated in
    the robot file, under `couplings`."""

    site, against = Site.MOTOR, "dtheta"
    reference = "Siciliano et al. 2009, section 5.1 (transmissions); Gautier and Janot, TX40 (joints 5 and 6)"
    law = (
        r"\tau_c \operatorname{sgn} w + d\,w,\ w = \dot\theta \pm \dot\theta_\mathrm{before},\ "
        r"\mathrm{and}\ \pm\ \mathrm{this\ on\ the\ joint\ before}"
    )
    params = (
        Parameter("level", "N m", r"\tau_c", value=0.2, low=0.0, high=1e4),
        Parameter("coefficient", "N m s/rad", "d", value=0.1, low=0.0, high=1e5),
    )
    words = (Word("speed", ("sum", "difference"), "sum"),)
    known_as = ("motor_coulomb_friction",)  # of a motor whose coupling the robot file states
    typical = (Typical("1.95 N m and 0.62 N m s/rad of the motor that joints 5 and 6 share", TX40),)

    def shares(self, p: Any) -> tuple[Value, Value]:
        return 1.0, 1.0 if p.speed == "sum" else -1.0

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        return p.level

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return -p.coefficient * s.dtheta
