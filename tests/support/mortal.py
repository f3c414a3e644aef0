"""Units of work whose workers die or take long, in a module that a worker imports fast."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from flexjoint.diagnosis.followup.fleet.units import Unit


def perform(unit: Unit) -> dict[str, object]:
    """In the place of the real one: of a unit of the robot `always` the worker dies each time, of one of
    `once` the first time; one of `slow` takes a minute."""
    if unit.robot == "slow":
        time.sleep(60.0)
    marker = Path(unit.recording)
    if unit.robot == "always" or (unit.robot == "once" and not marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"key": unit.key, "error": "", "seconds": 0.0}
