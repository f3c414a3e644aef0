"""Rigid contact of points, spheres and wheels with flat ground at height 0, by Pinocchio's ADMM solver.

A contact pushes and does not pull, and rubs by Coulomb's law: its material point stays where it is as long as
the force lies within the cone, and slides against the force on it. For c contacts with velocities u = G p + g
and impulses p,

    p in the cones,    u + mu |u_t| e_z in their duals,    and the two normal to each other

(De Saxce and Feng 1998; Carpentier, Le Lidec and Montaut 2024 for the solver). A wheel needs nothing of its
own: its lowest material point is at rest when it rolls.

A step solves twice. At the midpoint of the linearly implicit midpoint rule the impulse p over half a step
keeps the contacts' heights at the step's end at 0 or more, and feet that stick stay where they are: it is by
midpoint velocities that positions move. Then the whole step's impulse is solved anew for the velocities at
its end, where landed feet neither sink nor bounce. The first solution alone would ring: a midpoint rule gives
v back as -v to what it stops. While feet stand or slide the second one changes little, and the order stays 2
(projected Runge-Kutta: Ascher and Petzold 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import ModelError, SimulationError
from flexjoint.core.ops import Value
from flexjoint.model.contact.compliant import Ground, Touch
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.robot.contacts import GroundContact

NEAR = 1e-3  # [m] above the ground, from which on a contact takes part in a step
RECOVERY = 0.1  # [m/s] at which what has sunk in comes up
TOLERANCE = 1e-10  # that the solver aims at, absolute: m/s of velocities, N s of impulses
ENOUGH = 1e-7  # what is taken where rounding keeps it from that
ITERATIONS = 300  # with Anderson's acceleration, which in one solution of ten thousand goes astray
PATIENCE = 3000  # iterations without


class RigidGround(Ground):
    """The contacts of a model with rigid ground. `slot` is the place in z of the first force: the internal
    states are each contact's force on the robot over the last step [N], along world axes.

    Stiffnesses and dampings of the contacts do not count.
    """

    springy = False

    def __init__(self, contacts: Sequence[GroundContact], model: pin.Model, slot: int) -> None:
        super().__init__(contacts, model, slot)
        self.model = model
        self.slots = slice(slot, slot + 3 * len(self.contacts))
        self.names = tuple(f"force_{axis}.{item.frame}" for item in self.contacts for axis in "xyz")

    def forces(self, z: np.ndarray) -> np.ndarray:
        """(c, 3) of z (nz,) [N]."""
        return np.array(z[self.slots]).reshape(-1, 3)

    def touch(self, body: Any, q: Value, v: Value, z: Value, ahead: float = 0.0) -> Touch:
        """The forces of the last step, which are in z (nz,), at q (nq,)."""
        points, jacobians = self.places(body, q)
        forces = self.forces(z)
        tau = np.einsum("cjv,cj->v", jacobians, forces)
        flat = forces.ravel().tolist()
        return Touch(tau, points.tolist(), forces.tolist(), flat, [0.0] * len(flat))

    def below(self, body: Any, q: Value) -> Value:
        """(3 c,) of a state of which no force is known."""
        return np.zeros(3 * len(self.contacts))

    def sinking(self, forces: np.ndarray) -> np.ndarray:
        return np.zeros(len(forces))

    def carrying(self, body: Any, z: Value, points: np.ndarray, forces: np.ndarray) -> Value:
        return self.with_anchors(body, z, forces.ravel().tolist())


@dataclass(frozen=True)
class HalfStep:
    """What the ground does up to a step's midpoint: acc (nv,) of the links with it; inverse (nv, nv) of the
    mass matrix; impulses (c, 3) over half the step [N s]."""

    acc: np.ndarray
    inverse: np.ndarray
    impulses: np.ndarray


class RigidContacts:
    """The impulses of rigid ground on a body in steps of h [s]; `rubbing` names the joints whose links have
    dry friction.

    Raises ModelError where there are such joints: two sets would have to be solved as one.
    """

    def __init__(self, ground: RigidGround, body: PinBody, rubbing: Sequence[str], h: float) -> None:
        if rubbing:
            raise ModelError(
                f"rigid ground takes no dry friction of links, and {rubbing[0]} has some: take that effect"
                " away, or use ground: compliant"
            )
        self.ground, self.body, self.h, self.a = ground, body, h, 0.5 * h
        self.solvers: dict[tuple[int, ...], Solver] = {}

    def first_half(
        self, q_mid: np.ndarray, v: np.ndarray, z: np.ndarray, acc: np.ndarray, armature: np.ndarray
    ) -> HalfStep:
        """The acceleration acc (nv,) without the ground, with it; v and z at the step's start."""
        body, a, h = self.body, self.a, self.h
        points, jacobians = self.ground.places(body, q_mid)
        rates = jacobians @ (v + a * acc)
        # height at the step's end less what the midpoint velocity adds to it
        heights = points[:, 2] - a * (jacobians[:, 2] @ v)
        near = np.flatnonzero(heights + h * np.minimum(rates[:, 2], 0.0) < NEAR)
        inverse = body.inverse_mass_matrix(q_mid, armature)
        impulses = np.zeros((len(points), 3))
        if len(near):
            rates[:, 2] += np.maximum(heights / h, -RECOVERY)
            rows = jacobians[near].reshape(-1, body.nv)
            spread = inverse @ rows.T
            guess = a * self.ground.forces(z)[near]
            found = self.solve(near, rows @ spread, rates[near].ravel(), guess.ravel())
            impulses[near] = found.reshape(-1, 3)
            acc = acc + spread @ (found / a)
        return HalfStep(acc, inverse, impulses)

    def second_half(self, half: HalfStep, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocities (nv,) and forces (c, 3) at a step's end, of q and the midpoint rule's v there."""
        forces = np.zeros_like(half.impulses)
        pressing = np.flatnonzero(half.impulses[:, 2] > 0.0)
        if len(pressing):
            _, jacobians = self.ground.places(self.body, q)
            rows = jacobians[pressing].reshape(-1, self.body.nv)
            spread = half.inverse @ rows.T
            inertia = rows @ spread
            before = 2.0 * half.impulses[pressing].ravel()
            found = self.solve(pressing, inertia, rows @ v - inertia @ before, before)
            v = v + spread @ (found - before)
            forces[pressing] = found.reshape(-1, 3) / self.h
        return v, forces

    def solve(
        self, which: np.ndarray, inertia: np.ndarray, free: np.ndarray, guess: np.ndarray
    ) -> np.ndarray:
        """Impulses (3 k,) [N s] of the k contacts of these numbers: inertia (3 k, 3 k), G [1/kg], and their
        velocities without impulses (3 k,) [m/s]."""
        key = tuple(which.tolist())
        if key not in self.solvers:
            frictions = [self.ground.contacts[k].friction for k in key]
            self.solvers[key] = Solver(self.ground.model, frictions)
        return self.solvers[key](inertia, free, guess)


class Solver:
    """Pinocchio's ADMM solver for contacts of these friction coefficients, its constraints built once."""

    def __init__(self, model: pin.Model, frictions: Sequence[float]) -> None:
        self.models, self.datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        for friction in frictions:
            # only its cone counts: where it touches is in G
            point = pin.PointContactConstraintModel(model, 0, pin.SE3.Identity(), 1, pin.SE3.Identity())
            point.setFriction(friction)
            self.models.append(pin.ConstraintModel(point))
            self.datas.append(self.models[len(self.models) - 1].createData())
        self.quick, self.plain = _settings(ITERATIONS, 10), _settings(PATIENCE, 0)
        self.solver = pin.ADMMConstraintSolver()

    def __call__(self, inertia: np.ndarray, free: np.ndarray, guess: np.ndarray) -> np.ndarray:
        for settings in (self.quick, self.plain):
            result = pin.ADMMSolverResult()
            result.setConstraintImpulseGuess(guess)
            delassus = pin.DelassusOperatorDense(inertia)
            if self.solver.solve(delassus, free, self.models, self.datas, settings, result):
                return np.array(result.retrieveConstraintImpulses())
        left = max(result.primal_feasibility, result.dual_feasibility, result.complementarity)
        if not left < ENOUGH:
            raise SimulationError(
                f"rigid ground: the contact solver is off by {left:.3g} after {PATIENCE} iterations, more"
                f" than {ENOUGH:g}; raise the physics rate, or use ground: compliant"
            )
        return np.array(result.retrieveConstraintImpulses())


def _settings(iterations: int, acceleration: int) -> pin.ADMMSolverSettings:
    settings = pin.ADMMSolverSettings()
    settings.max_iterations, settings.anderson_capacity = iterations, acceleration
    settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = TOLERANCE
    settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
    settings.admm_update_rule = pin.ADMMUpdateRule.SPECTRAL
    settings.solve_ncp = True
    return settings
