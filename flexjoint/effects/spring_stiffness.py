"""The spring is stiffer or softer than the model says."""

from typing import Any

from flexjoint.effect import Drive, Effect, Kind, Param, Site


class SpringStiffness(Effect):
    """The spring is stiffer or softer than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "phi", "Spong 1987 (elastic joint)"
    law = r"(1 + e)\,K"
    params = (Param("scale", "1", "e", 0.1, -0.99, 1e5),)
    needs_spring = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(K=1.0 + p.scale)
