"""How far the simulation is from the recording, before and after: rows of a table and one figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from flexjoint.diagnosis.result.values import Gain

MISSING = math.nan


@dataclass(frozen=True)
class ChannelError:
    """One channel of one joint; NaN where a number is not known."""

    channel: str
    joint: str
    rms_before: float
    rms_after: float
    before: float  # NRMSE
    after: float
    floor: float  # NRMSE that sensor noise alone leaves, in start states and driving torques, too

    @property
    def removed(self) -> float:
        """Share of the error that the named causes remove; negative when it grew."""
        return 1.0 - self.after / self.before if self.before > 0 else MISSING


@dataclass(frozen=True)
class Overall:
    """Root mean square of the NRMSE over all measured channels (deflections apart)."""

    before: float
    after: float
    floor: float

    @property
    def removed(self) -> float:
        return 1.0 - self.after / self.before if self.before > 0 else MISSING


def channel_errors(gain: Gain | None) -> tuple[ChannelError, ...]:
    """One entry per channel in the table's order, so that a joint's channels stand together."""
    if gain is None:
        return ()
    rms, nrmse = gain.before.get("rms", {}), gain.before.get("nrmse", {})
    rms_after, nrmse_after = gain.after.get("rms", {}), gain.after.get("nrmse", {})
    rows = []
    for key in nrmse:
        channel, _, joint = key.partition(".")
        rows.append(
            ChannelError(
                channel,
                joint,
                rms.get(key, MISSING),
                rms_after.get(key, MISSING),
                nrmse[key],
                nrmse_after.get(key, MISSING),
                _floor(gain, key),
            )
        )
    order = {joint: i for i, joint in enumerate(dict.fromkeys(row.joint for row in rows))}
    return tuple(sorted(rows, key=lambda row: order[row.joint]))


def overall(gain: Gain | None) -> Overall | None:
    """The one figure of the whole robot; None without a comparison."""
    rows = [row for row in channel_errors(gain) if row.channel != "phi" and math.isfinite(row.before)]
    if not rows:
        return None
    return Overall(
        root_mean_square(row.before for row in rows),
        root_mean_square(row.after for row in rows),
        root_mean_square(row.floor for row in rows),
    )


def joint_errors(rows: Iterable[ChannelError]) -> Mapping[str, float]:
    """NRMSE before of each joint (root mean square of its channels), the worst first."""
    channels: dict[str, list[float]] = {}
    for row in rows:
        if row.channel != "phi" and math.isfinite(row.before):
            channels.setdefault(row.joint, []).append(row.before)
    joints = {joint: root_mean_square(errors) for joint, errors in channels.items()}
    return dict(sorted(joints.items(), key=lambda item: -item[1]))


def root_mean_square(values: Iterable[float]) -> float:
    """Over the finite values; NaN when there are none."""
    finite = [value for value in values if math.isfinite(value)]
    return math.sqrt(sum(value * value for value in finite) / len(finite)) if finite else MISSING


def _floor(gain: Gain, key: str) -> float:
    """NRMSE of the noise alone: its RMS in the simulation, or else in the reading, over the channel's
    standard deviation."""
    readings = gain.noise_floor.get("rms", {})
    noise = gain.noise_floor.get("simulated", {}).get(key, readings.get(key, MISSING))
    rms = gain.before.get("rms", {}).get(key, MISSING)
    return noise * gain.before["nrmse"][key] / rms if rms > 0 else MISSING
