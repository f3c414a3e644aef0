"""Laws of effects along one motion: from readings and effects to torques, in time and as filtered spectra.

A law is evaluated on unfiltered positions, then filtered (a filter does not commute with a kink).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy import fft

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.dry_friction import DryFriction, Speed
from flexjoint.diagnosis.balances.joint_readings import JointReadings
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.diagnosis.balances.states import play, state_along
from flexjoint.diagnosis.balances.ties import Ties
from flexjoint.diagnosis.signals.signals import later, reach_of_ends
from flexjoint.effects import Drive, Planned, Signals, Site, signal_order
from flexjoint.model.joint import neighbours

INVERSION_ROUNDS = 6  # of the fixed point true = measured - (map(true) - true); slopes near 1 assumed
CORRECTED = 1e7  # bytes of readings with what sensors do taken back
STATES = 1e7  # bytes of states along the motion as it was read
SMALL_TORQUE = 1e-3  # of a joint's torque: below every limit, above rounding
LEAST_GAIN = 0.05  # below which a motor is without torque, and its balance no prediction of it
DRIVING = ("q", "dq", "theta", "dtheta", "phi", "dphi")  # signals that states may see


class Laws:
    """Readings of all joints, and what laws make of them."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.filter, self.jomega = motion.filter, 1j * motion.filter.omega
        self.period = motion.readings.period
        self.t = motion.readings.time - motion.readings.start
        self.floating = motion.robot.file.offsets == "per_recording"
        self.ties = Ties(motion.robot)
        self._bases: dict[int, JointReadings] = {}
        self._played: dict[tuple[int, str], np.ndarray | None] = {}
        self._corrected: LruCache[JointReadings] = LruCache()
        self._states: LruCache[np.ndarray] = LruCache()
        self.friction = DryFriction(motion.filter, motion.readings.sigma, motion.readings.settings.balances)

    @property
    def has_twin(self) -> bool:
        """Whether the same motion is known without its sensors' noise."""
        return False

    @property
    def is_twin(self) -> bool:
        """Whether the motion is one without its sensors' noise."""
        return False

    # ------------------------------------------------------------------ readings
    def base(self, i: int) -> JointReadings:
        if i not in self._bases:
            self._bases[i] = JointReadings(self.motion, i)
        return self._bases[i]

    def readings(self, i: int, sensors: Sequence[Planned]) -> JointReadings:
        """The readings of joint i with what effects of its sensors do taken back."""
        if not sensors:
            return self.base(i)
        key = (i, *(e.identity for e in sensors))
        make = partial(JointReadings, self.motion, i)
        return self._corrected.get(key, lambda: make(self._true_readings(i, sensors)), CORRECTED)

    def _true_readings(self, i: int, sensors: Sequence[Planned]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings with the sensors' effects taken back, the last one first."""
        base = self.base(i)
        readings = {"q": base.q, "theta": base.theta, "tau_t": base.tau_t}
        for e in reversed(sensors):
            p = e.p
            for channel in e.effect.channels(p):
                if channel not in readings or not np.isfinite(readings[channel][0]):
                    continue
                measured = true = readings[channel]
                if e.effect.overrides("map"):
                    for _ in range(INVERSION_ROUNDS):
                        true = measured - (e.effect.map(Signals(t=self.t), p, true) - true)
                if e.effect.overrides("delay"):
                    true = later(true, -float(e.effect.delay(p)) / self.period)
                readings[channel] = self.since(e, true, measured)
        joint = self.motion.robot.joints[i]
        if joint.rigid:
            readings["q"] = readings["theta"] = readings[self.motion.readings.encoder(joint.name)]
        return readings["q"], readings["theta"], readings["tau_t"]

    def sensors(self, i: int, effects: Sequence[Planned]) -> list[Planned]:
        """Those of the effects that act on joint i's sensors."""
        name = self.motion.robot.joints[i].name
        return [e for e in effects if e.effect.site is Site.SENSOR and e.joint == name]

    def signals(self, i: int, effects: Sequence[Planned]) -> Signals:
        """What laws may see of joint i, nominal springs assumed."""
        r, torques = self.readings(i, self.sensors(i, effects)), self.torques()
        s = Signals(self.t, r.q, r.dq, r.theta, r.dtheta, r.phi, r.dphi, tau_m=torques[i])
        from_load = self.motion.robot.joints[i].rigid or self.floats(i)
        s.tau_t = self.motion.rigid.tau[i] if from_load else r.spring
        s.tau_m_before, s.tau_m_after = neighbours(torques, i)
        return s

    def torques(self) -> list[np.ndarray]:
        """(N,) recorded torques; 0 where a joint's is not recorded: then its effect elsewhere cannot be
        seen."""
        return [self.base(k).torque for k in range(len(self.motion.robot.joints))]

    def speed(self, i: int, name: str, signals: Signals) -> Speed:
        """The filtered speed `name` (dq, dtheta) of joint i among its signals. A body moves, and not the
        noise of its sensor: as far as that is known it is taken out."""
        base, speed = self.base(i), np.asarray(getattr(signals, name))
        # an angle without a sensor is made of the other one
        noise = max(float(self.motion.readings.noise[channel][i]) for channel in ("q", "theta"))
        noise *= self.friction.speed_noise
        if self.has_twin:
            taken = getattr(base.noise, name)
            return Speed(speed - taken, base.speed_errors[name], taken, noise)
        error = base.speed_errors[name] if self.is_twin else np.full(speed.size, noise)
        return Speed(speed, error, np.zeros(speed.size), 0.0)

    def moves(self, i: int, name: str) -> np.ndarray:
        """(N,) bool, where a speed (dq, dtheta) of joint i tells which way it goes."""
        base = self.base(i)
        speed = self.speed(i, name, Signals(dq=base.dq, dtheta=base.dtheta))
        return np.asarray(np.abs(speed.clean) > self.friction.rest_speed(speed.error))

    def floats(self, i: int) -> bool:
        """Whether the torque of joint i's spring is known up to a constant only: with unknown encoder offsets
        and no torque sensor (by which they are centred)."""
        return self.floating and not np.isfinite(self.motion.readings.tau_t[i, 0])

    # ------------------------------------------------------------------ torques
    def command_scale(self, i: int, effects: Sequence[Planned]) -> float:
        """One over the gain that effects of the command have for a small torque. A balance is counted in
        recorded torque: a gain of nearly nothing would make it small, and all errors of the model with it."""
        if any(e.since is not None for e in effects) or i in self.ties.coupled:
            return 1.0
        step = SMALL_TORQUE * float(np.std(self.base(i).torque))
        up, down = Signals(t=0.0), Signals(t=0.0)
        high, low = step, -step
        for e in signal_order(effects):
            high, low = float(e.effect.map(up, e.p, high)), float(e.effect.map(down, e.p, low))
        gain = (high - low) / (2.0 * step) if step > 0.0 else 1.0
        return 1.0 / gain if gain > LEAST_GAIN else 1.0

    def command(self, i: int, effects: Sequence[Planned], more: float = 0.0) -> np.ndarray:
        """(N,) what effects of the command make of joint i's torque, and of `more` [N m] beside it."""
        base = self.base(i)
        torque = base.torque + more
        signals = Signals(t=self.t, q=base.q, dq=base.dq, theta=base.theta, dtheta=base.dtheta)
        signals.tau_m_before, signals.tau_m_after = neighbours(self.torques(), i)
        return self.commanded(effects, torque, signals)

    def commanded(self, effects: Sequence[Planned], torque: np.ndarray, signals: Signals) -> np.ndarray:
        """(N,) what effects of the command make of a torque (N,)."""
        signals = replace(signals)
        for e in signal_order(effects):
            p, before, signals.tau_m = e.p, torque, torque
            if e.effect.overrides("delay"):
                torque = later(torque, float(e.effect.delay(p)) / self.period)
            torque = e.effect.map(signals, p, torque)
            if e.effect.states:
                torque = torque + e.effect.torque(signals, p, state_along(e, signals, self.period, 0))
            torque = self.since(e, torque, before)
        return torque

    def shaft_taken(self, drive: Drive, laws: Sequence[Planned], theta_hat: np.ndarray) -> np.ndarray:
        """Spectrum of what a motor's inertia and damping, as effects change them, take for its own motion."""
        s, gated = self.jomega, []
        for e in laws:
            if e.since is not None and e.effect.overrides("edit_drive"):
                gated.append(e)
            else:
                drive = e.effect.edit_drive(drive, e.p)
        taken = (drive.B * s**2 + drive.D_m * s) * theta_hat
        for e in gated:
            edited = e.effect.edit_drive(drive, e.p)
            more = ((edited.B - drive.B) * s**2 + (edited.D_m - drive.D_m) * s) * theta_hat
            taken = taken + self.filter.spectrum(e.acts(self.t) * self.time_series(more))
        return np.asarray(taken)

    def along(self, effects: Sequence[Planned], signals: Signals) -> np.ndarray | float:
        """Spectrum of the torques (not the dry frictions) that act on the motor or the link."""
        acting = [e for e in effects if e.effect.overrides("torque")]
        return self.filtered(self.torque_along(acting, signals)) if acting else 0.0

    def torque_along(self, effects: Sequence[Planned], signals: Signals) -> np.ndarray:
        """(N,) the same before it is filtered."""
        total = np.zeros(self.filter.count)
        for e in effects:
            torque = e.effect.torque(signals, e.p, self.state(e, signals)) * np.ones_like(total)
            total = total + self.since(e, torque, np.zeros_like(total))
        return total

    # ------------------------------------------------------------------ dry friction
    def dry_of(self, i: int, effects: Sequence[Planned]) -> list[Planned]:
        """The dry frictions on joint i's own motor, or on its link where that is one with it."""
        joint = self.motion.robot.joints[i]
        sites = (Site.MOTOR, Site.LINK) if joint.rigid else (Site.MOTOR,)
        own = [e for e in effects if e.joint == joint.name and e.effect.site in sites]
        return [e for e in dry(own) if not self.ties.on_shaft(e)]

    def sliding(self, effects: Sequence[Planned], signals: Signals) -> np.ndarray:
        """(N,) dry friction as far as what rubs moves, 0 elsewhere."""
        speed, rest = np.asarray(signals.dtheta), self.motion.readings.settings.balances.rest_speed
        rubbing = dry(effects)
        states = [self.state(e, signals) for e in rubbing]
        backward, forward = self.levels(rubbing, signals, speed, rest, states)
        return np.where(np.abs(speed) <= rest, 0.0, np.where(speed < 0.0, backward, -forward))

    def rubbing(
        self,
        effects: Sequence[Planned],
        signals: Signals,
        speed: Speed,
        net: np.ndarray,
        denoised_net: np.ndarray,
        inertia: float,
        shared: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Spectrum of the effects' dry friction, and where it holds (dry_friction.py)."""
        states = [self.state(e, signals) for e in effects]
        levels = self.levels(effects, signals, speed.clean, self.friction.rest_speed(speed.error), states)
        return self.friction.spectrum(levels, speed, net, denoised_net, inertia, shared)

    def levels(
        self,
        effects: Sequence[Planned],
        signals: Signals,
        speed: np.ndarray,
        rest: np.ndarray | float,
        states: Sequence[np.ndarray | float],
    ) -> np.ndarray:
        """(2, N) levels of the effects' dry friction in their `states`, backward and forward: at rest the
        sign of the measured speed is noise. Below the speed that the data resolve, the levels at that speed
        are taken."""
        resolved = np.maximum(np.abs(speed), rest)
        ways = [replace(signals, dtheta=v, dq=v) for v in (-resolved, resolved)]
        levels = np.zeros((2, speed.size))
        for e, state in zip(effects, states, strict=True):
            values = np.array([e.effect.level(going, e.p, state) * np.ones_like(speed) for going in ways])
            levels = levels + self.since(e, values, np.zeros_like(values))
        return levels

    def inertias(self, joints: Sequence[int], effects: Sequence[Planned]) -> np.ndarray:
        """(k, k) mean inertia of some joints' motors; of rigid joints with their links'."""
        robot = self.motion.robot
        own = []
        for i in joints:
            drive = robot.joints[i].drive
            for e in effects:
                if e.joint == robot.joints[i].name:
                    drive = e.effect.edit_drive(drive, e.p)
            own.append(float(drive.B))
        mass = np.diag(own)
        for coupling in robot.couplings:
            if set(coupling.joints) <= set(joints):
                at = np.ix_(*2 * [[joints.index(i) for i in coupling.joints]])
                turns = np.array(coupling.matrix)
                mass[at] = turns.T @ mass[at] @ turns
        if all(robot.joints[i].rigid for i in joints):
            mass = mass + self.motion.rigid.mean_mass[np.ix_(joints, joints)]
        return mass

    def link_inertia(self, i: int) -> float:
        return float(self.motion.rigid.mean_mass[i, i])

    # ------------------------------------------------------------------ helpers
    def state(self, e: Planned, signals: Signals) -> np.ndarray | float:
        """Internal state of an effect along the recording, driven by its joint's signals without noise."""
        if not e.effect.states:
            return 0.0

        def along() -> np.ndarray:
            smooth = self._without_noise(e, signals)
            smooth.phi = self.filter.smooth(smooth.phi)
            return state_along(e, smooth, self.period, reach_of_ends(self.motion.readings))

        if e.joint is None:
            return along()
        base = self.base(self.motion.robot.joint_names.index(e.joint))
        if any(getattr(signals, name) is not getattr(base, name) for name in DRIVING):  # effects change them
            return along()
        return self._states.get(e.identity, along, STATES)

    def _without_noise(self, e: Planned, signals: Signals) -> Signals:
        """A copy of the signals of an effect's joint without their sensors' noise: a state's law takes the
        magnitude of a speed, and a mean of noise does not vanish there. What a Wiener filter leaves of the
        noise still makes way without end: rates are those behind a play as wide."""
        if e.joint is None:
            return replace(signals)
        i = self.motion.robot.joint_names.index(e.joint)
        base = self.base(i)
        less = {name: getattr(signals, name) for name in DRIVING}
        if self.has_twin:
            less = {name: x - getattr(base.noise, name) for name, x in less.items()}
        for name in base.position_errors:
            read = getattr(signals, name) is getattr(base, name)  # no effect has changed it
            rate = self._behind_play(i, name) if read else self._rate_behind_play(i, name, less[name])
            if rate is not None:
                less[f"d{name}"] = rate
        return replace(signals, **less)

    def _behind_play(self, i: int, name: str) -> np.ndarray | None:
        """The rate of an angle of joint i as it was read, behind the play; None without one."""
        if (i, name) not in self._played:
            base = self.base(i)
            less = getattr(base, name) - (getattr(base.noise, name) if self.has_twin else 0.0)
            self._played[i, name] = self._rate_behind_play(i, name, less)
        return self._played[i, name]

    def _rate_behind_play(self, i: int, name: str, angle: np.ndarray) -> np.ndarray | None:
        width = self.motion.readings.settings.balances.play_deviations * self.base(i).position_errors[name]
        return np.gradient(play(angle, width), self.period) if np.any(width > 0.0) else None

    def since(self, e: Planned, with_effect: np.ndarray, without: np.ndarray) -> np.ndarray:
        return with_effect if e.since is None else np.where(e.acts(self.t), with_effect, without)

    def filtered(self, x: np.ndarray) -> np.ndarray:
        return self.filter.spectrum(x) * self.filter.gain

    def time_series(self, spectrum: np.ndarray) -> np.ndarray:
        return fft.irfft(spectrum, self.filter.size)[: self.filter.count]

    def two_series(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(2, N) the same of two spectra at once, which takes little longer than of one."""
        return fft.irfft(np.array([one, other]), self.filter.size)[:, : self.filter.count]


def by_site(effects: Sequence[Planned]) -> dict[Site, list[Planned]]:
    """The effects by their site."""
    sites: dict[Site, list[Planned]] = {site: [] for site in Site}
    for e in effects:
        sites[e.effect.site].append(e)
    return sites


def dry(effects: Sequence[Planned]) -> list[Planned]:
    """Those that are a dry friction."""
    return [e for e in effects if e.effect.overrides("level")]
