"""Torque balances of every joint: what the model says must vanish, evaluated on readings.

Per flexible joint, with s the spring torque that the model makes of the encoders,

    motor   F tau - B theta'' - D_m theta' - s + F friction
    link    s + F (link torques) - RNEA(F q, F q', F q'')
    spring  F tau_t - s

where F is the Gaussian filter. The measured tau_t stays out of the first two: encoders give s with far
less noise. Where the link has no encoder, s is F tau_t in them. A rigid joint (infinite stiffness) has the
sum of the first two as its motor balance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from scipy import fft

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.chain import Chain, Chains
from flexjoint.diagnosis.balances.links.bending import Bending
from flexjoint.diagnosis.balances.links.missing_links import MissingLinks
from flexjoint.diagnosis.balances.links.movement import Numbers, add, torque
from flexjoint.diagnosis.balances.links.sprung_links import SprungLinks
from flexjoint.diagnosis.balances.motion import Motion, reconstruct
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.signals.rounding import Colour, colours_of
from flexjoint.diagnosis.signals.signals import centred, denoised, prepare
from flexjoint.effects import Drive, Effect, Planned, Site
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint, Robot

MOTOR, LINK, SPRING = "motor", "link", "spring"
REMEMBERED = 5e6  # bytes of changes of the rigid-body torques


@dataclass(frozen=True)
class Row:
    """A balance of a joint."""

    balance: str
    joint: int


class Balances:
    """All balances of a recording against a robot, as functions of the effects assumed."""

    def __init__(self, motion: Motion) -> None:
        self.motion, self.filter = motion, motion.filter
        self.chains, self.bending = Chains(motion), Bending(motion)
        self.rows, self.telling = _rows(motion)
        self._rigid = self.filter.spectrum(motion.rigid.tau)  # evaluated on filtered motion already
        self._rates = [self.chains.jomega**order for order in range(3)]
        self._loads: LruCache[np.ndarray] = LruCache()
        rigid = [joint.rigid for joint in motion.robot.joints]
        self._loaded = {
            r.joint: k for k, r in enumerate(self.rows) if r.balance == (MOTOR if rigid[r.joint] else LINK)
        }
        motors, springs = (
            {r.joint: k for k, r in enumerate(self.rows) if r.balance == name} for name in (MOTOR, SPRING)
        )
        self.missing_links = MissingLinks(motion, self._loaded, motors)
        self.sprung_links = SprungLinks(motion, springs)
        self.colours: dict[int, Colour] = {}  # of noise, which only a twin without it tells

    @property
    def settings(self) -> Settings:
        return self.motion.readings.settings

    def residual(self, effects: Sequence[Planned]) -> np.ndarray:
        """(rows, F) spectra of all balances with these effects at work."""
        chains = self._all(effects)
        load = self._rigid + self._rigid_change(effects, chains)
        return np.array([self._row(row, chains[row.joint], load[row.joint]) for row in self.rows])

    def change(self, base: Sequence[Planned], effects: Sequence[Planned]) -> np.ndarray:
        """(rows, F) residual of `effects` minus that of `base`; only joints that differ are evaluated."""
        out = np.zeros((len(self.rows), self.filter.omega.size), dtype=complex)
        for r, spectrum in self.changed(base, effects).items():
            out[r] = spectrum
        return out

    def changed(self, base: Sequence[Planned], effects: Sequence[Planned]) -> dict[int, np.ndarray]:
        """The same, (F,) by row, of the rows that may differ."""
        out: dict[int, np.ndarray] = {}
        sets = self._of_joints(base), self._of_joints(effects)
        if [e.identity for e in _moving_links(base)] == [e.identity for e in _moving_links(effects)]:
            return self._changed_within(base, *sets)
        before, after = (self._chains(lists) for lists in sets)
        load: np.ndarray | float = 0.0
        loading, loaded = self._loading(base, before), self._loading(effects, after)
        if loading != loaded:
            load = self._rigid_change(effects, after) - self._rigid_change(base, before)
        for r, row in enumerate(self.rows):
            j = row.joint
            if row.balance == MOTOR and before[j].scale != after[j].scale:
                was, now = (
                    self._row(row, chains[j], self._rigid[j] + self._rigid_change(of, chains)[j])
                    for of, chains in ((base, before), (effects, after))
                )
                out[r] = now - was
                continue
            if before[j] is not after[j]:
                out[r] = self._row(row, after[j], 0.0) - self._row(row, before[j], 0.0)
            if isinstance(load, np.ndarray) and self._carries_load(row):
                change = load[j] * (after[j].scale if row.balance == MOTOR else 1.0)
                out[r] = out[r] - change if r in out else -change
        return out

    def _changed_within(
        self, base: Sequence[Planned], before_of: Sequence[list[Planned]], after_of: Sequence[list[Planned]]
    ) -> dict[int, np.ndarray]:
        """`changed` from `base` by effects, listed by joint, that leave the rigid-body torques as they are:
        the chains of joints that have the same effects are not looked up."""
        out: dict[int, np.ndarray] = {}
        for j, (had, has) in enumerate(zip(before_of, after_of, strict=True)):
            if [e.identity for e in had] == [e.identity for e in has]:
                continue
            before, after = self.chains.get(j, had), self.chains.get(j, has)
            if before is after:
                continue
            for r, row in enumerate(self.rows):
                if row.joint == j:
                    load: np.ndarray | float = 0.0
                    if row.balance == MOTOR and before.scale != after.scale:
                        load = self._rigid[j] + self._rigid_change(base, self._all(base))[j]
                    out[r] = self._row(row, after, load) - self._row(row, before, load)
        return dict(sorted(out.items()))

    def changed_slightly(
        self, base: Sequence[Planned], effects: Sequence[Planned]
    ) -> dict[int, np.ndarray] | None:
        """`changed` where one effect of a set has other numbers, or is one more, to first order: what sticks
        still does. For derivatives and traces, as the place where each joint begins to slip is not computed
        again for each number of a load, or of a torque within a rigid joint. None for other effects."""
        known, kept = {e.identity for e in base}, {e.key for e in effects}
        moved = [e for e in effects if e.identity not in known]
        if len(moved) != 1 or any(e.key not in kept for e in base):
            return None
        (now,) = moved
        if now.effect.site is Site.BODY:
            return self._changed_by_load(base, effects)
        if now.joint is None:
            return None
        j = self.motion.robot.joint_names.index(now.joint)
        own = self._of_joints(base)[j]
        change = self.chains.slightly(j, own, now)
        if change is None:
            return None
        scale = self.chains.get(j, own).scale
        return {
            r: scale * change for r, row in enumerate(self.rows) if row.joint == j and row.balance == MOTOR
        }

    def _changed_by_load(
        self, base: Sequence[Planned], effects: Sequence[Planned]
    ) -> dict[int, np.ndarray] | None:
        """The same by a body's load; None where a shaft that several joints turn rubs."""
        if any(self.chains.ties.on_shaft(e) and e.effect.overrides("level") for e in base):
            return None
        chains = self._all(base)
        load = self._rigid_change(effects, chains) - self._rigid_change(base, chains)
        out: dict[int, np.ndarray] = {}
        for r, row in enumerate(self.rows):
            change = load[row.joint] * (chains[row.joint].scale if row.balance == MOTOR else 1.0)
            if self._carries_load(row):
                out[r] = -change
            sticking = self.holding(row, chains[row.joint])
            if sticking is not None:
                carried = self.chains.filtered(sticking * self.time_series(change))
                out[r] = out[r] + carried if r in out else carried
        return out

    def holding(self, row: Row, chain: Chain) -> np.ndarray | None:
        """(N,) bool, where a dry friction in a balance carries the load of the link, as it sticks; None where
        none does. A motor's friction carries what its spring does, and the load itself only where the spring
        does not say that. `chain` is the joint's."""
        i, rigid = row.joint, self.motion.robot.joints[row.joint].rigid
        where = []
        if row.balance == MOTOR and (rigid or self.chains.floats(i)):
            where.append(chain.sticking_motor)
        if row.balance == LINK or (row.balance == MOTOR and rigid):
            where.append(chain.sticking_link)
        found = [one for one in where if np.any(one)]
        return np.logical_or.reduce(found) if found else None

    def time_series(self, spectrum: np.ndarray) -> np.ndarray:
        """(..., F) -> (..., N)."""
        return fft.irfft(spectrum, self.filter.size, axis=-1)[..., : self.filter.count]

    def residual_torques(self, effects: Sequence[Planned]) -> np.ndarray:
        """(rows, N) the residual as torques [N m] that measured channels tell, one balance at a time. Where a
        position was computed from the joint's torque sensor, motor and link are balanced with its reading,
        and nothing is left of the spring's own balance."""
        spectra = self.residual(effects)
        series = self.time_series(spectra)
        numbers = Numbers(tuple(drive_of(joint, effects) for joint in self.motion.robot.joints))
        for r, change in self._sprung(dict(enumerate(spectra)), numbers).items():
            series[r] += change
        for i in (i for channel, i in self.motion.missing if channel == "theta"):
            for r in self._at(SPRING, i):
                series[self._at(MOTOR, i)] -= series[r]
                series[self._at(LINK, i)] += series[r]
                series[r] = 0.0
        return series

    def moved(self, spectra: Mapping[int, np.ndarray], numbers: Numbers) -> dict[int, np.ndarray]:
        """(N,) by row, what links without encoder add to balances of a robot with these numbers, whose
        errors, as spectra (F,) by row, move them."""
        out = self._sprung(spectra, numbers)
        if self.missing_links:
            errors = {r: self.time_series(spectrum) for r, spectrum in spectra.items()}
            for r, change in out.items():
                add(errors, r, change)
            for r, change in self.missing_links.moved(errors, numbers).items():
                add(out, r, change)
        return out

    @property
    def moves_links(self) -> bool:
        """Whether errors of balances move links, which have no encoder."""
        return bool(self.missing_links or self.sprung_links.rows)

    def _sprung(self, spectra: Mapping[int, np.ndarray], numbers: Numbers) -> dict[int, np.ndarray]:
        """The same of links of which a torque sensor tells: nothing is left of their springs' balances."""
        out: dict[int, np.ndarray] = {}
        for i, movement in self.sprung_links.movements(spectra, numbers.drives).items():
            row = self.sprung_links.rows[i]
            add(out, row, -self.time_series(spectra[row]))
            for joint, r in self._loaded.items():
                add(out, r, -torque(self.motion, joint, i, movement, numbers))
        return out

    def _at(self, balance: str, joint: int) -> list[int]:
        """The number of a joint's balance; empty where it has none."""
        return [r for r, row in enumerate(self.rows) if row == Row(balance, joint)]

    def torque_scale(self) -> np.ndarray:
        """(n,) RMS torque of each joint [N m]: the larger of motor and load, about zero."""
        readings = self.motion.readings
        used = readings.valid
        load = np.sqrt(np.mean(self.motion.rigid.tau[:, used] ** 2, axis=1))
        torque = readings.torque[:, used]
        drive = np.sqrt(np.mean(np.where(np.isfinite(torque), torque, 0.0) ** 2, axis=1))
        return np.maximum(np.maximum(load, drive), 1e-6)

    # ------------------------------------------------------------------ parts
    def _all(self, effects: Sequence[Planned]) -> list[Chain]:
        return self._chains(self._of_joints(effects))

    def _chains(self, lists: Sequence[Sequence[Planned]]) -> list[Chain]:
        return [self.chains.get(i, own) for i, own in enumerate(lists)]

    def _of_joints(self, effects: Sequence[Planned]) -> list[list[Planned]]:
        """By joint, the effects on which its chain depends: its own, those of joints tied to it, bodies'."""
        own: dict[str | None, list[Planned]] = {joint.name: [] for joint in self.motion.robot.joints}
        bodies = [e for e in effects if e.effect.site is Site.BODY]
        for e in effects:
            if e.joint in own and e.effect.site is not Site.BODY:
                own[e.joint].append(e)
        lists = list(own.values())
        mates = self.chains.ties.mates(effects)
        for i, joints in mates.items():
            lists[i] = [e for k in sorted(joints) for e in own[self.motion.robot.joints[k].name]]
        return [[*effects_of, *bodies] for effects_of in lists]

    def beside(self, effects: Sequence[Planned], e: Planned) -> list[Planned]:
        """Those of the effects on which the change that one makes at its joint depends: those there, at a
        shaft on all joints that it turns, and bodies' loads where a dry friction carries them at rest."""
        names = self.motion.robot.joint_names
        if e.joint is None:
            return [other for other in effects if other.joint is None]
        here = names.index(e.joint)
        joints = {here, *self.chains.ties.mates([*effects, e]).get(here, ())}
        own = [other for other in effects if other.joint in {names[i] for i in joints}]
        loaded = e.effect.site is Site.BODY or any(
            self.chains.rests_on_load(i, [other for other in (*own, e) if other.joint == names[i]])
            for i in joints
        )
        bodies = [other for other in effects if loaded and other.effect.site is Site.BODY]
        return [*(other for other in own if other.effect.site is not Site.BODY), *bodies]

    def _row(self, row: Row, chain: Chain, load: np.ndarray | float) -> np.ndarray:
        if row.balance == SPRING:
            return chain.reading - chain.spring_torque
        spring = chain.reading if row.joint in self.sprung_links else chain.spring_torque
        if row.balance == LINK:
            return spring + chain.link - load
        rigid = self.motion.robot.joints[row.joint].rigid
        return chain.scale * (chain.motor - (load if rigid else spring))

    def _carries_load(self, row: Row) -> bool:
        return row.balance == LINK or (row.balance == MOTOR and self.motion.robot.joints[row.joint].rigid)

    def _loading(self, effects: Sequence[Planned], chains: Sequence[Chain]) -> tuple[object, ...]:
        """What changes the rigid-body torques: BODY effects, and sensors' that correct a link's angle."""
        names = self.motion.robot.joint_names
        corrected = {names[k] for k, chain in enumerate(chains) if chain.q_change is not None}
        return tuple(
            e.identity
            for e in _moving_links(effects)
            if e.effect.site is not Site.SENSOR or e.joint in corrected
        )

    def _rigid_change(self, effects: Sequence[Planned], chains: Sequence[Chain]) -> np.ndarray:
        """(n, F): change of the rigid-body torques by BODY effects and by corrected link angles, to first
        order in the correction; remembered by these effects."""
        make = partial(self._evaluated_rigid_change, effects, chains)
        return self._loads.get(self._loading(effects, chains), make, REMEMBERED)

    def _evaluated_rigid_change(self, effects: Sequence[Planned], chains: Sequence[Chain]) -> np.ndarray:
        rigid = self.motion.rigid
        change = self.chains.loads.added([e for e in effects if e.effect.site is Site.BODY])
        bent = self.bending.drives(effects)
        if bent:
            passed = np.array([chains[i].motor for i in bent])
            swung = self.bending.change(bent, rigid.tau + change, passed)
            for i in bent:
                sticking = chains[i].sticking_motor
                if sticking.size:  # what holds the motor takes whatever the link pulls
                    swung[i, sticking] = 0.0
            change = change + swung
        for k, chain in enumerate(chains):
            if chain.q_change is None:
                continue
            shifts = self.time_series(np.array([rate * chain.q_change for rate in self._rates]))
            for gain, shift in zip((rigid.by_q, rigid.by_v, rigid.mass), shifts, strict=True):
                change = change + gain[:, :, k].T * shift
        return self.filter.spectrum(change)

    def inertial_torque(self, i: int, added: np.ndarray) -> np.ndarray:
        """(n, N) torques of a change (10,) of the inertial parameters of joint i's link."""
        return self.motion.rigid.regressor.torque(i, added)

    def inertial_torques_on(self, joint: int, i: int, added: np.ndarray) -> np.ndarray | None:
        """(d, N) torques on one joint of changes (d, 10) of the inertial parameters of joint i's link; None
        where it does not carry that."""
        return self.motion.rigid.regressor.torques_on(joint, i, added)


class TwinBalances(Balances):
    """Balances of a recording, and (`denoised`) of the same recording with its positions denoised. Columns
    that carry the residual's own noise would bias a regression towards numbers that make a balance
    smaller."""

    def __init__(self, motion: Motion, without_noise: Motion, *, denoised_rest: bool = True) -> None:
        """`denoised_rest`: whether the recording without noise says what a dry friction holds at rest."""
        super().__init__(motion)
        self.denoised = Balances(without_noise)
        self.denoised.chains.noiseless = True
        self.chains.denoised = self.denoised.chains if denoised_rest else None
        self.colours = colours_of(motion.readings, without_noise.readings)


def balances_of(robot: Robot, recording: Recording, settings: Settings = USUAL) -> TwinBalances:
    """The balances of a recording against a robot, with a denoised twin; RecordingError when the
    sensors do not allow any."""
    readings = centred(robot, prepare(robot, recording, settings))
    return TwinBalances(
        reconstruct(robot, readings, recording), reconstruct(robot, denoised(readings), recording)
    )


def drive_of(joint: Joint, effects: Sequence[Planned]) -> Drive:
    """A joint's actuator with some effects at work."""
    drive = joint.drive
    for e in effects:
        if e.joint == joint.name:
            drive = e.effect.edit_drive(drive, e.p)
    return drive


class OnJoint(Protocol):
    """An effect at its place, with or without numbers."""

    @property
    def effect(self) -> Effect: ...

    @property
    def joint(self) -> str | None: ...


def acts_within_a_joint(e: OnJoint) -> bool:
    """Whether an effect changes the balances of its own joint only: a body's load, and an encoder's angle,
    by which bodies are moved, change those of others, and so does friction that acts on a neighbour, too."""
    within = e.effect.site not in (Site.BODY, Site.SENSOR) and not e.effect.reaches_before
    return e.joint is not None and within


def _moving_links(effects: Sequence[Planned]) -> list[Planned]:
    """What of a set may change the rigid-body torques: bodies, and sensors, which may correct an angle; where
    joints bend, by what their motors pass on, all that acts on these."""
    bent = {e.joint for e in effects if e.effect.for_rigid}
    return [
        e
        for e in effects
        if e.effect.site in (Site.BODY, Site.SENSOR) or e.joint in bent or (bent and e.effect.reaches_before)
    ]


def _rows(motion: Motion) -> tuple[tuple[Row, ...], int]:
    """The balances in the order in which they are whitened, each beside those before it, and how many of them
    tell where links without an encoder are, by the spring's torque or else by their own load. These come
    first: nothing is left of them (`Balances.moved`), and a motor's balance carries no errors of other
    joints."""
    rows = []
    for i, joint in enumerate(motion.robot.joints):
        if np.isfinite(motion.readings.torque[i, 0]):
            rows.append(Row(MOTOR, i))
        if joint.rigid:
            continue
        rows.append(Row(LINK, i))
        if np.isfinite(motion.readings.tau_t[i, 0]):
            rows.append(Row(SPRING, i))
    unseen = {i for channel, i in motion.missing if channel == "q"}
    telling = {row.joint: row for row in rows if row.joint in unseen and row.balance in (LINK, SPRING)}
    first = list(telling.values())
    return (*first, *(row for row in rows if row not in first)), len(first)
