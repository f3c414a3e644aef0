"""Integration schemes: one class each, which knows its order, its properties and its step."""

from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step
from flexjoint.simulation.schemes.catalogue import SCHEMES, find, make_step

__all__ = ["DEFAULT", "SCHEMES", "Scheme", "Step", "find", "make_step"]
