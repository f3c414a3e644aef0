"""The physical effects: one small class in one file each, and the catalogue of them by name."""

from flexjoint.core.parameter import Parameter
from flexjoint.effects._base import (
    SENSOR_CHANNELS,
    Drive,
    Effect,
    Kind,
    Signals,
    Site,
    Source,
    Typical,
    Word,
)
from flexjoint.effects._catalogue import Planned, catalogue, effect, find, numbers_beyond, signal_order

__all__ = [
    "SENSOR_CHANNELS",
    "Drive",
    "Effect",
    "Kind",
    "Parameter",
    "Planned",
    "Signals",
    "Site",
    "Source",
    "Typical",
    "Word",
    "catalogue",
    "effect",
    "find",
    "numbers_beyond",
    "signal_order",
]
