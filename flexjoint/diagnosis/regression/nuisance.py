"""Nominal numbers that are not exactly known: one whitened column of the residual for each, for a deviation
of one tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any

import numpy as np

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.balances import LINK, MOTOR, SPRING, Balances, Row
from flexjoint.diagnosis.regression.whitening import Band, Whitening, joined
from flexjoint.diagnosis.signals.jumps import Unknown, jumps, unknown_shapes
from flexjoint.diagnosis.signals.signals import Readings
from flexjoint.effects import Drive, Effect, Parameter, Planned, Site, catalogue, effect
from flexjoint.robot.robot import Robot
from flexjoint.robot.schema import COM_AT_ORIGIN

TURN = 2.0 * np.pi  # rad, of an encoder: no offset is larger
STEP = 0.01  # prior deviations, of a derivative where friction sticks: a whole one may break it loose
REMEMBERED = 1.5e7  # bytes of columns beside effects, before they are whitened
AT_ORIGIN = 1e-6  # m, rounding of a description
JUMP = "jump between samples"
START = "state of a link without encoder at the start"
JUMP_MEMORY = 1e8  # bytes of all of them: the largest ones, where there are more


@dataclass(frozen=True)
class NominalNumber(Parameter):
    """A number of the nominal model that is not exactly known, as a parameter whose `std` is its prior
    standard deviation: of a balance, relative to the number (absolute where it has no scale); of a
    simulation, in the number's unit.

    Args:
        name: of a balance's number spring_stiffness, spring_damping, motor_inertia, motor_damping, inertial,
            an effect's or an encoder offset's; of a simulation's, that of `model.parameters`.
        joint: whose it is; None: of no joint.
        direction: (10 n,) of all links' inertial parameters, where it is no single one of them.
        of: the parameter of the effect `name` that the nominal model claims.
    """

    _: KW_ONLY
    std: float = 1.0
    joint: str | None = None
    direction: tuple[float, ...] = ()
    of: str = ""

    @property
    def becomes_effect(self) -> bool:
        """Whether `as_effects` makes an effect of its deviation."""
        return bool(self.of) or self.name in (*NUMBERS, "inertial") or self.name.endswith("_encoder_offset")

    @property
    def claims_friction(self) -> bool:
        """Whether it is of ordinary friction that the model claims: off by more than a background, that is
        named whatever its tolerance (verdict/joints), and what is left is counted beside the claim."""
        return bool(self.of) and catalogue()[self.name].ordinary

    @property
    def of_the_robot(self) -> bool:
        """Whether it is a number that the robot file states, so that a large deviation of it is implausible;
        not an unknown one (what a torque did between samples)."""
        return self.name not in (JUMP, START)


class DriveDeviation(Effect):
    """An actuator whose nominal numbers deviate by relative amounts (a tolerance, not a cause)."""

    site = Site.MOTOR
    params = tuple(
        Parameter(name, "1", name, value=0.0, low=-0.95, high=100.0) for name in ("K", "D", "B", "D_m")
    )

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return drive.scaled(K=1.0 + p.K, D=1.0 + p.D, B=1.0 + p.B, D_m=1.0 + p.D_m)


class InertialDeviation(Effect):
    """A link whose nominal inertial parameters deviate (a tolerance, not a cause)."""

    site = Site.BODY
    params = (Parameter("added", "", r"\Delta\pi", value=0.0, low=-1e9, high=1e9, size=10),)

    def edit_inertial(self, inertial: Any, p: Any) -> Any:
        return [have + more for have, more in zip(inertial, p.added, strict=True)]


NUMBERS = {"spring_stiffness": "K", "spring_damping": "D", "motor_inertia": "B", "motor_damping": "D_m"}


def as_effects(
    nuisance: Sequence[NominalNumber],
    deviations: np.ndarray,
    nominal: np.ndarray,
    robot: Robot,
    other_component: float,
) -> list[Planned]:
    """Deviations of the actuators, of the links and of the effects that the nominal model claims, in prior
    deviations, as effects that a model can hold; the last take the place of what the model claims. `nominal`
    (n, 10) are the links' inertial parameters."""
    drives: dict[str, dict[str, float]] = {}
    claimed = {e.key: e for e in robot.effects}
    added: dict[str, np.ndarray] = {}
    changed: dict[tuple[str, str | None], Planned] = {}
    directions: dict[str, Iterator[np.ndarray]] = {}  # of a joint, those still to come
    for number, deviation in zip(nuisance, deviations, strict=True):
        key = number.name, number.joint
        if not number.becomes_effect:
            continue
        if number.of and deviation:
            (param,) = (p for p in claimed[key].effect.params if p.name == number.of)
            value = claimed[key].values[param.name] * (1.0 + float(deviation) * number.std)
            changed[key] = changed.get(key, claimed[key]).with_values(
                {param.name: float(np.clip(value, param.low, param.high))}
            )
        elif number.joint is None or number.of:
            continue
        elif number.name in NUMBERS:
            change = max(-0.9, float(deviation) * number.std)
            drives.setdefault(number.joint, {})[NUMBERS[number.name]] = change
        elif number.name == "inertial":
            i = robot.joint_names.index(number.joint)
            if number.joint not in directions:
                own = inertial_directions(nominal[i], number.std, other_component, robot.tolerance.com)
                directions[number.joint] = iter(own)
                added[number.joint] = np.zeros(10)
            added[number.joint] += next(directions[number.joint]) * float(deviation)
    out = [  # reading = true + offset
        effect(n.name, n.joint, offset=float(np.clip(-d * n.std, -TURN, TURN)))
        for n, d in zip(nuisance, deviations, strict=True)
        if n.name.endswith("_encoder_offset") and not n.of
    ]
    out += [
        Planned(DriveDeviation(), joint, {**dict.fromkeys("KB", 0.0), "D": 0.0, "D_m": 0.0, **values})
        for joint, values in drives.items()
    ]
    out += [
        Planned(InertialDeviation(), joint, {"added": tuple(map(float, change))})
        for joint, change in added.items()
    ]
    return [*out, *changed.values()]


@dataclass(frozen=True)
class _Carried:
    """What a friction that sticks carries of links' loads in one balance, by link, before it is whitened: a
    band of all numbers of the link."""

    bands: Mapping[int, Band]

    @property
    def nbytes(self) -> int:
        return sum(band.nbytes for band in self.bands.values())


class Columns:
    """Makes the columns of one set of balances under one whitening; `readings` are those with noise, in which
    jumps of torques are looked for."""

    def __init__(self, balances: Balances, whitening: Whitening, readings: Readings) -> None:
        self.balances, self.whitening, self._readings = balances, whitening, readings
        self.motion, self.robot = balances.motion, balances.motion.robot
        self.nuisance: list[NominalNumber] = []
        self._recent: LruCache[Band] = LruCache()
        self._carried: LruCache[_Carried] = LruCache()
        self._directions: dict[int, dict[int, np.ndarray]] = {}  # (10,) of a link's parameters, by number
        self._jumps: list[Unknown] = []
        self.samples = whitening.time.size * len(balances.rows)
        columns = self._drive_columns() + self._inertial_columns() + self._effect_columns()
        if self.robot.file.offsets == "per_recording":
            columns += self._offset_columns()
        columns += self._jump_columns() + self._start_columns()
        self.claimed = np.array([number.of_the_robot for number in self.nuisance], dtype=bool)
        self.matrix = np.empty((len(columns), self.samples))
        for k in range(len(columns)):  # each is freed as it is taken over: together they are large
            self.matrix[-1 - k] = columns.pop()

    def _drive_columns(self) -> list[np.ndarray]:
        tolerance = self.robot.tolerance
        columns: list[np.ndarray] = []
        for i, joint in enumerate(self.robot.joints):
            drive, s = joint.drive, self.balances.chains.jomega
            phi = self.balances.chains.base(i).phi_hat
            turns = self.balances.chains.ties.turns(i)  # of its motor by joint
            turned = sum(n * self._spectrum(self.motion.theta[j]) for j, n in turns.items())
            shaft = {"motor_inertia": drive.B * s**2 * turned, "motor_damping": drive.D_m * s * turned}
            spreads = {"motor_inertia": tolerance.inertial, "motor_damping": tolerance.damping}
            for name, spectrum in shaft.items():
                if self._row(MOTOR, i) is not None:
                    entries = {(MOTOR, j): -n * spreads[name] * spectrum for j, n in turns.items()}
                    columns.append(self._column(entries))
                    self.nuisance.append(NominalNumber(name, joint=joint.name, std=spreads[name]))
            if joint.rigid:
                continue
            for name, spectrum, spread in (
                ("spring_stiffness", drive.K * phi, tolerance.stiffness),
                ("spring_damping", drive.D * s * phi, tolerance.damping),
            ):
                columns.append(self._column(self._pulled(i, spread * spectrum)))
                self.nuisance.append(NominalNumber(name, joint=joint.name, std=spread))
        return columns

    def _pulled(self, i: int, torque: np.ndarray) -> dict[tuple[str, int], np.ndarray]:
        """What a torque (F,) by which joint i's spring pulls more changes of the balances."""
        sensed = {(SPRING, i): -torque}
        return (
            sensed if i in self.balances.sprung_links else {(MOTOR, i): -torque, (LINK, i): torque} | sensed
        )

    def _inertial_columns(self) -> list[np.ndarray]:
        """Mass, centre of mass and inertia about it of every actuated link, each with its own tolerance."""
        tolerance, other = self.robot.tolerance.inertial, self._readings.settings.regression.other_component
        com = self.robot.tolerance.com
        columns: list[np.ndarray] = []
        if tolerance == 0 and not com:
            return columns
        for i, joint in enumerate(self.robot.joints):
            nominal = self.motion.rigid.inertial[i]
            if nominal[0] <= 0:
                continue
            for direction in inertial_directions(nominal, tolerance, other, com):
                columns.append(self._column(self._load_rows(self.balances.inertial_torque(i, direction))))
                self._directions.setdefault(i, {})[len(self.nuisance)] = direction
                self.nuisance.append(NominalNumber("inertial", joint=joint.name, std=tolerance))
        return columns

    def _effect_columns(self) -> list[np.ndarray]:
        """Numbers of the effects that the nominal model claims."""
        columns: list[np.ndarray] = []
        base = list(self.robot.effects)
        for e in self.robot.effects:
            spread = tolerance_of(e, self.robot)
            for param in e.effect.nulls:
                value = e.values.get(param.name)
                if param.size > 1 or not value or not np.isfinite(value) or spread == 0:
                    continue
                moved = e.with_values({param.name: value * (1.0 + spread)})
                changed = self.balances.changed(base, [moved if x is e else x for x in base])
                columns.append(self.whitening.white(self.whitening.band(changed)).ravel())
                number = NominalNumber(e.effect.name, joint=e.joint, std=spread, of=param.name)
                self.nuisance.append(number)
        return columns

    def _offset_columns(self) -> list[np.ndarray]:
        """Encoder offsets, free in each recording."""
        limits = self._readings.settings.regression
        columns: list[np.ndarray] = []
        ones = np.ones(self.balances.filter.count)
        unit = self._spectrum(ones)
        for i, joint in enumerate(self.robot.joints):
            stiff = 0.0 if joint.rigid else joint.drive.K * limits.offset_deviation
            load = self._load_rows(limits.offset_deviation * self.motion.rigid.by_q[:, :, i].T)
            if joint.rigid:
                columns.append(self._column(load))
                self.nuisance.append(
                    NominalNumber("motor_encoder_offset", joint=joint.name, std=limits.offset_deviation)
                )
                continue
            twist = self._pulled(i, stiff * unit)
            columns.append(self._column(twist))
            self.nuisance.append(
                NominalNumber("motor_encoder_offset", joint=joint.name, std=limits.offset_deviation)
            )
            back = {key: -value for key, value in twist.items()}
            for key, value in load.items():
                back[key] = back.get(key, 0.0) + value
            columns.append(self._column(back))
            self.nuisance.append(
                NominalNumber("link_encoder_offset", joint=joint.name, std=limits.offset_deviation)
            )
        return columns

    def _jump_columns(self) -> list[np.ndarray]:
        """Columns of the unknown torque between two samples where a torque jumps, as far as it matters. Of
        many jumps in a row, there are as many columns as the balances can distinguish."""
        limits = self._readings.settings.regression
        size = jumps(self._readings)
        size[:, ~self._readings.valid] = 0.0
        shapes, weight = np.zeros((len(size), 2, 2)), np.zeros_like(size)
        for i, own in enumerate(size):
            if np.any(own) and self._row(MOTOR, i) is not None:
                shapes[i] = unknown_shapes(self._readings, i, self.robot.rates.control)
                largest = int(np.argmax(own))  # where samples are used, unlike some other places
                weight[i] = own * np.linalg.norm(self._pair_column(i, largest, shapes[i, 0]))
        most = max(1, int(JUMP_MEMORY / (2 * 8 * self.samples)))
        least = max(limits.least_jump, float(np.sort(weight, axis=None)[-min(most, weight.size)]))
        columns: list[np.ndarray] = []
        for i, own in enumerate(size):
            when = np.flatnonzero(weight[i] > least)
            if not when.size:
                continue
            pairs = np.concatenate([own[when, None] * shape for shape in shapes[i]])
            when = np.tile(when, len(shapes[i]))
            each = np.array([self._pair_column(i, int(k), pair) for k, pair in zip(when, pairs, strict=True)])
            energy, axes = np.linalg.eigh(each @ each.T)
            axes = axes[:, energy > limits.least_jump**2]
            columns += list(axes.T @ each)
            self._jumps.append(Unknown(i, when, pairs, axes))
        self.nuisance += [NominalNumber(JUMP)] * len(columns)
        return columns

    def _start_columns(self) -> list[np.ndarray]:
        """Columns of where links without encoder are at the start, and how fast: no reading tells."""
        columns = []
        for rows in self.whitening.noise.balances.missing_links.free():
            columns.append(self.whitening.white(self.whitening.band_of(rows)).ravel())
            self.nuisance.append(NominalNumber(START))
        return columns

    def _pair_column(self, i: int, k: int, pair: np.ndarray) -> np.ndarray:
        """Trace of torques (2,) of motor i at sample k and the next."""
        torque = np.zeros(self.balances.filter.count)
        torque[k : k + 2] = pair
        return self._column({(MOTOR, i): self._spectrum(torque)})

    def jump_torque(self, deviations: np.ndarray) -> np.ndarray:
        """(n, N) motor torques [N m] between samples that deviations (numbers,) imply."""
        count = self.balances.filter.count
        out, numbers = np.zeros((len(self.robot.joints), count)), deviations[~self.claimed]
        for unknown in self._jumps:
            own, numbers = np.split(numbers, [unknown.axes.shape[1]])
            out[unknown.joint] = unknown.torque(own, count)
        return out

    def entangled(self, effects: Sequence[Planned]) -> dict[str, list[Planned]]:
        """Joints with effects that change how an actuator's numbers enter the balances (`entangles`), or take
        the place of what the nominal model claims, with all effects of that joint."""
        joints = dict.fromkeys(
            e.joint for e in effects if e.joint and (entangles(e) or self._replaced(e.key, effects))
        )
        return {j: [e for e in effects if e.joint == j and e.effect.site is not Site.BODY] for j in joints}

    def beside(self, effects: Sequence[Planned]) -> dict[int, np.ndarray]:
        """Columns, by their number's index, that are different beside some effects: those of actuators beside
        effects of their joint, those of links beside a friction that sticks, and none of what is replaced."""
        entangled = self.entangled(effects)
        out = self._loads_beside(entangled)
        for joint, own in entangled.items():
            for k, number in enumerate(self.nuisance):
                if number.joint != joint:
                    continue
                if number.of:  # an effect may have the name of a drive's number
                    if self._replaced((number.name, joint), own):
                        out[k] = np.zeros(self.samples)
                elif number.name in NUMBERS:
                    key = (number.name, joint, *(e.identity for e in own))
                    make = partial(self._beside, own, joint, number)
                    out[k] = self.whitening.white(self._recent.get(key, make, REMEMBERED)).ravel()
        return out

    def _replaced(self, key: tuple[str, str | None], effects: Sequence[Planned]) -> bool:
        """Whether another effect takes the place of one that the nominal model claims: its numbers are fitted
        then, and those of the nominal model are no longer at work."""
        claimed = next((e for e in self.robot.effects if e.key == key), None)
        here = next((e for e in effects if e.key == key), None)
        return claimed is not None and here is not None and here is not claimed and not here.nominal

    def _beside(self, own: Sequence[Planned], joint: str, number: NominalNumber) -> Band:
        """Trace of a joint's number beside effects of that joint, before it is whitened."""
        off = {**dict.fromkeys(NUMBERS.values(), 0.0), NUMBERS[number.name]: STEP * number.std}
        changed = self.balances.changed(own, [*own, Planned(DriveDeviation(), joint, off)])
        return self.whitening.band({row: spectrum / STEP for row, spectrum in changed.items()})

    def _loads_beside(self, entangled: Mapping[str, Sequence[Planned]]) -> dict[int, np.ndarray]:
        """Columns of the numbers of links whose load a friction carries while it sticks: meanwhile they do
        not change the residual."""
        names, chains = self.robot.joint_names, self.balances.chains
        carried: dict[int, list[Band]] = {}
        for row in self.balances.rows:
            own = entangled.get(names[row.joint], ())
            if chains.rests_on_load(row.joint, own):
                key, make = (row, *(e.identity for e in own)), partial(self._held, row, own)
                for i, band in self._carried.get(key, make, REMEMBERED).bands.items():
                    carried.setdefault(i, []).append(band)
        out: dict[int, np.ndarray] = {}
        for i, bands in carried.items():
            columns = self.whitening.white(joined(bands)).reshape(-1, self.samples)
            for k, column in zip(self._directions[i], columns, strict=True):
                out[k] = self.matrix[k] + column
        return out

    def _held(self, row: Row, own: Sequence[Planned]) -> _Carried:
        """What a friction carries of the loads in a balance, beside effects of its joint."""
        chain = self.balances.chains.get(row.joint, own)
        where = self.balances.holding(row, chain)
        out: dict[int, Band] = {}
        if where is None:
            return _Carried(out)
        for i, directions in self._directions.items():
            each = np.array(list(directions.values()))
            torques = self.balances.inertial_torques_on(row.joint, i, each)
            if torques is not None:
                at = self.balances.rows.index(row)
                out[i] = self.whitening.bands(at, self._spectrum(where * torques))
        return _Carried(out)

    def load_band(self, torque: np.ndarray) -> Band:
        """Trace, before it is whitened, of a change (n, N) of the rigid-body torques."""
        return self._band(self._load_rows(torque))

    def _load_rows(self, torque: np.ndarray) -> dict[tuple[str, int], np.ndarray]:
        """A change (n, N) of the rigid-body torques as it enters the balances."""
        out = {}
        for k, other in enumerate(self.robot.joints):
            if np.any(torque[k]):
                out[(MOTOR if other.rigid else LINK, k)] = -self.balances.filter.spectrum(torque[k])
        return out

    def _column(self, entries: dict[tuple[str, int], np.ndarray]) -> np.ndarray:
        return self.whitening.white(self._band(entries)).ravel()

    def _band(self, entries: dict[tuple[str, int], np.ndarray]) -> Band:
        rows = {self._row(*key): spectrum for key, spectrum in entries.items()}
        return self.whitening.band({row: spectrum for row, spectrum in rows.items() if row is not None})

    def _row(self, balance: str, joint: int) -> int | None:
        for r, row in enumerate(self.balances.rows):
            if row.balance == balance and row.joint == joint:
                return r
        return None

    def _spectrum(self, x: np.ndarray) -> np.ndarray:
        return self.balances.filter.spectrum(x) * self.balances.filter.gain


def tolerance_of(e: Planned, robot: Robot) -> float:
    """The share to which a number of an effect that the nominal model claims is known."""
    tolerance = robot.tolerance
    by_site = {Site.MOTOR: tolerance.damping, Site.LINK: tolerance.damping, Site.BODY: tolerance.inertial}
    return by_site.get(e.effect.site, tolerance.stiffness)


def entangles(e: Planned) -> bool:
    """Whether an effect changes what a small change of its joint's actuator or link does. A dry friction that
    sticks takes any change of the spring's or the load's torque; and a stiffness acts on the deflection that
    an encoder offset or a gap leaves."""
    return e.effect.overrides("level") or e.effect.site in (Site.DEFLECTION, Site.SENSOR)


def inertial_directions(
    nominal: np.ndarray, tolerance: float, other_component: float, com: float | None = None
) -> list[np.ndarray]:
    """One-deviation changes of (m, m c, I) for mass, centre of mass and inertia about it: ten directions.

    The centre of mass is trusted to `com` [m] along each axis. Without, to the tolerance of each component, a
    small one to the share `other_component` of its length; at the joint's origin, where a description states
    none, to COM_AT_ORIGIN. A product of inertia is trusted to the same share of the trace."""
    m, c = nominal[0], nominal[1:4] / nominal[0]
    directions = []
    unit = np.concatenate([[1.0], c, _second(c, c)])
    directions.append(tolerance * m * unit)
    length = float(np.linalg.norm(c))
    for axis in np.eye(3):
        size = tolerance * (abs(float(axis @ c)) + other_component * length)
        if com is not None:
            size = com
        elif length < AT_ORIGIN and tolerance > 0.0:
            size = COM_AT_ORIGIN
        step = size * axis
        directions.append(np.concatenate([[0.0], m * step, m * (_second(c, step) + _second(step, c))]))
    central = nominal[4:] - m * _second(c, c)
    trace = central[0] + central[2] + central[5]
    for k in range(6):
        size = tolerance * (abs(central[k]) + (other_component * trace if k in (1, 3, 4) else 0.0))
        directions.append(size * np.eye(10)[4 + k])
    return directions


def _second(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(Ixx, Ixy, Iyy, Ixz, Iyz, Izz) of -[a]x [b]x, symmetric part."""
    full = float(a @ b) * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a))
    return np.array([full[0, 0], full[0, 1], full[1, 1], full[0, 2], full[1, 2], full[2, 2]])
