"""Measured against simulated, before and after: traces of the worst joints and the errors per channel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.result import merit
from flexjoint.diagnosis.result.wording import clean, number, percent, unit_of, with_unit
from flexjoint.recording.table import MEASURED
from flexjoint.report import plots, series
from flexjoint.report.material import Comparison, Material

JOINTS, OTHER_CHANNELS = 3, 2  # the first joint with all its channels, the others with their two worst
EXCERPT = 3.0  # [s]
ROWS = 60


@dataclass(frozen=True)
class ChannelPlots:
    name: str
    excerpt: plots.Image
    whole: plots.Image


@dataclass(frozen=True)
class JointPlots:
    joint: str
    excerpt: str
    channels: tuple[ChannelPlots, ...]


@dataclass(frozen=True)
class ErrorRow:
    joint: str
    channel: str
    rms: str
    before: str
    after: str
    floor: str
    removed: str


@dataclass(frozen=True)
class ComparedSection:
    held_out: bool
    horizon: str
    has_after: bool
    rows: tuple[ErrorRow, ...]
    more_rows: int
    joints: tuple[JointPlots, ...]
    onsets: bool


def build(material: Material) -> ComparedSection | None:
    """None where neither a comparison nor a simulation is at hand."""
    gain = material.gain
    errors = merit.channel_errors(gain)
    if gain is None or not errors:
        return None
    named = bool(material.diagnosis.findings)
    joints = list(merit.joint_errors(errors))
    worst = sorted(errors, key=lambda e: joints.index(e.joint) if e.joint in joints else len(joints))
    return ComparedSection(
        gain.held_out,
        f"{gain.horizon:g} s",
        named,
        tuple(_row(error, named, error.joint in material.robot.prismatic) for error in worst[:ROWS]),
        max(0, len(errors) - ROWS),
        _joints(material, errors),
        any(finding.since is not None for finding in material.diagnosis.findings),
    )


def _row(error: merit.ChannelError, named: bool, prismatic: bool) -> ErrorRow:
    rms = number(error.rms_before)
    if named and math.isfinite(error.rms_after):
        rms += f" → {number(error.rms_after)}"
    return ErrorRow(
        clean(error.joint),
        error.channel,
        with_unit(rms, unit_of(error.channel, prismatic)),
        number(error.before),
        number(error.after),
        number(error.floor),
        percent(error.removed),
    )


def _joints(material: Material, errors: tuple[merit.ChannelError, ...]) -> tuple[JointPlots, ...]:
    before = material.before
    if before is None:
        return ()
    worst = list(merit.joint_errors(errors))[:JOINTS]
    named = [f.joint for f in material.diagnosis.findings if f.joint is not None][:1]
    worst = [*(joint for joint in named if joint not in worst), *worst][:JOINTS]
    shown = []
    for place, joint in enumerate(worst):
        channels = [
            c for c in MEASURED if (c, joint) in before.simulated and material.recording.has(c, joint)
        ]
        nrmse = {c: before.nrmse.get(f"{c}.{joint}", 0.0) for c in channels}
        by_error = sorted(channels, key=lambda c: -nrmse[c])
        if place > 0:
            channels = [c for c in channels if c in by_error[:OTHER_CHANNELS]]
        if channels:
            shown.append(_joint(material, before, joint, channels, by_error[0]))
    return tuple(shown)


def _joint(material: Material, before: Comparison, joint: str, channels: list[str], worst: str) -> JointPlots:
    time = before.time
    measured = series.on_times(material.recording, worst, joint, time)
    start, stop = series.excerpt(time, before.simulated[worst, joint] - measured, EXCERPT)
    inside = (time >= start) & (time <= stop)
    prismatic = joint in material.robot.prismatic
    pairs = []
    for channel in channels:
        measured = series.on_times(material.recording, channel, joint, time)
        simulated = before.simulated[channel, joint]
        improved = _after(material, channel, joint, time)
        name, unit = material.joints.signal(channel), unit_of(channel, prismatic)
        rms = with_unit(number(before.rms.get(f"{channel}.{joint}")), unit)
        pairs.append(
            ChannelPlots(
                name,
                plots.traces(
                    time[inside],
                    measured[inside],
                    simulated[inside],
                    None if improved is None else improved[inside],
                    channel,
                    name,
                    prismatic,
                    f"{name} of {clean(joint)}, measured and simulated, from {start:.2f} to {stop:.2f} s",
                ),
                plots.errors(
                    time,
                    simulated - measured,
                    None if improved is None else improved - measured,
                    channel,
                    (start, stop),
                    _changes(material, joint),
                    prismatic,
                    f"Error of the {name} of {clean(joint)} over the whole recording; RMS {rms} before",
                ),
            )
        )
    return JointPlots(clean(joint), f"{start:.1f} to {stop:.1f} s", tuple(pairs))


def _after(material: Material, channel: str, joint: str, time: np.ndarray) -> np.ndarray | None:
    after = material.after
    if after is None or (channel, joint) not in after.simulated or not material.diagnosis.findings:
        return None
    values = after.simulated[channel, joint]
    return values if np.array_equal(after.time, time) else np.interp(time, after.time, values)


def _changes(material: Material, joint: str) -> tuple[float, ...]:
    """Times [s] at which the first cause of a joint sets in or ceases that was not always there."""
    dated = [f for f in material.diagnosis.findings if f.since is not None and f.joint in (joint, None)]
    if not dated:
        return ()
    spans = dated[0].during or ((dated[0].since, None),)
    return tuple(t for span in spans for t in span if t is not None)
