"""A robot at rest, compared with its static law."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import deflection, holding_torque
from flexjoint.simulation.trajectory import Trajectory


def assert_static_law(
    model: FlexibleJointModel,
    trajectory: Trajectory,
    theta_ref: np.ndarray,
    tau_ff: np.ndarray,
    kp: np.ndarray | None = None,
    seconds: float = 0.5,
    tolerance: float = 1e-3,
    still: float = 1e-3,
    joints: Sequence[str] | None = None,
) -> None:
    """Fail unless a robot under motor PD control rests, and rests where its load says.

    The load tau = g(q) - J_c' lambda is that of the rigid body and its contacts, the springs not asked. Then
    the motor is at theta_ref - (tau - tau_ff)/K_P and the link at that less the spring's deflection under tau
    (Kameduła et al. 2016, equations 1 to 4 at rest). Dry friction of motors, effects on the command
    and on sensors, and saturation are not in this law.

    Args:
        theta_ref, tau_ff: (n,) references that hold at the end [rad, N m].
        kp: (n,) gains [N m/rad]; default: the robot's.
        seconds: of the end, over which it is to be at rest; the last state is compared.
        tolerance: on link positions [rad]. still: how far a link may move in these seconds [rad].
        joints: default: all actuated ones; leave out wheels and others that are not held.

    Raises:
        AssertionError: which joints move, or rest elsewhere.
        FlexJointError: wrong shapes, or a trajectory shorter than that.
        UnknownNameError: a joint that does not exist.
    """
    __tracebackhide__ = True
    n = len(model.joints)
    gains = np.array([joint.kp for joint in model.joints]) if kp is None else np.asarray(kp, dtype=float)
    for label, values in (("theta_ref", theta_ref), ("tau_ff", tau_ff), ("kp", gains)):
        if np.shape(values) != (n,):
            raise FlexJointError(
                f"{label}: expected ({n},) numbers, one for each joint, got {np.shape(values)}"
            )
    names = model.robot.joint_names if joints is None else tuple(joints)
    chosen = [model.robot.joint_names.index(model.robot.joint(name).name) for name in names]
    begin = trajectory.time[-1] - seconds
    if begin < trajectory.time[trajectory.first] - 1e-9:
        raise FlexJointError(f"expected at least {seconds:g} s of motion; simulate longer or ask for less")
    rows = trajectory.time >= begin - 1e-9
    links = trajectory.q[:, [joint.idx_q for joint in model.joints]]
    moved = np.ptp(links[rows], axis=0)
    restless = [k for k in chosen if not moved[k] <= still]
    if restless:
        raise AssertionError(
            "\n".join(
                [
                    f"not at rest in the last {seconds:g} s (each may move {still:g} rad):",
                    *(f"  {model.joints[k].name} moves {moved[k]:.3g} rad" for k in restless),
                ]
            )
        )
    load = _load(model, trajectory)
    theta = np.asarray(theta_ref) - (load - np.asarray(tau_ff)) / gains
    lines = []
    for k in chosen:
        flow = model.flows[k]
        q = links[-1, k : k + 1]
        phi = 0.0 if flow.joint.rigid else float(deflection(flow, q, load[k : k + 1])[0])
        expected = float(theta[k]) - phi
        if not abs(q[0] - expected) <= tolerance:
            lines.append(
                f"  {flow.joint.name}: rests at {q[0]:.6g} rad, the law says {expected:.6g}"
                f" ({q[0] - expected:+.2e} rad; load {load[k]:.4g} N m)"
            )
    if lines:
        head = f"not where the static law says, to {tolerance:g} rad, in {len(lines)} joints:"
        raise AssertionError("\n".join([head, *lines]))


def _load(model: FlexibleJointModel, trajectory: Trajectory) -> np.ndarray:
    """(n,) torques that hold the links at the last state [N m], contacts in place."""
    q, v = trajectory.q[-1], trajectory.v[-1]
    load = np.array(holding_torque(model, q)[0])
    if model.ground is not None:
        touch = model.ground.touch(model.body, q, v, trajectory.z[-1])
        load -= np.asarray(touch.tau)[[joint.idx_v for joint in model.joints]]
    return load
