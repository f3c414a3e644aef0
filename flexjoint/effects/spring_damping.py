"""The spring damps more or less than the model says."""

from typing import Any

from flexjoint.effect import Drive, Effect, Kind, Param, Site


class SpringDamping(Effect):
    """The spring damps more or less than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "dphi", "De Luca and Book 2016"
    law = r"(1 + e)\,D"
    params = (Param("scale", "1", "e", 0.2, -1.0, 1e5),)
    needs_spring = True

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(D=1.0 + p.scale)
