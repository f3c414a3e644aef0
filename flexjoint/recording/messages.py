"""Refusals of a recording, short and in one line whatever a file holds."""

from __future__ import annotations

from flexjoint.core.errors import RecordingError
from flexjoint.core.messages import LONGEST_LINE, shown

LONGEST_SOURCE = 160  # characters of a file's path: its end tells which file it is


def refusal(source: object, reason: str, between: str = ": ") -> RecordingError:
    """The error that refuses a recording: its source, what was found and what to do, in one line."""
    # its end says what to do: of what is too long the middle is left out
    return RecordingError(shown(f"{shown(source, LONGEST_SOURCE)}{between}{reason}", LONGEST_LINE))
