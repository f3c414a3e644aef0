"""Whether a mass and an inertia can be those of a body.

Descriptions that are in use hold inertias that no body has: rounded ones, and some from CAD in which the axes
were mixed up. So only what makes every motion meaningless is refused, the rest is named.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.core.errors import RobotError

ROUNDED = 0.01  # share of an inertia by which printed digits may miss what a body has
SLIGHT = 1e-5  # kg m^2, below which no motion of a robot shows it
NAMED = 3  # bodies in a warning; more are counted


def unlike_a_body(mass: float, inertia: np.ndarray, where: str) -> bool:
    """Whether an inertia (3, 3) [kg m^2] about the centre of mass is one that no body has.

    Raises RobotError for a negative mass [kg], and for principal moments that are all negative.
    """
    if mass < 0.0:
        raise RobotError(f"{where}: mass {mass:g} kg is negative; give what the body weighs")
    low, middle, high = (float(x) for x in np.linalg.eigvalsh(inertia))
    if low + middle + high < -SLIGHT:
        raise RobotError(
            f"{where}: its inertia is negative (principal moments {low:g}, {middle:g}, {high:g})"
        )
    if high < SLIGHT:
        return False
    # a principal moment is at most the sum of the two others
    return bool(low < -ROUNDED * high or high > (1.0 + ROUNDED) * (low + middle) + 1e-15)


def warning_of(bodies: Sequence[str], where: str) -> str:
    """The line that names the bodies whose inertia no body has."""
    named = ", ".join(bodies[:NAMED]) + (f" and {len(bodies) - NAMED} more" if len(bodies) > NAMED else "")
    return (
        f"{where}: no body has the inertia of {named} (a principal moment is negative, or more than the"
        " sum of the others); it is simulated as it stands"
    )
