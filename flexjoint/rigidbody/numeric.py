"""Rigid-body algorithms of a pin.Model on numbers.

One convention throughout: the forces of `rnea`, the inverse of `aba`, and `mass_matrix` all hold the
model's own rotor armature (pin.Model.armature) on their diagonal, as Pinocchio 4 does; `regressor` does
not, for armature is no inertial parameter of a body.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import ModelError, unknown


class PinBody:
    """Pinocchio on a private copy of a model. Floats in, fresh arrays out.

    q is (nq,), v, a and tau are (nv,), in Pinocchio's order; SI and radians. An object holds work space:
    use one per thread.

    Args:
        model: copied; never written on.
        inertial: (njoints - 1, 10) inertial parameters that replace the model's: m, m c, Ixx, Ixy, Iyy,
            Ixz, Iyz, Izz about the joint frame's origin (Pinocchio's order of dynamic parameters).
        gravity: (3,) linear gravity in base axes that replaces the model's [m/s^2].

    Raises:
        ModelError: wrong shapes, not finite, a mass of 0 with a first moment, a mimic joint (Pinocchio's
            articulated-body algorithm, derivatives and regressor refuse it), or joints that were not added
            branch by branch (Pinocchio's mass matrix and derivatives are silently wrong then).
    """

    symbolic: ClassVar[bool] = False

    def __init__(
        self, model: pin.Model, inertial: np.ndarray | None = None, gravity: np.ndarray | None = None
    ) -> None:
        refuse_mimic(model)
        _refuse_interleaved_branches(model)
        self._model = model.copy()
        if inertial is not None:
            for index, row in enumerate(checked_inertial(model, inertial)):
                self._model.inertias[index + 1] = _inertia(row, model.names[index + 1])
        if gravity is not None:
            self._model.gravity.linear = checked_gravity(gravity)
        self._data = self._model.createData()
        # aba works on a copy of its own, whose armature changes with every call: the other methods never
        # see it, and nothing has to be put back
        self._stepped = self._model.copy()
        self._stepped_data = self._stepped.createData()
        self._stepped_armature = self._stepped.armature
        self._frames = frames_by_name(self._model)
        self.nq: int = self._model.nq
        self.nv: int = self._model.nv
        self.neutral: np.ndarray = read_only(pin.neutral(self._model))
        self.armature: np.ndarray = read_only(self._model.armature)
        self.inertial: np.ndarray = read_only(inertial_of(self._model))
        self.gravity: np.ndarray = read_only(self._model.gravity.linear)

    def __reduce__(self) -> tuple[type[PinBody], tuple[pin.Model]]:
        """Pickle and copy by building anew: a copied view of the armature would no longer be one."""
        return PinBody, (self._model,)

    # ------------------------------------------------------------------ dynamics

    def aba(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, armature: np.ndarray) -> np.ndarray:
        """Acceleration (nv,) under the joint forces tau; armature (nv,) is added to the model's own."""
        np.add(self.armature, armature, self._stepped_armature)
        return pin.aba(self._stepped, self._stepped_data, q, v, tau)

    def inverse_mass_matrix(self, q: np.ndarray, armature: np.ndarray) -> np.ndarray:
        """(nv, nv), symmetric: d aba / dtau; armature (nv,) is added to the model's own."""
        np.add(self.armature, armature, self._stepped_armature)
        return pin.computeMinverse(self._stepped, self._stepped_data, q)

    def rnea(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Joint forces (nv,) of the acceleration a."""
        return pin.rnea(self._model, self._data, q, v, a)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """(nv, nv), symmetric."""
        return pin.crba(self._model, self._data, q)

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """Joint forces (nv,) that hold q at rest."""
        return pin.computeGeneralizedGravity(self._model, self._data, q)

    def nle(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Coriolis, centrifugal and gravity forces (nv,)."""
        return pin.nonLinearEffects(self._model, self._data, q, v)

    def regressor(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(nv, 10 (njoints - 1)): times the stacked inertial parameters it gives rnea without the
        armature's share."""
        # a model with one degree of freedom gets a vector from Pinocchio's Python layer
        return pin.computeJointTorqueRegressor(self._model, self._data, q, v, a).reshape(self.nv, -1)

    def rnea_derivatives(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """d rnea / dq, d rnea / dv and the mass matrix, each (nv, nv); dq in the tangent space."""
        return _copies(pin.computeRNEADerivatives(self._model, self._data, q, v, a))

    def aba_derivatives(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, armature: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """d aba / dq, d aba / dv and d aba / dtau, each (nv, nv); dq in the tangent space."""
        np.add(self.armature, armature, self._stepped_armature)
        return _copies(pin.computeABADerivatives(self._stepped, self._stepped_data, q, v, tau))

    # ------------------------------------------------------------------ kinematics

    def integrate(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """Configuration (nq,) after a unit time at the velocity dv (nv,); q + dv where joints are vectors
        (Pinocchio's is as quick as NumPy's sum there)."""
        return pin.integrate(self._model, q, dv)

    def difference(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        """The velocity (nv,) that leads from q0 to q1 in a unit time."""
        return pin.difference(self._model, q0, q1)

    def integrate_slope(self, q: np.ndarray, dv: np.ndarray) -> np.ndarray:
        """(nv, nv) change of `integrate(q, dv)`, in its tangent space, by dv."""
        return np.array(pin.dIntegrate(self._model, q, dv, pin.ARG1))

    def frame_placement(self, q: np.ndarray, frame: str) -> np.ndarray:
        """(4, 4) homogeneous placement of a frame in the base."""
        index = find_frame(self._frames, frame)
        pin.forwardKinematics(self._model, self._data, q)
        return np.array(pin.updateFramePlacement(self._model, self._data, index).homogeneous)

    def frame_jacobian(self, q: np.ndarray, frame: str) -> np.ndarray:
        """(6, nv), linear part first, of the frame's origin along base axes (LOCAL_WORLD_ALIGNED)."""
        index = find_frame(self._frames, frame)
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, index, pin.LOCAL_WORLD_ALIGNED)
        return jacobian.reshape(6, self.nv)

    def frame_motions(self, q: np.ndarray, frames: Sequence[str]) -> list[tuple[np.ndarray, np.ndarray]]:
        """frame_placement and frame_jacobian of several frames, in one pass."""
        model, data, indices = self._model, self._data, self._frames
        pin.computeJointJacobians(model, data, q)
        out = []
        for name in frames:
            index = find_frame(indices, name)
            placement = np.array(pin.updateFramePlacement(model, data, index).homogeneous)
            jacobian = pin.getFrameJacobian(model, data, index, pin.LOCAL_WORLD_ALIGNED)
            out.append((placement, jacobian.reshape(6, self.nv)))
        return out

    def center_of_mass(self, q: np.ndarray) -> np.ndarray:
        """(3,) in the base, of the moving bodies: what is fixed to the base does not count."""
        return pin.centerOfMass(self._model, self._data, q)

    def energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """Kinetic and potential energy of the moving bodies [J], the model's own armature included; the
        potential is 0 with all of them at the origin."""
        kinetic = 0.5 * float(v @ self.mass_matrix(q) @ v)
        return kinetic + float(pin.computePotentialEnergy(self._model, self._data, q))

    @cached_property
    def _bare(self) -> pin.Model:
        """The model without armature."""
        model = self._model.copy()
        model.armature = np.zeros(self.nv)
        return model

    def totals(self, q: np.ndarray, v: np.ndarray, whole: bool) -> list[float]:
        """Of all moving bodies: kinetic energy [J], the model's own armature included, and first moment of
        mass (3) in the base [kg m]. Where `whole`, also momentum (3) [kg m/s], angular momentum (3)
        [kg m^2/s] and inertia xx, xy, yy, xz, yz, zz [kg m^2] about the common centre of mass, in base axes,
        and mass [kg]."""
        model, data = self._model, self._data
        # Pinocchio's kinetic energy leaves out the armature of some types of joints
        kinetic = float(pin.computeKineticEnergy(self._bare, data, q, v)) + 0.5 * float(
            self.armature @ (v * v)
        )
        if not whole:
            moment = pin.computeTotalMass(model) * pin.centerOfMass(model, data, q, False)
            return [kinetic, *moment.tolist()]
        pin.ccrba(model, data, q, v)
        moment = data.Ig.mass * data.com[0]
        inertia = data.Ig.inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        momentum = data.hg.vector
        return [kinetic, *moment.tolist(), *momentum.tolist(), *inertia.tolist(), float(data.Ig.mass)]

    # ------------------------------------------------------------------ trajectories of N rows

    def rnea_batch(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(N, nv) of q (N, nq), v and a (N, nv)."""
        out = np.empty((_rows(q, v, a), self.nv))
        for k in range(len(out)):
            out[k] = pin.rnea(self._model, self._data, q[k], v[k], a[k])
        return out

    def gravity_torque_batch(self, q: np.ndarray) -> np.ndarray:
        """(N, nv) of q (N, nq), as gravity_torque."""
        out = np.empty((len(q), self.nv))
        for k, row in enumerate(q):
            out[k] = pin.computeGeneralizedGravity(self._model, self._data, row)
        return out

    def frame_jacobians_batch(self, q: np.ndarray, frames: Sequence[str]) -> np.ndarray:
        """(N, len(frames), 6, nv) of q (N, nq), as frame_jacobian."""
        indices = [find_frame(self._frames, frame) for frame in frames]
        model, data = self._model, self._data
        out = np.empty((len(q), len(frames), 6, self.nv))
        for k, row in enumerate(q):
            pin.computeJointJacobians(model, data, row)
            for i, index in enumerate(indices):
                pin.updateFramePlacement(model, data, index)
                jacobian = pin.getFrameJacobian(model, data, index, pin.LOCAL_WORLD_ALIGNED)
                out[k, i] = jacobian.reshape(6, self.nv)
        return out

    def rnea_derivatives_batch(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Three (N, nv, nv), as rnea_derivatives."""
        rows = _rows(q, v, a)
        dq, dv, mass = (np.empty((rows, self.nv, self.nv)) for _ in range(3))
        for k in range(rows):
            dq[k], dv[k], mass[k] = pin.computeRNEADerivatives(self._model, self._data, q[k], v[k], a[k])
        return dq, dv, mass

    def regressor_batch(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(N, nv, 10 (njoints - 1)), as regressor."""
        out = np.empty((_rows(q, v, a), self.nv, 10 * len(self.inertial)))
        for k in range(len(out)):
            out[k] = pin.computeJointTorqueRegressor(self._model, self._data, q[k], v[k], a[k])
        return out


def read_only(values: np.ndarray) -> np.ndarray:
    """A copy that refuses to be written on."""
    copy = np.array(values)
    copy.setflags(write=False)
    return copy


def inertial_of(model: pin.Model) -> np.ndarray:
    """(njoints - 1, 10) inertial parameters of a model's moving bodies, in Pinocchio's order."""
    rows = [inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]]
    return np.array(rows).reshape(model.njoints - 1, 10)


def checked_inertial(model: pin.Model, inertial: np.ndarray) -> np.ndarray:
    """A float copy of (njoints - 1, 10) inertial parameters; raises ModelError otherwise."""
    values = np.array(inertial, dtype=float)
    if values.shape != (model.njoints - 1, 10):
        raise ModelError(
            f"inertial: expected one row of 10 parameters per moving body, shape {(model.njoints - 1, 10)}, "
            f"got {values.shape}"
        )
    if not np.all(np.isfinite(values)):
        raise ModelError("inertial: expected finite numbers, got NaN or infinity; check their source")
    return values


def checked_gravity(gravity: np.ndarray) -> np.ndarray:
    """A float copy of (3,) gravity; raises ModelError otherwise."""
    values = np.array(gravity, dtype=float)
    if values.shape != (3,) or not np.all(np.isfinite(values)):
        raise ModelError(f"gravity: expected 3 finite numbers along the base axes [m/s^2], got {gravity!r}")
    return values


def refuse_mimic(model: pin.Model) -> None:
    """Raises ModelError that names the first mimic joint: Pinocchio has no forward dynamics for them."""
    for index in model.mimicking_joints:
        raise ModelError(
            f"joint {model.names[index]!r} has type {model.joints[index].shortname()}, which forward "
            "dynamics does not support; load the URDF without mimic=True, or lock the joint"
        )


def _refuse_interleaved_branches(model: pin.Model) -> None:
    """Raises ModelError unless every joint's subtree has consecutive indices, as any URDF gives."""
    for index in range(1, model.njoints):
        joints = list(model.subtrees[index])
        if joints != list(range(index, index + len(joints))):
            raise ModelError(
                f"the joints carried by {model.names[index]!r} are not consecutive: add the joints of one "
                "branch of the tree before those of the next"
            )


def frames_by_name(model: pin.Model) -> dict[str, list[int]]:
    """The indices of a model's frames by their names; a joint and a link may share one."""
    frames: dict[str, list[int]] = {}
    for index, frame in enumerate(model.frames):
        frames.setdefault(str(frame.name), []).append(index)
    return frames


def find_frame(frames: dict[str, list[int]], name: str) -> int:
    """Index of the frame of that name; raises UnknownNameError, or ModelError where several share it."""
    found = frames.get(name)
    if found is None:
        raise unknown("frame", name, frames)
    if len(found) > 1:
        raise ModelError(
            f"expected one frame called {name!r}, got {len(found)}; rename the others in the URDF"
        )
    return found[0]


def _inertia(parameters: np.ndarray, joint: str) -> pin.Inertia:
    """A body's inertia. Pinocchio divides by the mass, so a body without one is written directly."""
    if parameters[0] != 0.0:
        return pin.Inertia.FromDynamicParameters(parameters)
    if np.any(parameters[1:4] != 0.0):
        raise ModelError(
            f"inertial: the body of joint {joint!r} has mass 0 but a first moment m c; set it to 0"
        )
    xx, xy, yy, xz, yz, zz = parameters[4:]
    return pin.Inertia(0.0, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


def _rows(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> int:
    """The length N that the three trajectories share."""
    if not len(q) == len(v) == len(a):
        raise ModelError(f"q, v and a: expected as many rows in each, got {len(q)}, {len(v)} and {len(a)}")
    return len(q)


def _copies(views: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pinocchio's derivatives are views of its work space, which the next call overwrites."""
    first, second, third = (np.array(view, order="C") for view in views)
    return first, second, third
