"""The spring is stiffer or softer than the model says."""

from typing import Any

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import Drive, Effect, Kind, Site, Source, Typical


class SpringStiffness(Effect):
    """The spring is stiffer or softer than the model says."""

    site, kind, against, reference = Site.SPRING, Kind.PARAMETER, "phi", "Spong 1987 (elastic joint)"
    law = r"(1 + e)\,K"
    # by a factor of five: within a gear's data sheet it differs by three between small and large loads, and
    # bearings and brackets in series make it softer
    params = (Parameter("scale", "1", "e", value=0.1, low=-0.8, high=4.0),)
    needs_spring = True
    typical = (
        Typical(
            "28 % more than in the data sheet (WMBig10k_ds.m): a torsion bar of 12.8 kN m/rad, not 10",
            Source(
                "Compliant Joint Toolbox, WALK-MAN drive, partly identified",
                "https://github.com/geez0x1/CompliantJointToolbox/blob/"
                "031e2eda2b77de77373365361c878e9a81641664/param/WMBig10k.m",
            ),
        ),
        Typical(
            "5.65 % off its simulation by finite elements: a spring of 2155 N m/rad",
            Source(
                "Tregear, a series elastic actuator",
                "https://github.com/ITregear/SeriesElasticActuation-FYP/blob/"
                "755c1e114d54d8e1cf42c14be600988c6c4e1db0/README.md",
            ),
        ),
    )

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(K=1.0 + p.scale)
