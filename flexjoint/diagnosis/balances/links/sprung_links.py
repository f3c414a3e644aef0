"""Links without encoder of which their spring's torque tells: what an error of its balance moves them by.

The angle of such a link is the motor's less the deflection that the sensor's torque takes of the nominal
spring (motion.py). Where the spring, or what a sensor reads, is another one, its balance has an error e, and
the link is elsewhere:

    (K + D s) dq = -e

Then nothing is left of that balance, and the links' loads are others. Whitening would eliminate the movement
as well (whitening.py), but for the mean posture only, and not near the ends of a record: a balance that is
cut off there is a movement that ends, with the accelerations of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import fft

from flexjoint.diagnosis.balances.links.movement import Movement
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.effects import Drive


class SprungLinks:
    """The links of a motion that have a torque sensor and no encoder."""

    def __init__(self, motion: Motion, springs: Mapping[int, int]) -> None:
        """`springs` is the row, by joint, of the spring's balance."""
        self._motion = motion
        unseen = {i for channel, i in motion.missing if channel == "q"}
        self.rows = {i: row for i, row in springs.items() if i in unseen}

    def __contains__(self, i: int) -> bool:
        return i in self.rows

    def movements(self, spectra: Mapping[int, np.ndarray], drives: Sequence[Drive]) -> dict[int, Movement]:
        """By joint, what errors of balances, as spectra (F,) by row, move links by that have springs with
        these numbers."""
        clock = self._motion.filter
        s, out = 1j * clock.omega, {}
        for i, row in self.rows.items():
            if row in spectra:
                moved = -spectra[row] / (drives[i].K + drives[i].D * s)
                series = fft.irfft(np.array([moved, s * moved, s**2 * moved]), clock.size, axis=-1)
                out[i] = Movement(*series[:, : clock.count])
        return out
