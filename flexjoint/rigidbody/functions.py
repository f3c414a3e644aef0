"""The rigid-body algorithms of a pin.Model as named casadi.Functions.

f = rigid_body_functions(model)                     # any robot that Pinocchio loads
f.aba(q, v, tau)                                    # numbers, or expressions of an own problem
f = rigid_body_functions(model, free=("inertial",))
f.rnea(q, v, a, inertial)                           # inertial parameters as a further input
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from flexjoint.core.errors import ModelError, unknown
from flexjoint.rigidbody.numeric import inertial_of
from flexjoint.rigidbody.symbolic import SymbolicBody


@dataclass(frozen=True)
class Signature:
    """The inputs and the output of a method as a casadi.Function."""

    inputs: tuple[str, ...]
    output: str
    of_frame: bool = False


FUNCTIONS: dict[str, Signature] = {
    "aba": Signature(("q", "v", "tau", "armature"), "a"),
    "rnea": Signature(("q", "v", "a"), "tau"),
    "nle": Signature(("q", "v"), "tau"),
    "gravity_torque": Signature(("q",), "tau"),
    "coriolis_torque": Signature(("q", "v"), "tau"),
    "coriolis_matrix": Signature(("q", "v"), "coriolis"),
    "mass_matrix": Signature(("q",), "mass"),
    "regressor": Signature(("q", "v", "a"), "regressor"),
    "integrate": Signature(("q", "dv"), "q_next"),
    "frame_placement": Signature(("q",), "placement", of_frame=True),
    "frame_jacobian": Signature(("q",), "jacobian", of_frame=True),
    "center_of_mass": Signature(("q",), "position"),
}
"""The methods of SymbolicBody that make_function can make a Function of."""

FREE = ("inertial", "gravity", "armature")


def make_function(body: SymbolicBody, name: str, frame: str | None = None) -> ca.Function:
    """One method of a SymbolicBody as a casadi.Function with named inputs and output.

    Inertial parameters, gravity and armature that the body was given as symbols become further inputs of
    these names. `frame` is for frame_placement and frame_jacobian.

    Raises:
        UnknownNameError: no such method.
        ModelError: a frame is missing or not asked for; inertial, gravity or armature hold expressions
            instead of symbols (then call the method and build the Function of their symbols yourself).
    """
    if name not in FUNCTIONS:
        raise unknown("rigid-body function", name, FUNCTIONS)
    signature = FUNCTIONS[name]
    if (frame is not None) != signature.of_frame:
        raise ModelError(f"{name} {'needs a' if signature.of_frame else 'takes no'} frame, got {frame!r}")
    inputs = [ca.SX.sym(entry, body.nq if entry == "q" else body.nv) for entry in signature.inputs]
    method: Callable[..., ca.SX] = getattr(body, name)
    output = method(*inputs) if frame is None else method(*inputs, frame)
    return _function(body, name, dict(zip(signature.inputs, inputs, strict=True)), output, signature.output)


def _function(
    body: SymbolicBody, name: str, inputs: dict[str, ca.SX], output: ca.SX, label: str
) -> ca.Function:
    given: dict[str, Any] = dict(inputs)
    for entry in FREE:
        value = ca.SX(getattr(body, entry))
        if ca.symvar(value):
            if not value.is_valid_input():
                raise ModelError(f"{name}: {entry} must be plain symbols to be an input of a Function")
            given[entry] = value
    return ca.Function(name, list(given.values()), [ca.cse(output)], list(given), [label])


class RigidBodyFunctions:
    """A pin.Model's algorithms, each a casadi.Function that is built when it is first asked for.

    q is (nq,), v, a and tau are (nv,), in Pinocchio's order; SI and radians. Inputs and outputs have names.
    What `free` lists follows as inputs of every function, in this order: inertial (njoints - 1, 10), each row
    m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint frame's origin; gravity (3,) along base axes [m/s^2];
    armature (nv,) [kg m^2]. `values` has the model's numbers of them.

    Made by rigid_body_functions.
    """

    def __init__(self, body: SymbolicBody, values: dict[str, np.ndarray]) -> None:
        self._body = body
        self.nq, self.nv = body.nq, body.nv
        self.values = values
        self._placement = cache(lambda frame: make_function(body, "frame_placement", frame))
        self._jacobian = cache(lambda frame: make_function(body, "frame_jacobian", frame))

    @cached_property
    def rnea(self) -> ca.Function:
        """rnea(q, v, a) -> tau (nv,): joint forces of an acceleration, armature included."""
        return make_function(self._body, "rnea")

    @cached_property
    def aba(self) -> ca.Function:
        """aba(q, v, tau) -> a (nv,): acceleration under joint forces."""
        body = self._body
        q, v, tau = ca.SX.sym("q", body.nq), ca.SX.sym("v", body.nv), ca.SX.sym("tau", body.nv)
        output = body.aba(q, v, tau, ca.SX.zeros(body.nv))
        return _function(body, "aba", {"q": q, "v": v, "tau": tau}, output, "a")

    @cached_property
    def crba(self) -> ca.Function:
        """crba(q) -> mass (nv, nv): the mass matrix, dense and symmetric, armature included."""
        q = ca.SX.sym("q", self.nq)
        return _function(self._body, "crba", {"q": q}, self._body.mass_matrix(q), "mass")

    @cached_property
    def gravity(self) -> ca.Function:
        """gravity_torque(q) -> tau (nv,): generalised gravity, the joint forces that hold q at rest."""
        return make_function(self._body, "gravity_torque")

    @cached_property
    def nle(self) -> ca.Function:
        """nle(q, v) -> tau (nv,): Coriolis, centrifugal and gravity forces."""
        return make_function(self._body, "nle")

    @cached_property
    def coriolis(self) -> ca.Function:
        """coriolis_torque(q, v) -> tau (nv,): Coriolis and centrifugal forces."""
        return make_function(self._body, "coriolis_torque")

    @cached_property
    def coriolis_matrix(self) -> ca.Function:
        """coriolis_matrix(q, v) -> coriolis (nv, nv): C of the Christoffel symbols, C v = coriolis."""
        return make_function(self._body, "coriolis_matrix")

    @cached_property
    def regressor(self) -> ca.Function:
        """regressor(q, v, a) -> regressor (nv, 10 (njoints - 1)), sparse: times the stacked inertial
        parameters it gives rnea without the armature's share."""
        return make_function(self._body, "regressor")

    @cached_property
    def center_of_mass(self) -> ca.Function:
        """center_of_mass(q) -> position (3,) in the base [m], of the moving bodies."""
        return make_function(self._body, "center_of_mass")

    @cached_property
    def integrate(self) -> ca.Function:
        """integrate(q, dv) -> q_next (nq,): the configuration after a unit time at the velocity dv."""
        return make_function(self._body, "integrate")

    def frame_placement(self, frame: str) -> ca.Function:
        """frame_placement(q) -> placement (4, 4), homogeneous, of a frame in the base. UnknownNameError lists
        the valid frames."""
        return self._placement(frame)

    def frame_jacobian(self, frame: str) -> ca.Function:
        """frame_jacobian(q) -> jacobian (6, nv), linear part first, of a frame's origin along base axes
        (LOCAL_WORLD_ALIGNED). UnknownNameError lists the valid frames."""
        return self._jacobian(frame)


def rigid_body_functions(model: pin.Model, free: Collection[str] = ()) -> RigidBodyFunctions:
    """The rigid-body algorithms of a model as casadi.Functions.

    Args:
        model: any pin.Model; copied. Its joints may be revolute, unbounded revolute, prismatic (aligned with
            an axis or not), translation, spherical, planar, free-flyer, and mimic joints of one axis.
        free: which of inertial, gravity and armature become inputs instead of the model's numbers.

    Raises:
        ModelError: a joint of another type, named with it.
        UnknownNameError: `free` names something else.
    """
    for name in free:
        if name not in FREE:
            raise unknown("free input", name, FREE)
    symbols = {
        "inertial": ca.SX.sym("inertial", model.njoints - 1, 10),
        "gravity": ca.SX.sym("gravity", 3),
        "armature": ca.SX.sym("armature", model.nv),
    }
    values = {
        "inertial": inertial_of(model),
        "gravity": np.array(model.gravity.linear),
        "armature": np.array(model.armature),
    }
    body = SymbolicBody(model, *(symbols[name] if name in free else None for name in FREE))
    return RigidBodyFunctions(body, {name: values[name] for name in FREE if name in free})
