"""A number that may vary: bounds, deviations, and the numbers of a model as such."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.robots.arms import PLANAR, make

from flexjoint.core.errors import ModelError
from flexjoint.core.parameter import SMALLEST, Parameter
from flexjoint.effects import effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import model_parameters
from flexjoint.model.symbolic import SymbolicModel


def test_bounds_hold() -> None:
    gap = Parameter("gap", "rad", value=1e-3, low=0.0, high=0.5)
    assert gap.checked(0) == 0.0 and gap.checked(0.5) == 0.5
    with pytest.raises(ModelError, match=r"level: expected a number > 0 N m, got 0\.0"):
        Parameter("level", "N m", low=SMALLEST).checked(0.0)
    for wrong in (-1e-9, 0.6, math.nan, "0.1", None):
        with pytest.raises(ModelError, match=r"play: expected a number in \[0, 0\.5\] rad, got"):
            gap.checked(wrong, "play")


def test_deviations_become_bounds_inside_the_own_ones() -> None:
    mass = Parameter("mass", "kg", value=1.0, low=0.0, high=1.5, std=0.4)
    assert (mass.within(1.0).low, mass.within(1.0).high) == (pytest.approx(0.6), pytest.approx(1.4))
    assert (mass.within(3.0).low, mass.within(3.0).high) == (0.0, 1.5)
    with pytest.raises(ModelError, match="mass: its standard deviation is not known"):
        Parameter("mass", "kg").within(2.0)


def test_the_parameters_of_a_model_have_units_bounds_and_deviations() -> None:
    robot = make(PLANAR, tolerance={"stiffness": 0.05})
    load = effect("payload", "knee", position=(0.1, 0.2, 0.3))
    effects = [effect("backlash", "knee", gap=2e-3), load]
    found = model_parameters(robot, FlexibleJointModel(robot, effects).effects, ("drives", "inertial"))
    gap, stiffness = found["backlash.knee.gap"], found["drive.knee.stiffness"]
    assert (gap.value, gap.unit, gap.low, gap.high, gap.std) == (2e-3, "rad", 0.0, 0.5, None)
    assert [found[f"payload.knee.position[{k}]"].value for k in range(3)] == [0.1, 0.2, 0.3]
    assert stiffness.unit == "N m/rad" and stiffness.std == pytest.approx(0.05 * stiffness.value)
    assert found["body.knee.Izz"].unit == "kg m^2" and found["body.knee.Izz"].std is None
    symbolic = SymbolicModel(robot, effects, free=("drives", "inertial"))
    by_name = dict(zip(symbolic.parameters, symbolic.values, strict=True))
    assert set(by_name) == set(found)
    np.testing.assert_array_equal([by_name[name] for name in found], [p.value for p in found.values()])


def test_the_absence_of_what_a_model_lists_is_no_bound() -> None:
    level = Parameter("level", "N m", low=0.0, high=10.0)
    assert level.bounds() == (0.0, 10.0) and level.bounds(listed=True) == (-math.inf, 10.0)
    limit = Parameter("limit", "N m", low=0.0, high=1e6, null=1e6)
    assert limit.bounds(listed=True) == (0.0, math.inf)
    shape = Parameter("scale", "rad", low=1e-6, high=1.0, null=None)
    assert shape.bounds(listed=True) == shape.bounds() == (1e-6, 1.0)
