"""What a report is made of."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from flexjoint.core.errors import MissingExtraError
from flexjoint.diagnosis.result import Diagnosis, Gain
from flexjoint.diagnosis.result.wording import Joints
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot


class Comparison(Protocol):
    """A simulation beside a recording, restarted from the measured state every `horizon` [s].

    `rms` and `nrmse` map "q.elbow" to a number. `simulated` maps (channel, joint) to (N,) samples at
    `time` (N,) [s], NaN outside the windows.
    """

    @property
    def rms(self) -> Mapping[str, float]: ...

    @property
    def nrmse(self) -> Mapping[str, float]: ...

    @property
    def horizon(self) -> float: ...

    @property
    def windows(self) -> int: ...

    @property
    def time(self) -> np.ndarray: ...

    @property
    def simulated(self) -> Mapping[tuple[str, str], np.ndarray]: ...


@dataclass(frozen=True)
class Material:
    """Everything that the sections draw on; `before` is the nominal model, `after` the extended one."""

    diagnosis: Diagnosis
    robot: Robot
    recording: Recording
    before: Comparison | None = None
    after: Comparison | None = None

    @cached_property
    def joints(self) -> Joints:
        return Joints.of(self.robot)

    @cached_property
    def gain(self) -> Gain | None:
        """The comparison on unseen data; without one, what the given simulations say of this recording."""
        if self.diagnosis.comparison is not None or self.before is None:
            return self.diagnosis.comparison
        return Gain(
            held_out=False,
            horizon=self.before.horizon,
            before=_measures(self.before),
            after=_measures(self.after),
            noise_floor={},
        )


def _measures(comparison: Comparison | None) -> dict[str, Mapping[str, float]]:
    return {} if comparison is None else {"rms": comparison.rms, "nrmse": comparison.nrmse}


def require(package: str) -> None:
    """Raise MissingExtraError when an optional package cannot be imported."""
    try:
        importlib.import_module(package)
    except ImportError:
        raise MissingExtraError(package, "report") from None
