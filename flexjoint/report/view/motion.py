"""What is shown of a robot over time: link and motor positions, spring torques, contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import FlexJointError
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

if TYPE_CHECKING:
    from flexjoint.simulation.simulate import Simulation


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contact points (N, c, 3) [m] and the forces on the robot there (N, c, 3) [N], in the world; NaN or 0
    where there is no contact."""

    points: np.ndarray
    forces: np.ndarray


@dataclass(frozen=True, eq=False)
class Motion:
    """A robot over time (N,) [s]: q (N, nq) in Pinocchio's order; theta (N, n) [rad] and tau_t (N, n) [N m]
    of the actuated joints, None where they are not known."""

    robot: Robot
    label: str
    time: np.ndarray
    q: np.ndarray
    theta: np.ndarray | None = None
    tau_t: np.ndarray | None = None
    contacts: Contacts | None = None

    @property
    def links(self) -> np.ndarray:
        """(N, n) link positions of the actuated joints."""
        return self.q[:, [joint.idx_q for joint in self.robot.joints]]

    def with_contacts(self, points: np.ndarray, forces: np.ndarray) -> Motion:
        """The motion with contact points [m] and forces [N], each (N, c, 3) in the world.

        Raises FlexJointError on other shapes.
        """
        points, forces = np.asarray(points, dtype=float), np.asarray(forces, dtype=float)
        if points.ndim != 3 or points.shape != forces.shape or points.shape[::2] != (len(self.time), 3):
            raise FlexJointError(
                f"contacts: expected points and forces of shape ({len(self.time)}, c, 3), got {points.shape}"
                f" and {forces.shape}"
            )
        return replace(self, contacts=Contacts(points, forces))

    def at(self, time: np.ndarray) -> Motion:
        """The motion at other times, interpolated linearly (a base along its shortest turn)."""
        if len(self.time) == 1:
            return self
        place = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        share = np.clip((time - self.time[place]) / (self.time[place + 1] - self.time[place]), 0.0, 1.0)

        def blend(values: np.ndarray) -> np.ndarray:
            part = share.reshape(-1, *[1] * (values.ndim - 1))
            return (1.0 - part) * values[place] + part * values[place + 1]

        model = self.robot.model
        if model.nq == model.nv:
            q = blend(self.q)
        else:
            rows = zip(place, share, strict=True)
            q = np.array([pin.interpolate(model, self.q[k], self.q[k + 1], float(s)) for k, s in rows])
        theta = None if self.theta is None else blend(self.theta)
        tau_t = None if self.tau_t is None else blend(self.tau_t)
        contacts = self.contacts and Contacts(blend(self.contacts.points), blend(self.contacts.forces))
        return Motion(self.robot, self.label, time, q, theta, tau_t, contacts)


def still(
    robot: Robot, q: np.ndarray | None = None, theta: np.ndarray | None = None, label: str | None = None
) -> Motion:
    """A robot at rest at q (nq,) [rad], by default its `initial` pose with its contacts on the ground; theta
    (n,) [rad] of the actuated joints, by default that of the static law where the base is fixed.

    Raises FlexJointError for positions of another size."""
    if q is None:
        q = on_ground(robot, robot.configuration())
    q = np.asarray(q, dtype=float)
    if q.shape != (robot.model.nq,):
        raise FlexJointError(f"q: expected ({robot.model.nq},) positions of {robot.name}, got {q.shape}")
    if theta is None and not robot.floating and robot.joints:
        from flexjoint.model.dynamics import FlexibleJointModel
        from flexjoint.model.statics.equilibrium import equilibrium

        theta = equilibrium(FlexibleJointModel(robot), q).theta[0]
    motors = None if theta is None else np.asarray(theta, dtype=float).reshape(1, -1)
    if motors is not None and motors.shape[1] != len(robot.joints):
        raise FlexJointError(
            f"theta: expected ({len(robot.joints)},) motor positions, got {motors.shape[1]} of them"
        )
    return with_torque(Motion(robot, label or robot.name, np.zeros(1), q[None], motors))


def from_recording(
    robot: Robot, recording: Recording, label: str | None = None, base: np.ndarray | None = None
) -> Motion:
    """The motion of a recording: links from q (from theta, or `initial`, where it was not measured), motors
    from theta, springs from tau_t or else K (theta - q). Samples that are missing are interpolated.

    `base` (N, 7) places a floating base (position, quaternion x y z w); else it stands still on its contacts.
    Raises FlexJointError when the recording holds no position of any joint of the robot.
    """
    given = {key: _whole(recording.time, values) for key, values in recording.columns.items()}
    joints = robot.joints
    if not any((channel, joint.name) in given for channel in ("q", "theta") for joint in joints):
        raise FlexJointError(
            f"{recording.name}: no q or theta of any joint of {robot.name}; its joints are"
            f" {', '.join(robot.joint_names)}"
        )
    q = np.tile(robot.configuration(), (len(recording.time), 1))
    for name in robot.model.names:
        if ("q", name) in given and robot.model.existJointName(name):
            q[:, robot.model.joints[robot.model.getJointId(name)].idx_q] = given["q", name]
    for joint in joints:
        if ("q", joint.name) not in given and ("theta", joint.name) in given:
            q[:, joint.idx_q] = given["theta", joint.name]
    if base is not None:
        if not robot.floating or np.shape(base) != (len(q), 7):
            expected = f"({len(q)}, 7)" if robot.floating else f"none, for {robot.name} is fixed"
            raise FlexJointError(f"base: expected {expected}, got shape {np.shape(base)}")
        q[:, :7] = base
    elif robot.floating:
        q[:, :7] = on_ground(robot, q[0])[:7]
    links = q[:, [joint.idx_q for joint in joints]]
    theta = _columns(given, "theta", robot.joint_names, links)
    tau = _columns(given, "tau_t", robot.joint_names, np.full_like(links, np.nan))
    return with_torque(Motion(robot, label or recording.name, recording.time, q, theta, tau))


def from_simulation(robot: Robot, run: Simulation, label: str | None = None) -> Motion:
    """The true motion of `flexjoint.simulation.simulate.simulate`, its base included."""
    rows = np.searchsorted(run.trajectory.time - run.trajectory.time[run.trajectory.first], _since(run))
    base = run.trajectory.q[np.clip(rows, 0, len(run.trajectory.q) - 1)]
    moved = from_recording(robot, run.true, label, base[:, :7] if robot.floating else None)
    return replace(moved, q=base)


def _since(run: Simulation) -> np.ndarray:
    return run.true.time - run.true.time[0] - 1e-9


def contact_frames(robot: Robot) -> tuple[str, ...]:
    """Frames of the robot file's `contacts` that are there."""
    return tuple(entry.frame for entry in robot.file.contacts if robot.model.existFrame(entry.frame))


def contact_points(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(N, c, 3) where the contact frames are [m] at q (N, nq)."""
    model, frames = robot.model, contact_frames(robot)
    data, ids = model.createData(), [robot.model.getFrameId(name) for name in frames]
    out = np.empty((len(q), len(ids), 3))
    for k, row in enumerate(q):
        pin.framesForwardKinematics(model, data, row)
        out[k] = [data.oMf[i].translation for i in ids]
    return out


def on_ground(robot: Robot, q: np.ndarray) -> np.ndarray:
    """q (nq,) with a floating base lifted so that its lowest contact frame is at height 0."""
    q = np.array(q, dtype=float)
    if robot.floating and contact_frames(robot):
        q[2] -= float(contact_points(robot, q[None])[0, :, 2].min())
    return q


def posed(robot: Robot, pose: str, label: str | None = None) -> Motion:
    """A robot in a pose of its file, standing on its contacts."""
    return still(robot, on_ground(robot, robot.configuration(pose)), label=label or f"{robot.name}: {pose}")


def with_torque(motion: Motion) -> Motion:
    """Spring torques by K (theta - q) where they were not measured; 0 of rigid joints."""
    if motion.theta is None:
        return motion
    stiffness = np.array([0.0 if joint.rigid else joint.drive.K for joint in motion.robot.joints])
    spring = stiffness * (motion.theta - motion.links)
    known = motion.tau_t if motion.tau_t is not None else np.full_like(spring, np.nan)
    return replace(motion, tau_t=np.where(np.isfinite(known), known, spring))


def _whole(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    return values if np.all(known) else np.interp(time, time[known], values[known])


def _columns(
    given: Mapping[tuple[str, str], np.ndarray], channel: str, names: Sequence[str], default: np.ndarray
) -> np.ndarray | None:
    """(N, n) of a channel, joints without it as in `default`; None where no joint has it."""
    if not any((channel, name) in given for name in names):
        return None
    columns: list[Any] = [given.get((channel, name), default[:, k]) for k, name in enumerate(names)]
    return np.stack(columns, axis=1)


def check(motions: Sequence[Motion]) -> None:
    """Raises FlexJointError unless there is something to show and its numbers are finite."""
    if not motions:
        raise FlexJointError("nothing to show: give at least one motion")
    for motion in motions:
        rows, joints = len(motion.time), len(motion.robot.joints)
        for name, values, width in (
            ("q", motion.q, motion.robot.model.nq),
            ("theta", motion.theta, joints),
            ("tau_t", motion.tau_t, joints),
        ):
            if values is None:
                continue
            if np.shape(values) != (rows, width):
                raise FlexJointError(
                    f"{motion.label}: expected {name} of shape ({rows}, {width}), got {np.shape(values)}"
                )
            if not np.all(np.isfinite(values)):
                raise FlexJointError(f"{motion.label}: {name} is not finite everywhere; it cannot be shown")
        if rows > 1 and not np.all(np.diff(motion.time) > 0.0):
            raise FlexJointError(f"{motion.label}: its times do not increase strictly; sort them")
