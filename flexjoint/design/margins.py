"""How far a feedback loop is from instability: gain, phase, delay and disk margins, per joint and together.

All margins are at the motor torques. Computed on the frequency response of the state-space model, which stays
exact where polynomials of a whole robot's order do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from flexjoint.design.feedback import Gains, close_loop, join, open_loop
from flexjoint.design.linear_model import LinearModel

GRID = 300  # frequencies, spread evenly in their logarithm, beside those about each pole
FLOOR = 1e-9  # of the largest entry
INTEGRATOR = 1e-9  # distance of a pole from p at which the response there counts as infinite
ROUNDS = 30  # of the diagonal scaling of the MIMO bound


@dataclass(frozen=True, kw_only=True)
class LoopMargins:
    """Margins of one joint's loop, the others closed; infinite where nothing within the model limits them.

    gain_up, gain_down: factors on the loop's gain at which it turns unstable (gain_down 0: none). phase
    [deg], delay [s].
    disk: radius alpha of the balanced disk (Seiler, Packard and Gahinet 2020): gain and phase may vary
    together. crossover [Hz]: where |L| = 1 last.
    """

    joint: str
    gain_up: float
    gain_down: float
    phase: float
    delay: float
    disk: float
    crossover: float


@dataclass(frozen=True)
class Margins:
    """Of a closed loop. damping: smallest damping ratio of its poles. disk: of all joints' loops varying at
    once and independently, a lower bound by diagonal scaling. Margins of an unstable loop are 0."""

    stable: bool
    damping: float
    disk: float
    loops: tuple[LoopMargins, ...]

    @property
    def disk_gain(self) -> tuple[float, float]:
        """Factors between which all loops' gains may vary at once."""
        return disk_gain(self.disk)

    def __str__(self) -> str:
        lines = [f"{'':20}{'gain up':>9}{'down':>7}{'phase [deg]':>13}{'delay [ms]':>12}{'disk':>7}"]
        for loop in self.loops:
            numbers = f"{loop.gain_up:9.1f}{loop.gain_down:7.2f}{loop.phase:13.0f}{1e3 * loop.delay:12.1f}"
            lines.append(f"{loop.joint:20}{numbers}{loop.disk:7.2f}")
        low, high = self.disk_gain
        state = "" if self.stable else ", UNSTABLE"
        lines.append(
            f"all at once: disk {self.disk:.2f}, gains from {low:.2f} to {high:.2f} or"
            f" {self.disk_phase:.0f} deg of phase; least damping {self.damping:.2f}{state}"
        )
        return "\n".join(lines)

    @property
    def disk_phase(self) -> float:
        """[deg] by which all loops' phases may vary at once."""
        return math.degrees(2.0 * math.atan(0.5 * self.disk))


def disk_gain(alpha: float) -> tuple[float, float]:
    """Gain factors inside a balanced disk of radius alpha."""
    low = max((2.0 - alpha) / (2.0 + alpha), 0.0)
    return low, 1.0 / low if low > 0.0 else math.inf


def margins(linear: LinearModel, gains: Gains) -> Margins:
    """Margins of the feedback on a linear model, continuous without dead times or sampled."""
    closed = close_loop(linear, gains)
    names = [name.split(".", 1)[1] for name in linear.inputs]
    stable, damping = is_stable(closed), smallest_damping(closed)
    if not stable:
        return Margins(
            False,
            damping,
            0.0,
            tuple(
                LoopMargins(
                    joint=n, gain_up=1.0, gain_down=1.0, phase=0.0, delay=0.0, disk=0.0, crossover=0.0
                )
                for n in names
            ),
        )
    joined, F = join(linear, gains)
    loops = []
    for i, name in enumerate(names):
        others = closed.A + np.outer(joined.B[:, i], F[i])
        loops.append(_loop(name, _Response(others, joined.B[:, [i]], F[[i]], linear.dt)))
    return Margins(True, damping, disk_margin(linear, gains), tuple(loops))


def disk_margin(linear: LinearModel, gains: Gains) -> float:
    """alpha of all loops together, 0 where the closed loop is unstable."""
    closed = close_loop(linear, gains)
    if not is_stable(closed):
        return 0.0
    opened = open_loop(linear, gains)
    # S = I - F (sI - A + B F)^-1 B has no poles but the closed loop's
    response = _Response(closed.A, opened.B, opened.C, opened.dt)
    return 1.0 / _peak(response, lambda back: _scaled_norm(0.5 * np.eye(back.shape[-1]) - back))


def is_stable(linear: LinearModel) -> bool:
    poles = linear.poles
    return bool(np.all(np.abs(poles) < 1.0) if linear.dt else np.all(poles.real < 0.0))


def smallest_damping(linear: LinearModel) -> float:
    """Smallest damping ratio of the poles; those of a sampled model as the continuous poles they stand
    for."""
    poles = linear.poles
    if linear.dt:
        poles = poles[np.abs(poles) > 1e-9]  # registers decay within a tick
        poles = np.log(poles.astype(complex)) / linear.dt
    size = np.abs(poles)
    return float(np.min(np.where(size > 0.0, -poles.real / np.where(size > 0.0, size, 1.0), 0.0)))


# --- frequency responses ----------------------------------------------------------------------------------
class _Response:
    """C (pI - A)^-1 B at frequencies [rad/s], with p = j omega or e^(j omega dt)."""

    def __init__(self, A: np.ndarray, B: np.ndarray, C: np.ndarray, dt: float | None) -> None:
        self.A, self.B, self.C, self.dt = A, B, C, dt
        poles = np.linalg.eigvals(A).astype(complex)
        if dt:
            poles = np.log(poles[np.abs(poles) > 1e-9]) / dt
        size = np.abs(poles)
        size, poles = size[size > 1e-6], poles[size > 1e-6]
        low, high = 1e-3 * np.min(size, initial=1.0), 1e3 * np.max(size, initial=1.0)
        self.top = math.pi / dt if dt else math.inf
        spread = np.linspace(-3.0, 3.0, 9)
        about = size[:, None] + np.abs(poles.real)[:, None] * spread
        about = np.concatenate([about.ravel(), np.abs(poles.imag), size])
        grid = np.concatenate([np.geomspace(low, min(high, self.top), GRID), about[about > low]])
        self.grid = np.unique(grid[grid <= self.top])

    def __call__(self, omega: np.ndarray) -> np.ndarray:
        p = np.exp(1j * omega * self.dt) if self.dt else 1j * omega
        n = len(self.A)
        return self.C @ np.linalg.solve(p[:, None, None] * np.eye(n) - self.A, self.B)

    def ends(self) -> list[float]:
        """The response at frequency 0, unless it is infinite, and at half the sampling rate; both real."""
        points = ([1.0] if self.dt else [0.0]) + ([-1.0] if self.dt else [])
        away = [np.min(np.abs(np.linalg.eigvals(self.A) - p)) for p in points]
        n = len(self.A)
        return [
            float((self.C @ np.linalg.solve(p * np.eye(n) - self.A, self.B))[0, 0])
            for p, distance in zip(points, away, strict=True)
            if distance > INTEGRATOR
        ]

    def at(self, omega: float) -> complex:
        return complex(self(np.array([omega]))[0, 0, 0])


def _loop(joint: str, loop: _Response) -> LoopMargins:
    omega = loop.grid
    L = loop(omega)[:, 0, 0]
    up, down = math.inf, 0.0
    crossings = [_root(lambda w: loop.at(w).imag, omega[k], omega[k + 1]) for k in _changes(L.imag)]
    real = [loop.at(w).real for w in crossings] + loop.ends()
    for value in real:
        if value < 0.0:
            factor = -1.0 / value
            up, down = (min(up, factor), down) if factor > 1.0 else (up, max(down, factor))
    phase, delay, last = math.inf, math.inf, 0.0
    for k in _changes(np.abs(L) - 1.0):
        w = _root(lambda w: abs(loop.at(w)) - 1.0, omega[k], omega[k + 1])
        angle = (math.pi + np.angle(loop.at(w))) % (2.0 * math.pi)  # phase that may be lost
        phase = min(phase, math.degrees(min(angle, 2.0 * math.pi - angle)))
        delay, last = min(delay, angle / w), max(last, w / (2.0 * math.pi))
    disk = 1.0 / _peak(loop, lambda L: np.abs(0.5 * (1.0 - L[:, 0, 0]) / (1.0 + L[:, 0, 0])))
    return LoopMargins(
        joint=joint,
        gain_up=up,
        gain_down=down,
        phase=phase,
        delay=float(delay),
        disk=disk,
        crossover=float(last),
    )


def _changes(values: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0.0)


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-12 * high, rtol=1e-12))


def _peak(response: _Response, size: Callable[[np.ndarray], np.ndarray]) -> float:
    """Largest size of the response over frequency: the grid's, refined between its neighbours."""
    omega = response.grid
    values = size(response(omega))
    k = int(np.argmax(values))
    low, high = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
    fine = minimize_scalar(
        lambda w: -float(size(response(np.array([w])))[0]), bounds=(low, high), method="bounded",
        options={"xatol": 1e-6 * high},
    )  # fmt: skip
    return max(float(values[k]), -float(fine.fun))


def _scaled_norm(matrices: np.ndarray) -> np.ndarray:
    """(F,) upper bounds of the structured singular value of (F, n, n) for independent complex scalars: the
    norm after Osborne's diagonal scaling (Zhou, Doyle and Glover 1996, chapter 11)."""
    n = matrices.shape[-1]
    scale = np.ones(matrices.shape[:-1])
    size = np.abs(matrices)
    # a loop that only drives others has an empty column: the floor keeps scales finite
    off = size * (1.0 - np.eye(n)) + FLOOR * np.max(size, axis=(-2, -1), keepdims=True)
    for _ in range(ROUNDS if n > 1 else 0):
        scaled = scale[..., :, None] * off / scale[..., None, :]
        rows, columns = np.linalg.norm(scaled, axis=-1), np.linalg.norm(scaled, axis=-2)
        scale = scale * (columns / rows) ** 0.25  # all at once: half of Osborne's step does not overshoot
    scaled = scale[..., :, None] * matrices / scale[..., None, :]
    plain, better = (np.linalg.norm(m, ord=2, axis=(-2, -1)) for m in (matrices, scaled))
    return np.minimum(plain, better)
