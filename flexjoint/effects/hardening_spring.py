"""The spring stiffens as it deflects."""

from typing import Any

from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Effect, Signals, Site, Typical
from flexjoint.effects._sources import HARMONIC_DRIVE


class HardeningSpring(Effect):
    """The spring stiffens as it deflects."""

    site, against, reference = Site.SPRING, "phi", "Tuttle and Seering 1996 (cubic stiffness)"
    typical = (Typical("1.5 to 2.1 times as stiff under a large torque as near none", HARMONIC_DRIVE),)
    law = r"+\,k_3 \phi^3"
    params = (Parameter("cubic", "N m/rad^3", "k_3", value=1e4, low=0.0, high=1e13),)
    needs_spring = True

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return p.cubic * s.phi * s.phi * s.phi

    def slope(self, s: Signals, p: Any) -> Value:
        return 3.0 * p.cubic * s.phi * s.phi
