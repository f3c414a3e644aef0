"""The motor and gear have an inertia, and the model gives them none."""

from dataclasses import replace
from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Site, Typical
from flexjoint.effects._sources import TX40


class RotorInertia(Effect):
    """Inertia of the rotor and gear, link-referred, of a rigid joint to whose motor the model gives none: a
    URDF has none.

    Where the model has one, `motor_inertia` says by how much it is wrong."""

    site, against, reference = Site.MOTOR, "tau_m", "Spong 1987 (motor equation)"
    ordinary = True
    law = r"B + J"
    params = (Parameter("inertia", "kg m^2", "J", value=0.1, low=0.0, high=1e4),)
    typical = (Typical("0.010 to 0.36 kg m^2 at six joints", TX40),)

    def possible(self, drive: Drive) -> bool:
        return drive.B == 0.0

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return replace(drive, B=drive.B + p.inertia)
