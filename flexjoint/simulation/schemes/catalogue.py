"""The integration schemes by name. docs/explained/simulation.md compares them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from flexjoint.core.errors import unknown
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.simulation.schemes.base import DEFAULT, Scheme, Step
from flexjoint.simulation.schemes.explicit import (
    RK4,
    ExplicitEuler,
    Kamedula2016,
    Kamedula2016New,
    SemiImplicitEuler,
)
from flexjoint.simulation.schemes.implicit import ImplicitMidpoint
from flexjoint.simulation.schemes.midpoint import LinearlyImplicitMidpoint
from flexjoint.simulation.schemes.reference import Reference

_ALL: tuple[Scheme, ...] = (
    LinearlyImplicitMidpoint(),
    SemiImplicitEuler(),
    ExplicitEuler(),
    Kamedula2016(),
    Kamedula2016New(),
    RK4(),
    ImplicitMidpoint(),
    Reference(),
)
SCHEMES: Mapping[str, Scheme] = MappingProxyType({scheme.name: scheme for scheme in _ALL})


def find(name: str) -> Scheme:
    """The scheme of that name; UnknownNameError lists the valid ones."""
    if name not in SCHEMES:
        raise unknown("scheme", name, SCHEMES)
    return SCHEMES[name]


def make_step(model: FlexibleJointModel, h: float, scheme: str = DEFAULT, width: float | None = None) -> Step:
    """The step function of a scheme by its name; see `Scheme.step`. Raises UnknownNameError and as that."""
    return find(scheme).step(model, h, width)
