"""The TX40: rigid, motor encoder and current alone. Its README's numbers against its recording."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
from scipy.ndimage import gaussian_filter1d

from flexjoint.recording import table as recording
from flexjoint.recording.checks import check
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, load, robots_folder

FOLDER = robots_folder() / "tx40"
PERIOD, WIDTH = 1e-3, 12  # s; samples of the Gaussian filter of the README
DRY = np.array([7.14, 8.26, 6.34, 2.48, 3.03, 0.28])  # N m, published
VISCOUS = np.array([8.05, 5.53, 1.97, 1.11, 1.86, 0.65])  # N m s/rad
SHARED_DRY, SHARED_VISCOUS = 1.95, 0.62  # of motor 6, on the sum of the velocities of joints 5 and 6
SLOW = 0.01  # rad/s over which the sign of dry friction is smoothed


@cache
def robot() -> Robot:
    return load("tx40")


@cache
def read() -> Recording:
    return recording.read(FOLDER / "recordings" / "rec.parquet")


def test_it_is_rigid_and_reads_motors_alone() -> None:
    assert all(joint.rigid for joint in robot().joints) and robot().effects == ()
    (coupling,) = robot().couplings
    assert (coupling.joints, coupling.matrix) == ((4, 5), ((1.0, 0.0), (1.0, 1.0)))
    assert {channel for channel, _ in read().columns} == {"theta", "tau_motor"}
    assert read().joints == robot().joint_names and read().notes == ()
    assert (FOLDER / "LICENSE-DATA").read_text(encoding="utf-8").count("Apache License") >= 2
    check(robot(), read())


def test_the_motors_give_what_the_body_and_the_published_friction_take() -> None:
    theta, tau = (
        np.stack([read().get(channel, name) for name in robot().joint_names], axis=1)
        for channel in ("theta", "tau_motor")
    )
    q, v, a = (gaussian_filter1d(theta, WIDTH, axis=0, order=k) / PERIOD**k for k in range(3))
    model = robot().model
    data = model.createData()
    turns = np.eye(6)
    turns[5, 4] = 1.0  # motor 6 turns with joints 5 and 6
    rotors = turns.T @ np.diag([float(joint.drive.B) for joint in robot().joints]) @ turns
    body = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]) + a @ rotors
    friction = DRY * np.tanh(v / SLOW) + VISCOUS * v
    both = v[:, 4:].sum(axis=1)
    friction[:, 4:] += (SHARED_DRY * np.tanh(both / SLOW) + SHARED_VISCOUS * both)[:, np.newaxis]
    measured = gaussian_filter1d(tau, WIDTH, axis=0)
    for i in range(6):
        # 0.978 to 0.992; without the friction 0.05 to 0.71
        assert np.corrcoef(body[:, i] + friction[:, i], measured[:, i])[0, 1] > 0.97
