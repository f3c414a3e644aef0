"""Reference trajectories: Fourier series that grow from rest and die down to it (Swevers et al. 1997).

Each joint moves as a slow wave, for sticking, reversals and cables, on which a fast one rides for a part of
the time, for inertias, springs and delays. Amplitudes are what the limits leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.diagnosis.followup.experiment.limits import Limits
from flexjoint.diagnosis.settings import USUAL
from flexjoint.recording.table import Recording, make
from flexjoint.rigidbody.numeric import PinBody
from flexjoint.robot.robot import Robot

RAMP = 1.0  # s over which the motion grows from rest, and dies down
SLOW_BAND = (0.05, 0.35)  # Hz
FAST_BAND = (0.4, 3.0)  # Hz
SLOW_LINES, FAST_LINES = 4, 8
GRID = 100.0  # Hz, at which demands are checked
SHRINK, ROUNDS = 0.92, 80
TIMID_SIZE = 0.15
OVERSHOOT = 0.02  # rad or, where less, a tenth of the room, that a position is kept from its limit

Array = np.ndarray


@dataclass(frozen=True)
class Wave:
    """The motion of one joint, its amplitude aside. Frequencies [Hz], phases [rad]; the fast part has the
    weight `fast` in place of the slow one, from the share `begins` of the duration to the share `ends`."""

    slow_frequencies: Array
    slow_phases: Array
    fast_frequencies: Array
    fast_phases: Array
    fast: float
    begins: float
    ends: float
    size: float  # share of the amplitude that the limits leave
    shift: float  # of the centre, as a share of the room


def drawn(joints: int, random: np.random.Generator) -> tuple[Wave, ...]:
    """Waves of all joints at random."""
    waves = []
    for _ in range(joints):
        slow, fast = (
            np.sort(low * (high / low) ** random.random(lines))
            for (low, high), lines in ((SLOW_BAND, SLOW_LINES), (FAST_BAND, FAST_LINES))
        )
        begins = float(random.choice([0.0, 0.4]))
        waves.append(
            Wave(
                slow,
                random.uniform(0, 2 * np.pi, SLOW_LINES),
                fast,
                random.uniform(0, 2 * np.pi, FAST_LINES),
                float(random.choice([0.3, 0.6, 1.0])),
                begins,
                1.0 if begins else float(random.choice([0.6, 1.0])),
                float(random.uniform(0.6, 1.0)),
                float(random.uniform(-0.3, 0.3)),
            )
        )
    return tuple(waves)


def timid(waves: Sequence[Wave]) -> tuple[Wave, ...]:
    """The slow part of waves alone, and little of it: a motion in which causes look alike."""
    return tuple(replace(wave, fast=0.0, size=TIMID_SIZE) for wave in waves)


def varied(waves: Sequence[Wave], random: np.random.Generator) -> tuple[Wave, ...]:
    """Waves near given ones: each joint keeps its lines and changes its weights, or draws new lines."""
    fresh = drawn(len(waves), random)
    out = []
    for old, new in zip(waves, fresh, strict=True):
        if random.random() < 0.5:
            out.append(replace(new, fast=old.fast, begins=old.begins, ends=old.ends, size=old.size))
        else:
            weight = float(np.clip(old.fast * np.exp(random.normal(0.0, 0.4)), 0.1, 1.0))
            size = float(np.clip(old.size + random.normal(0.0, 0.2), 0.4, 1.0))
            out.append(replace(old, fast=weight, size=size, shift=new.shift))
    return tuple(out)


def reference(robot: Robot, waves: Sequence[Wave], limits: Limits) -> Recording:
    """q_ref of every actuated joint at f_c [Hz], from rest to rest, within the limits: positions and speeds
    keep to them, and so does the motor torque that rigid inverse dynamics ask for."""
    rate = robot.rates.control
    coarse = np.arange(round(limits.seconds * GRID) + 1) / GRID
    shapes = np.stack([_shape(wave, coarse, limits.seconds) for wave in waves], axis=1)
    peaks = np.maximum(np.max(np.abs(shapes), axis=0), 1e-9)
    shapes = shapes / peaks
    centre, amplitude = _placed(waves, limits)
    peak_speed = np.max(np.abs(np.gradient(shapes, coarse, axis=0)), axis=0)
    amplitude = np.minimum(amplitude, USUAL.plan.margin * limits.speed / np.maximum(peak_speed, 1e-9))
    for _ in range(ROUNDS):
        demand = _torque(robot, centre + amplitude * shapes, coarse)
        over = np.max(np.abs(demand), axis=0) > USUAL.plan.margin * limits.torque
        if not np.any(over):
            break
        amplitude = np.where(over, SHRINK * amplitude, amplitude)
        centre = np.where(over, limits.centre + SHRINK * (centre - limits.centre), centre)
    time = np.arange(round(limits.seconds * rate) + 1) / rate
    columns = {
        ("q_ref", joint.name): centre[i] + amplitude[i] / peaks[i] * _shape(waves[i], time, limits.seconds)
        for i, joint in enumerate(robot.joints)
    }
    return make(time, columns, f"planned motion of {robot.name}")


def _shape(wave: Wave, time: Array, seconds: float) -> Array:
    """(N,) a motion that begins and ends at rest, of a size that the caller sets."""

    def series(frequencies: Array, phases: Array) -> Array:
        # lines of equal speed: the slow ones are the large ones
        lines = np.sin(2 * np.pi * np.multiply.outer(time, frequencies) + phases) / frequencies
        total: Array = lines.sum(axis=1)
        return total / np.sum(1.0 / frequencies)

    gate = _rise((time - wave.begins * seconds) / RAMP) * _rise((wave.ends * seconds - time) / RAMP)
    slow, fast = (
        series(wave.slow_frequencies, wave.slow_phases),
        series(wave.fast_frequencies, wave.fast_phases),
    )
    window = _rise(time / RAMP) * _rise((seconds - time) / RAMP)
    return window * ((1.0 - wave.fast) * slow + wave.fast * gate * fast)


def _rise(s: Array) -> Array:
    """0 to 1 without a jump in velocity or acceleration (minimum jerk)."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _placed(waves: Sequence[Wave], limits: Limits) -> tuple[Array, Array]:
    """Centre and amplitude (n,) that the positions allow."""
    room = 0.5 * (limits.high - limits.low)
    room = np.maximum(room - np.minimum(OVERSHOOT, 0.1 * room), 1e-3)
    middle = 0.5 * (limits.high + limits.low)
    shift = np.array([wave.shift for wave in waves]) * room
    return middle + shift, np.array([wave.size for wave in waves]) * (room - np.abs(shift))


def _torque(robot: Robot, q: Array, time: Array) -> Array:
    """(N, n) motor torque [N m] for link positions (N, n) of the actuated joints, springs taken as rigid."""
    v, a = (np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0))
    body = PinBody(robot.model)
    rows = [joint.idx_v for joint in robot.joints]
    full_q, full_v, full_a = np.tile(body.neutral, (len(q), 1)), *(np.zeros((len(q), body.nv)) for _ in "va")
    full_q[:, [joint.idx_q for joint in robot.joints]] = q
    full_v[:, rows], full_a[:, rows] = v, a
    load = np.array([body.rnea(*row) for row in zip(full_q, full_v, full_a, strict=True)])[:, rows]
    inertia = np.diag([joint.drive.B for joint in robot.joints])
    damping = np.diag([joint.drive.D_m for joint in robot.joints])
    for coupling in robot.couplings:
        turns, at = np.array(coupling.matrix), np.ix_(coupling.joints, coupling.joints)
        inertia[at], damping[at] = turns.T @ inertia[at] @ turns, turns.T @ damping[at] @ turns
    return load + a @ inertia + v @ damping
