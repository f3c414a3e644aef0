"""The spring damps more or less than the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class SpringDamping(Effect):
    """The spring damps more or less than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "dphi", "De Luca and Book 2016"
    law = r"(1 + e)\,D"
    # by a factor of twenty: hardly any data sheet has it, and it is a guess in most models
    params = (Parameter("scale", "1", "e", value=0.2, low=-1.0, high=19.0),)
    needs_spring = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(D=1.0 + p.scale)
