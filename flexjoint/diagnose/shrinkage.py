"""Noise that the columns of nominal numbers share with the residual.

Columns are taken on a denoised recording. The denoising keeps noise where motion is loud, and that noise is
the residual's own: a fit would be drawn towards numbers under which noise becomes less (errors in variables;
Fuller 1987, section 2.2). How much is known beforehand, and taken out of the normal equations.
"""

from __future__ import annotations

import numpy as np

from flexjoint.body import PinBody
from flexjoint.diagnose.balances import LINK, MOTOR, SPRING, Balances
from flexjoint.diagnose.motion import Motion, whole_motion
from flexjoint.diagnose.nuisance import NUMBERS, Nuisance, inertial_directions
from flexjoint.diagnose.signals import kept_share
from flexjoint.diagnose.whitening import Whitening, sensitivity

POSES = 32  # of the recording, over which the mass matrix is averaged


def shared_noise(balances: Balances, whitening: Whitening, nuisance: list[Nuisance]) -> np.ndarray:
    """(numbers, rows) expected product, per sample, of a number's white column and the residual's noise."""
    motion, n = balances.motion, len(balances.motion.robot.joints)
    omega = balances.filter.omega[: whitening.taper.size]
    gain = balances.filter.gain[: whitening.taper.size]
    transfer, variances, _ = sensitivity(balances, omega, ())
    passed = np.zeros((omega.size, 4 * n))  # what noise has in the denoised positions, of its variance
    missing = set(motion.missing)
    for c, name in enumerate(("q", "theta")):
        noise, signals = motion.readings.noise[name], getattr(motion.readings, name)
        for i in range(n):
            if (name, i) not in missing and np.isfinite(signals[i, 0]):
                frequency, share = kept_share(signals[i], noise[i], motion.readings.period)
                passed[:, c * n + i] = variances[c * n + i] * np.interp(omega, 2 * np.pi * frequency, share)
    weight = (whitening.taper * gain) ** 2
    white = np.einsum("fab,fbk->fak", whitening.matrix, transfer)  # of the residual's noise
    out = np.zeros((len(nuisance), len(balances.rows)))
    for k, change in enumerate(_changes(balances, nuisance, omega)):
        if change is None:
            continue
        column = np.einsum("fab,fbk->fak", whitening.matrix, change)
        out[k] = np.einsum("fak,fk,fak,f->a", column, passed, white.conj(), weight).real
    return out / np.sum(whitening.taper**2)


def _changes(balances: Balances, nuisance: list[Nuisance], omega: np.ndarray) -> list[np.ndarray | None]:
    """(F, rows, channels) change of the balances' sensitivity to readings by one deviation of each number;
    None where a number changes none."""
    motion, robot = balances.motion, balances.motion.robot
    n, s = len(robot.joints), 1j * omega
    row = {(r.balance, r.joint): k for k, r in enumerate(balances.rows)}
    regressor = _mass_regressor(motion) if any(x.name == "inertial" for x in nuisance) else np.zeros(0)
    seen: dict[str, int] = {}
    out: list[np.ndarray | None] = []
    for number in nuisance:
        if number.joint is None or number.name not in (*NUMBERS, "inertial"):
            out.append(None)
            continue
        i = robot.joint_names.index(number.joint)
        change = np.zeros((omega.size, len(row), 4 * n), dtype=complex)
        drive = robot.joints[i].drive
        if number.name == "inertial":
            direction = inertial_directions(motion.rigid.inertial[i], number.spread)[
                seen.get(number.joint, 0)
            ]
            seen[number.joint] = seen.get(number.joint, 0) + 1
            mass = regressor[:, :, 10 * i : 10 * i + 10] @ direction  # (n accelerated, n torques)
            for j, joint in enumerate(robot.joints):
                at = row.get((MOTOR if joint.rigid else LINK, j))
                if at is not None:
                    for k, moved in enumerate(robot.joints):
                        change[:, at, n + k if moved.rigid else k] -= mass[k, j] * s**2
        elif number.name in ("motor_inertia", "motor_damping"):
            shaft = drive.B * s**2 if number.name == "motor_inertia" else drive.D_m * s
            if (MOTOR, i) in row:
                change[:, row[MOTOR, i], n + i] = -number.spread * shaft
        else:
            spring = number.spread * (drive.K if number.name == "spring_stiffness" else drive.D * s)
            for balance, sign in ((MOTOR, -1.0), (LINK, 1.0), (SPRING, -1.0)):
                if (balance, i) in row:
                    change[:, row[balance, i], n + i] = sign * spring
                    change[:, row[balance, i], i] = -sign * spring
        out.append(change)
    return out


def _mass_regressor(motion: Motion) -> np.ndarray:
    """(n, n, 10 n): torques of all joints by the links' inertial parameters, per acceleration of each joint;
    mean over poses of the recording."""
    robot = motion.robot
    at, _, _ = whole_motion(robot, motion.filter, motion.q, motion.passive, 1.0)
    used = np.flatnonzero(motion.readings.valid)
    at = at[used[np.linspace(0, used.size - 1, min(POSES, used.size)).astype(int)]]
    body, still = PinBody(robot.model, gravity=np.zeros(3)), np.zeros((len(at), robot.model.nv))
    rows = np.array([joint.idx_v for joint in robot.joints])
    bodies = np.concatenate([10 * (joint.pin_id - 1) + np.arange(10) for joint in robot.joints])
    out = []
    for row in rows:
        turn = still.copy()
        turn[:, row] = 1.0
        out.append(body.regressor_batch(at, still, turn).mean(axis=0)[np.ix_(rows, bodies)])
    return np.array(out)
