"""Columns of a recording made right: linear maps of columns, and which columns belong together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from flexjoint.diagnosis.data.change import Key, Source
from flexjoint.diagnosis.data.travel import slope
from flexjoint.diagnosis.result.values import Column, DataFinding
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.table import Recording

OF_SIDE = {"q": ("q", "q_ref", "dq"), "theta": ("theta", "theta_ref", "dtheta", "dtheta_ref")}
POSITIONS = ("q", "q_ref", "theta", "theta_ref")
MOVING = (*OF_SIDE["q"], *OF_SIDE["theta"])


def repaired(recording: Recording, findings: Iterable[DataFinding]) -> Recording:
    """The recording with the columns made right, and a note of each; the recording itself without any."""
    notes = list(recording.notes)
    columns = dict(recording.columns)
    for finding in findings:
        old = dict(columns)
        for column in finding.columns:
            channel, _, joint = column.name.partition(".")
            source = column.source.partition(".")
            values = old[source[0], source[2]]
            columns[channel, joint] = column.scale * values + column.offset
        if finding.columns:
            notes.append(f"{finding.text}: repaired")
    if len(notes) == len(recording.notes):
        return recording
    return replace(recording, columns=columns, notes=tuple(notes))


def of_side(
    recording: Recording, joint: str, side: str, scale: float, offset: float = 0.0
) -> tuple[Column, ...]:
    """The columns of one encoder that are as it is: those that move with it, as far as it does."""
    out = []
    for channel in OF_SIDE[side]:
        if not recording.has(channel, joint):
            continue
        same = channel == side
        if not same and (found := slope(recording, joint, channel, side)) is not None:
            same = 1.0 / USUAL.data.slope_one < found.slope < USUAL.data.slope_one
        if same:
            shift = offset if channel in POSITIONS else 0.0
            out.append(Column(f"{channel}.{joint}", f"{channel}.{joint}", scale, shift))
    return tuple(out)


def of_motion(recording: Recording, positions: Mapping[str, Source]) -> tuple[Column, ...]:
    """All columns of the joints' motion from where the right ones are."""
    out = []
    for joint, source in positions.items():
        for channel in MOVING:
            if recording.has(channel, source.joint):
                shift = source.shift if channel in POSITIONS else 0.0
                out.append(Column(f"{channel}.{joint}", f"{channel}.{source.joint}", source.scale, shift))
    return tuple(out)


def of_torques(recording: Recording, torques: Mapping[Key, Source]) -> tuple[Column, ...]:
    """The columns of torques from where the right ones are."""
    return tuple(
        Column(f"{channel}.{joint}", f"{channel}.{source.joint}", source.scale)
        for (channel, joint), source in torques.items()
        if recording.has(channel, source.joint)
    )


def named(columns: Sequence[Column]) -> str:
    """q.elbow and theta.elbow"""
    names = [column.name for column in columns]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
