"""What can go wrong. A message says what was expected, what came, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class FlexJointError(ValueError):
    """Base of every error that a user's input can cause; the command line prints it as one line."""


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


class MissingExtraError(FlexJointError):
    """An optional dependency is absent."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(f"{package} is not installed; install it with: pip install 'flexjoint[{extra}]'")


def unknown(kind: str, name: object, valid: Iterable[object]) -> UnknownNameError:
    """The error for an unknown name, with the nearest and all valid ones."""
    names = sorted(str(v) for v in valid)
    near = get_close_matches(str(name), names, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return UnknownNameError(f"unknown {kind} {name!r}{hint}; valid: {', '.join(names) or 'none'}")
