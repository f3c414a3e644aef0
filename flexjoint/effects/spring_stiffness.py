"""The spring is stiffer or softer than the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site


class SpringStiffness(Effect):
    """The spring is stiffer or softer than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "phi", "Spong 1987 (elastic joint)"
    law = r"(1 + e)\,K"
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.99, high=1e5),)
    needs_spring = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(K=1.0 + p.scale)
