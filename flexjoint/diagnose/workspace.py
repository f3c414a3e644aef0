"""One recording against one robot, ready to be asked: how well does this set of effects explain it?

Every nominal number is a random variable with the robot's tolerance as its standard deviation. Its
sensitivity column J (in units of that deviation) is marginalised out of every comparison: energies are
    Q(y, y) = min over d of |y - J d|^2 + |d|^2,
so that what the tolerances can explain is explained first, and only what they cannot counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexjoint.diagnose import whitening
from flexjoint.diagnose.balances import LINK, MOTOR, SPRING, Balances
from flexjoint.diagnose.signals import prepare
from flexjoint.effect import Planned, Site
from flexjoint.recording import Recording
from flexjoint.robot import Robot

OFFSET_SPREAD = 0.2  # rad, standard deviation of an encoder offset that is free in each recording
OTHER_COMPONENT = 0.1  # a centre of mass is trusted in its small components to this share of its length


@dataclass(frozen=True)
class Nuisance:
    """A nominal number that is not exactly known: effect name of its deviation, joint, prior deviation."""

    name: str  # spring_stiffness | spring_damping | motor_inertia | motor_damping | inertial | ...
    joint: str | None
    spread: float  # relative, or absolute where the number has no scale


class Workspace:
    """Whitened residuals and their inner products with the nominal model's tolerances marginalised."""

    def __init__(self, robot: Robot, recording: Recording) -> None:
        self.robot = robot
        self.recording = recording
        self.readings = prepare(robot, recording)
        self.balances = Balances(robot, self.readings, recording)
        self.torque_scale = self._torque_scale()
        rows = self.balances.rows
        self.whitening = whitening.make(self.balances, np.array([self.torque_scale[r.joint] for r in rows]))
        self.time = self.whitening.time
        self.samples = self.time.size * len(rows)
        self.freedom = self.time.size * self.whitening.freedom
        self.nominal = tuple(robot.effects)
        self._base_key: object = None
        self.nuisance: list[Nuisance] = []
        self.J = self._nuisance_columns()
        self._gram = cho_factor(self.J @ self.J.T + np.eye(len(self.J)))

    # ------------------------------------------------------------------ residuals
    def whitened(self, effects: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual with exactly these effects (nominal ones included) at work."""
        return self.whitening.apply(self.balances.residual(effects)).ravel()

    def change(self, base: Sequence[Planned], effects: Sequence[Planned]) -> np.ndarray:
        """(samples,) whitened residual of `effects` minus that of `base`; only rows that differ cost."""
        difference = self.balances.residual(effects) - self.balances.residual(base)
        return self.whitening.apply(difference).ravel()

    def with_nominal(self, extra: Sequence[Planned]) -> list[Planned]:
        """The nominal model's effects with these added; one that it lists already is replaced."""
        keys = {e.key for e in extra}
        return [e for e in self.nominal if e.key not in keys] + list(extra)

    # ------------------------------------------------------------------ inner products
    def energy(self, y: np.ndarray) -> float:
        """Q(y, y)."""
        return float(self.product(y[None], y[None])[0, 0])

    def product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Q between rows of a (k, samples) and b (l, samples): (k, l)."""
        aj, bj = a @ self.J.T, b @ self.J.T
        return a @ b.T - aj @ cho_solve(self._gram, bj.T)

    def posterior(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Deviations of the nominal numbers, in prior deviations, and their standard errors, for a residual
        y = J d + noise."""
        value = cho_solve(self._gram, self.J @ y)
        return value, np.sqrt(np.diag(cho_solve(self._gram, np.eye(len(self.J)))))

    # ------------------------------------------------------------------ nominal numbers
    def _torque_scale(self) -> np.ndarray:
        """(n,) RMS torque of each joint [N m]: the larger of motor and load, about zero."""
        used = self.readings.valid
        load = np.sqrt(np.mean(self.balances.rigid.tau[:, used] ** 2, axis=1))
        torque = self.readings.torque[:, used]
        drive = np.sqrt(np.mean(np.where(np.isfinite(torque), torque, 0.0) ** 2, axis=1))
        return np.maximum(np.maximum(load, drive), 1e-6)

    def _nuisance_columns(self) -> np.ndarray:
        tolerance = self.robot.tolerance
        columns: list[np.ndarray] = []
        for i, joint in enumerate(self.robot.joints):
            drive, s = joint.drive, self.balances.jomega
            theta = self._spectrum(self.balances.theta[i])
            phi = theta - self._spectrum(self.balances.q[i])
            shaft = {"motor_inertia": drive.B * s**2 * theta, "motor_damping": drive.D_m * s * theta}
            spreads = {"motor_inertia": tolerance.inertial, "motor_damping": tolerance.damping}
            for name, spectrum in shaft.items():
                if self._row(MOTOR, i) is not None:
                    columns.append(self._column({(MOTOR, i): -spreads[name] * spectrum}))
                    self.nuisance.append(Nuisance(name, joint.name, spreads[name]))
            if joint.rigid:
                continue
            for name, spectrum, spread in (
                ("spring_stiffness", drive.K * phi, tolerance.stiffness),
                ("spring_damping", drive.D * s * phi, tolerance.damping),
            ):
                change = spread * spectrum
                columns.append(self._column({(MOTOR, i): -change, (LINK, i): change, (SPRING, i): -change}))
                self.nuisance.append(Nuisance(name, joint.name, spread))
        columns += self._inertial_columns()
        columns += self._effect_columns()
        if self.robot.file.offsets == "per_recording":
            columns += self._offset_columns()
        return np.array(columns)

    def _inertial_columns(self) -> list[np.ndarray]:
        """Mass, centre of mass and inertia about it of every actuated link, each with its own tolerance."""
        columns, tolerance = [], self.robot.tolerance.inertial
        if tolerance == 0:
            return columns
        for i, joint in enumerate(self.robot.joints):
            nominal = self.balances.rigid.inertial[i]
            if nominal[0] <= 0:
                continue
            for direction in inertial_directions(nominal, tolerance):
                regressor = self.balances.rigid.regressor[:, :, 10 * i : 10 * i + 10]
                torque = np.einsum("tjk,k->jt", regressor, direction)
                columns.append(self._column(self._load_rows(torque)))
                self.nuisance.append(Nuisance("inertial", joint.name, tolerance))
        return columns

    def _effect_columns(self) -> list[np.ndarray]:
        """Numbers of the effects that the nominal model claims."""
        columns, tolerance = [], self.robot.tolerance
        trust = {Site.MOTOR: tolerance.damping, Site.LINK: tolerance.damping, Site.BODY: tolerance.inertial}
        base = list(self.nominal)
        for e in self.nominal:
            spread = trust.get(e.effect.site, tolerance.stiffness)
            for param in e.effect.nulls:
                value = e.values.get(param.name)
                if param.size > 1 or not value or not np.isfinite(value) or spread == 0:
                    continue
                moved = e.with_values({param.name: value * (1.0 + spread)})
                columns.append(self.change(base, [moved if x is e else x for x in base]))
                self.nuisance.append(Nuisance(e.effect.name, e.joint, spread))
        return columns

    def _offset_columns(self) -> list[np.ndarray]:
        """Encoder offsets, free in each recording."""
        columns = []
        ones = np.ones(self.balances.filter.count)
        unit = self._spectrum(ones)
        for i, joint in enumerate(self.robot.joints):
            stiff = 0.0 if joint.rigid else joint.drive.K * OFFSET_SPREAD
            load = self._load_rows(OFFSET_SPREAD * self.balances.rigid.by_q[:, :, i].T)
            if joint.rigid:
                columns.append(self._column(load))
                self.nuisance.append(Nuisance("motor_encoder_offset", joint.name, OFFSET_SPREAD))
                continue
            twist = {(MOTOR, i): -stiff * unit, (LINK, i): stiff * unit, (SPRING, i): -stiff * unit}
            columns.append(self._column(twist))
            self.nuisance.append(Nuisance("motor_encoder_offset", joint.name, OFFSET_SPREAD))
            back = {key: -value for key, value in twist.items()}
            for key, value in load.items():
                back[key] = back.get(key, 0.0) + value
            columns.append(self._column(back))
            self.nuisance.append(Nuisance("link_encoder_offset", joint.name, OFFSET_SPREAD))
        return columns

    def load_column(self, torque: np.ndarray) -> np.ndarray:
        """(samples,) whitened trace of a change (n, N) of the rigid-body torques."""
        return self._column(self._load_rows(torque))

    def _load_rows(self, torque: np.ndarray) -> dict[tuple[str, int], np.ndarray]:
        """A change (n, N) of the rigid-body torques as it enters the balances."""
        out = {}
        for k, other in enumerate(self.robot.joints):
            if np.any(torque[k]):
                out[(MOTOR if other.rigid else LINK, k)] = -self.balances.filter.spectrum(torque[k])
        return out

    def _column(self, entries: dict[tuple[str, int], np.ndarray]) -> np.ndarray:
        spectra = np.zeros((len(self.balances.rows), self.balances.filter.omega.size), dtype=complex)
        for (balance, joint), spectrum in entries.items():
            row = self._row(balance, joint)
            if row is not None:
                spectra[row] = spectrum
        return self.whitening.apply(spectra).ravel() if np.any(spectra) else np.zeros(self.samples)

    def _row(self, balance: str, joint: int) -> int | None:
        for r, row in enumerate(self.balances.rows):
            if row.balance == balance and row.joint == joint:
                return r
        return None

    def _spectrum(self, x: np.ndarray) -> np.ndarray:
        return self.balances.filter.spectrum(x) * self.balances.filter.gain


def inertial_directions(nominal: np.ndarray, tolerance: float) -> list[np.ndarray]:
    """One-deviation changes of (m, m c, I) for mass, centre of mass and inertia about it: ten directions.

    A small component of the centre of mass is trusted to `OTHER_COMPONENT` of its whole length, a product
    of inertia to the same share of the trace."""
    m, c = nominal[0], nominal[1:4] / nominal[0]
    directions = []
    unit = np.concatenate([[1.0], c, _second(c, c)])
    directions.append(tolerance * m * unit)
    length = float(np.linalg.norm(c))
    for axis in np.eye(3):
        step = tolerance * (abs(float(axis @ c)) + OTHER_COMPONENT * length) * axis
        directions.append(np.concatenate([[0.0], m * step, m * (_second(c, step) + _second(step, c))]))
    central = nominal[4:] - m * _second(c, c)
    trace = central[0] + central[2] + central[5]
    for k in range(6):
        size = tolerance * (abs(central[k]) + (OTHER_COMPONENT * trace if k in (1, 3, 4) else 0.0))
        directions.append(size * np.eye(10)[4 + k])
    return directions


def _second(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of -[a]x [b]x, symmetric part."""
    full = float(a @ b) * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a))
    return np.array([full[0, 0], full[0, 1], full[1, 1], full[0, 2], full[1, 2], full[2, 2]])
