"""Units as they are printed; numbers are SI and are never converted."""

from __future__ import annotations


def of_joint(unit: str, prismatic: bool) -> str:
    """The unit of a number of a joint, given that of a revolute one.

    A prismatic joint has m for rad, N for N m and kg for kg m^2: "N m s/rad" becomes "N s/m".
    """
    if not prismatic:
        return unit
    return unit.replace("N m", "N").replace("kg m^2", "kg").replace("rad", "m")
