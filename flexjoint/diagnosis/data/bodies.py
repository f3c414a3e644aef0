"""Bodies of the description that cannot exist: a negative mass or inertia, or one in other units."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from flexjoint.diagnosis.data.torques.rivals import reach
from flexjoint.diagnosis.result.values import DataFinding
from flexjoint.diagnosis.settings import DataSettings
from flexjoint.robot.robot import Robot

ROUNDING = 1e-6  # of the largest principal moment, below which a negative one is rounding


def impossible(robot: Robot, settings: DataSettings) -> Iterator[DataFinding]:
    """Moving bodies that no matter could be."""
    longest = reach(robot)
    for name, inertia in zip(list(robot.model.names)[1:], list(robot.model.inertias)[1:], strict=True):
        mass = float(inertia.mass)
        moments = np.linalg.eigvalsh(np.array(inertia.inertia))  # about its centre of mass
        reason = ""
        if mass < 0.0:
            reason = f"has a mass of {mass:.4g} kg"
        elif moments[0] < -ROUNDING * max(abs(moments[-1]), 1e-12):
            reason = f"has a principal moment of inertia of {moments[0]:.4g} kg m^2"
        elif mass > 0.0 and longest > 0.0:
            radius = math.sqrt(max(float(moments[-1]), 0.0) / mass)
            if radius > settings.gyration * longest:
                reason = (
                    f"has an inertia of {moments[-1]:.4g} kg m^2 at a mass of {mass:.4g} kg, as if it were"
                    f" {radius:.3g} m wide; inertias are in kg m^2, not in kg mm^2 or g mm^2"
                )
        if reason:
            text = f"the body that {name} moves cannot exist: it {reason}"
            yield DataFinding(
                "impossible_body", name, text, robot_file=f"correct the description's inertial of {name}"
            )
