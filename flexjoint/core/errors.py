"""What can go wrong. A message says what was expected, what came, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from flexjoint.core.messages import LONGEST_MESSAGE, cut, escaped, shown


class FlexJointError(ValueError):
    """Base of every error that a user's input can cause; the command line prints it as one line.

    What a message quotes out of files is bounded here: control characters are escaped, and of a message of
    more than 2000 characters the middle is left out.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(cut(escaped(str(message), kept="\n"), LONGEST_MESSAGE))


class RobotError(FlexJointError):
    """The robot's YAML or URDF cannot be used."""


class RecordingError(FlexJointError):
    """The recording cannot be used."""


class UnknownNameError(FlexJointError):
    """A name that does not exist; the message lists those that do."""


class ModelError(FlexJointError):
    """The model cannot be built or lacks what was asked of it."""


class SimulationError(FlexJointError):
    """A simulation left the finite numbers or cannot be run as asked."""


class StabilityWarning(UserWarning):
    """A scheme's step is too long for a spring; the message names the joint and a rate that would do."""


class RobotWarning(UserWarning):
    """A description holds what no body has, or what is not modelled; the message names it."""


class MissingExtraError(FlexJointError):
    """An optional dependency is absent."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; install it with: pip install 'flexjoint[{extra}]'")


def unknown(kind: str, name: object, valid: Iterable[object]) -> UnknownNameError:
    """The error for an unknown name, with the nearest and all valid ones."""
    names = sorted(str(v) for v in valid)
    near = get_close_matches(str(name), names, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return UnknownNameError(f"unknown {kind} '{shown(name)}'{hint}; valid: {', '.join(names) or 'none'}")
