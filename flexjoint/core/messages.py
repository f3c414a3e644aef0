"""Text out of files and names as it may be printed: short, in one line, without control characters."""

from __future__ import annotations

LONGEST_NAME = 60  # characters of a name out of a file: longer ones say no more
LONGEST_LINE = 300  # characters of a refusal: three lines of a terminal
LONGEST_MESSAGE = 2000  # characters of an error in Python: all names of the catalogue, and a sentence
HALF_READ = 5000  # characters at either end of a text that are looked at


def shown(name: object, longest: int = LONGEST_NAME) -> str:
    """A name as it may be printed: control characters escaped, its middle left out where it is long."""
    return cut(escaped(_ends(str(name))), longest)


def escaped(text: str, kept: str = "") -> str:
    """The text with what is not printable escaped, but for the characters `kept`."""
    return text if text.isprintable() else "".join(c if c in kept else _escape(c) for c in text)


def cut(text: str, longest: int, end: float = 0.5) -> str:
    """The text without its middle where it is longer; so much of what is kept is its end."""
    last = int(end * (longest - 3))
    return text if len(text) <= longest else f"{text[: longest - 3 - last]}...{text[-last:]}"


def one_line(message: object, longest: int = LONGEST_LINE) -> str:
    """A message as one line: a path and what is wrong stand at its beginning, what to do at its end."""
    return cut(escaped(" ".join(_ends(str(message)).split())), longest, end=1 / 3)


def _escape(c: str) -> str:
    return c if c.isprintable() else ascii(c)[1:-1]


def _ends(text: str) -> str:
    return text if len(text) <= 2 * HALF_READ else text[:HALF_READ] + text[-HALF_READ:]
