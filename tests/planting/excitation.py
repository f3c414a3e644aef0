"""Reference trajectories: smooth, from rest, within what the motors can give."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .machine.chain import Array

Reference = Callable[[Array], Array]
"""Times (m,) [s] to positions (m, n) [rad]; at rest before t = 0."""

KINDS = ("rich", "slow", "steps", "rest")

RUN_UP = 1.0  # s over which a periodic excitation grows from rest
EXCURSION = 0.9  # rad, about the centre
TORQUE_SHARE = 0.6  # of the torque limit that following the reference may ask for
PEAK_SPEED = {"rich": (1.5, 4.0), "slow": (0.35, 0.7)}  # rad/s
BAND = {"rich": (0.25, 2.4), "slow": (0.04, 0.3)}  # Hz


def reference(
    kind: str,
    joints: int,
    seconds: float,
    demand: Callable[[Array, Array, Array], Array],
    rng: np.random.Generator,
) -> Reference:
    """A reference of a kind in `KINDS`.

    `demand` gives the share of the torque limit (m, n) that positions, velocities and accelerations (m, n)
    ask for; amplitudes are reduced until it stays below TORQUE_SHARE. Raises ValueError on an unknown kind.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown excitation {kind!r}; there are {', '.join(KINDS)}")
    if kind == "rest":
        return lambda times: np.zeros((len(times), joints))
    centre = rng.uniform(-0.3, 0.3, joints)
    waves = [_steps(seconds, rng) if kind == "steps" else _wave(kind, seconds, rng) for _ in range(joints)]
    grid = np.arange(0.0, seconds, 2e-3)
    shape = np.stack([wave(grid) for wave in waves], axis=1)
    speed = np.gradient(shape, grid, axis=0)
    scale = EXCURSION / np.abs(shape).max(axis=0)
    if kind in PEAK_SPEED:
        scale = np.minimum(scale, rng.uniform(*PEAK_SPEED[kind], joints) / np.abs(speed).max(axis=0))
    acceleration = np.gradient(speed, grid, axis=0)
    for _ in range(40):
        share = np.abs(demand(centre + scale * shape, scale * speed, scale * acceleration)).max(axis=0)
        if (share <= TORQUE_SHARE).all():
            break
        scale = np.where(share > TORQUE_SHARE, 0.9 * scale, scale)
    return lambda times: centre + scale * np.stack([wave(times) for wave in waves], axis=1)


def _smooth_step(s: Array) -> Array:
    """0 to 1 with zero velocity and acceleration at both ends (minimum jerk)."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def _wave(kind: str, seconds: float, rng: np.random.Generator) -> Callable[[Array], Array]:
    """A multisine, or (one rich one in three) a chirp up and down the band on a slow wave."""
    low, high = BAND[kind]
    frequencies = np.exp(rng.uniform(np.log(low), np.log(high), 8))
    phases = rng.uniform(0, 2 * np.pi, 8)
    weights = rng.uniform(0.4, 1.0, 8) / frequencies**0.7
    if kind == "rich" and rng.random() < 1 / 3:
        mid, swing, turn = (low + high) / 2, (high - low) / 2, 2 * np.pi / rng.uniform(7, 11)

        def chirp(t: Array) -> Array:
            phase = 2 * np.pi * (mid * t - swing / turn * np.sin(turn * t))
            return _smooth_step(t / RUN_UP) * (np.sin(phase) + 0.7 * np.sin(2 * np.pi * 0.11 * t + phases[0]))

        return chirp

    def multisine(t: Array) -> Array:
        angle = 2 * np.pi * np.multiply.outer(t, frequencies) + phases
        return _smooth_step(t / RUN_UP) * (np.sin(angle) @ weights)

    return multisine


def _steps(seconds: float, rng: np.random.Generator) -> Callable[[Array], Array]:
    """Minimum-jerk moves of 0.3-0.5 s between random targets, with holds of 0.3-0.9 s."""
    starts, lengths, targets = [], [], [0.0]
    t = 0.4
    while t < seconds:
        starts.append(t)
        lengths.append(rng.uniform(0.3, 0.5))
        away = -np.sign(targets[-1]) if targets[-1] else rng.choice([-1.0, 1.0])
        targets.append(away * rng.uniform(0.15, 0.6))  # to the other side: every move reverses the load
        t += lengths[-1] + rng.uniform(0.3, 0.9)
    moves = np.diff(targets)
    return lambda times: sum(
        m * _smooth_step((times - s) / d) for m, s, d in zip(moves, starts, lengths, strict=True)
    )
