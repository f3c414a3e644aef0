"""Names and refusals of a recording, short and in one line whatever a file holds."""

from __future__ import annotations

from flexjoint.core.errors import RecordingError

LONGEST_NAME = 60  # characters of a name out of a file: longer ones say no more
LONGEST_SOURCE = 160  # characters of a file's path: its end tells which file it is
MOST_READ = 5000  # characters of a text that are looked at
LONGEST_LINE = 300  # characters of a refusal: three lines of a terminal


def shown(name: object, longest: int = LONGEST_NAME) -> str:
    """A name as it may be printed: control characters escaped, its middle left out where it is long."""
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(name)[:MOST_READ])
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"


def refusal(source: object, reason: str, between: str = ": ") -> RecordingError:
    """The error that refuses a recording: its source, what was found and what to do, in one line."""
    # its end says what to do: of what is too long the middle is left out
    return RecordingError(shown(f"{shown(source, LONGEST_SOURCE)}{between}{reason}", LONGEST_LINE))
