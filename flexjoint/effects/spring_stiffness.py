"""The spring is stiffer or softer than the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class SpringStiffness(Effect):
    """The spring is stiffer or softer than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "phi", "Spong 1987 (elastic joint)"
    law = r"(1 + e)\,K"
    # by a factor of five: within a gear's data sheet it differs by three between small and large loads, and
    # bearings and brackets in series make it softer
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.8, high=4.0),)
    needs_spring = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(K=1.0 + p.scale)
