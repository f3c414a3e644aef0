"""One joint's side of the balances, from its readings and the effects assumed on it.

This file knows sites of the signal flow, never effects: every effect enters through its own law. A law is
evaluated on unfiltered positions, then filtered (a filter does not commute with a kink).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import fft

from flexjoint.core.lru_cache import LruCache
from flexjoint.diagnosis.balances.dry_friction import DryFriction
from flexjoint.diagnosis.balances.joint_readings import JointReadings
from flexjoint.diagnosis.balances.loads import Loads
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.diagnosis.balances.states import state_along
from flexjoint.diagnosis.signals.signals import later, reach_of_ends
from flexjoint.effects import Drive, Planned, Signals, Site, signal_order
from flexjoint.model.joint import neighbours

INVERSION_ROUNDS = 6  # of the fixed point true = measured - (map(true) - true); slopes near 1 assumed
REMEMBERED = 2e7  # bytes of chains ...
CORRECTED = 1e7  # ... and of readings with what sensors do taken back
SMALL_TORQUE = 1e-3  # of a joint's torque: below every limit, above rounding
LEAST_GAIN = 0.05  # below which a motor is without torque, and its balance no prediction of it
NOWHERE = np.zeros(0, dtype=bool)
DRIVING = ("q", "dq", "theta", "dtheta", "phi", "dphi")  # signals that states may see


@dataclass(frozen=True)
class Chain:
    """One joint's spectra (F,), already filtered."""

    motor: np.ndarray  # torque on the motor other than the spring's
    spring_torque: np.ndarray  # s
    link: np.ndarray  # torque on the link other than the spring's
    reading: np.ndarray  # tau_t, corrected
    q_change: np.ndarray | None  # what sensor effects change of the link angle; None: nothing
    scale: float  # of the motor's balance: one over the gain from recorded to acting torque
    # (N,) bool, or (): where a dry friction of the motor, or of the link, keeps it at rest
    sticking_motor: np.ndarray
    sticking_link: np.ndarray

    @property
    def nbytes(self) -> int:
        return 4 * self.motor.nbytes


class Chains:
    """Chains of all joints along one motion, remembered by the effects on them."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.filter, self.jomega = motion.filter, 1j * motion.filter.omega
        self.period = motion.readings.period
        self.t = motion.readings.time - motion.readings.start
        self.floating = motion.robot.file.offsets == "per_recording"
        self.denoised: Chains | None = None  # of the same motion without its sensors' noise
        self._recent: LruCache[Chain] = LruCache()
        self._bases: dict[int, JointReadings] = {}
        self._corrected: LruCache[JointReadings] = LruCache()
        self.loads = Loads(motion)
        self.friction = DryFriction(motion.filter, motion.readings.sigma, motion.readings.settings.balances)

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

    def get(self, i: int, effects: Sequence[Planned]) -> Chain:
        """The chain of joint i with these effects at work, its own and those of bodies."""
        if not self.rests_on_load(i, effects):
            effects = [e for e in effects if e.effect.site is not Site.BODY]
        effects = signal_order(effects)
        key = (i, *(e.identity for e in effects))
        return self._recent.get(key, lambda: self._chain(i, effects), REMEMBERED)

    def rests_on_load(self, i: int, effects: Sequence[Planned]) -> bool:
        """Whether a dry friction of joint i carries the load of its link at rest: one of the link, or one of
        a motor whose load does not follow from its spring."""
        sites = {e.effect.site for e in effects if e.effect.overrides("level")}
        return Site.LINK in sites or (
            Site.MOTOR in sites and (self.motion.robot.joints[i].rigid or self._floats(i))
        )

    def _chain(self, i: int, effects: Sequence[Planned]) -> Chain:
        joint, base, s = self.motion.robot.joints[i], self.base(i), self.jomega
        at = _by_site(effects)
        drive, gated = joint.drive, []
        for e in effects:
            if e.since is not None and e.effect.overrides("edit_drive"):
                gated.append(e)
            else:
                drive = e.effect.edit_drive(drive, e.p)
        readings = self.readings(i, at[Site.SENSOR])
        q, theta, q_hat, theta_hat = readings.q, readings.theta, readings.q_hat, readings.theta_hat
        torque, torque_hat, scale = base.torque, base.torque_hat, 1.0
        if at[Site.COMMAND]:
            scale = self.command_scale(i, at[Site.COMMAND])
            torque = self.command(i, at[Site.COMMAND])
            torque_hat = self._filtered(torque)

        # what no effect touches is the same in every chain
        nominal = drive is joint.drive
        signals = Signals(t=self.t, q=q, theta=theta, phi=theta - q, tau_m=torque)
        if effects:
            signals.dtheta, signals.dq = readings.dtheta, readings.dq
            signals.dphi = signals.dtheta - signals.dq
        spring_hat = np.zeros_like(theta_hat)
        if not joint.rigid:
            linear = readings.spring_hat if nominal else (drive.K + drive.D * s) * (theta_hat - q_hat)
            spring_hat = self._spring(drive, signals, linear, at)
        if effects:
            signals.tau_t = self._transmitted(i, readings, spring_hat)
        shaft_hat = readings.shaft_hat if nominal else (drive.B * s**2 + drive.D_m * s) * theta_hat
        motor_hat = torque_hat - shaft_hat
        for e in gated:
            motor_hat, spring_hat = self._gated_drive(e, drive, motor_hat, spring_hat, q_hat, theta_hat)
        motor_hat = motor_hat + self._torques(at[Site.MOTOR], signals)
        link_hat = self._torques(at[Site.LINK], signals)
        denoised, sticking_motor, sticking_link = None, NOWHERE, NOWHERE
        if self.denoised is not None and _dry(effects):
            denoised = self.denoised.get(i, [e for e in effects if not e.effect.overrides("level")])
        if _dry(at[Site.LINK]):
            own = self._pulling(i, at, motor_hat, spring_hat, readings.reading)
            rubbing, sticking_link = self._link_friction(i, at, signals, own + link_hat, denoised)
            link_hat = link_hat + rubbing
        if _dry(at[Site.MOTOR]) and base.driven:
            net_hat = motor_hat - self._load(i, at[Site.BODY], spring_hat, link_hat, readings.reading)
            rubbing, sticking_motor = self._motor_friction(i, at, signals, drive, net_hat, denoised)
            motor_hat = motor_hat + rubbing
        change = q_hat - base.q_hat if q is not base.q else None
        if joint.rigid:
            motor_hat, link_hat = motor_hat + link_hat, 0.0
        link_hat = link_hat + np.zeros_like(spring_hat)
        return Chain(
            motor_hat, spring_hat, link_hat, readings.reading, change, scale, sticking_motor, sticking_link
        )

    def command_scale(self, i: int, effects: Sequence[Planned]) -> float:
        """One over the gain that effects of the command have for a small torque. A balance is counted in
        recorded torque: a gain of nearly nothing would make it small, and all errors of the model with it."""
        if any(e.since is not None for e in effects):
            return 1.0
        step = SMALL_TORQUE * float(np.std(self.base(i).torque))
        up, down = Signals(t=0.0), Signals(t=0.0)
        high, low = step, -step
        for e in signal_order(effects):
            high, low = float(e.effect.map(up, e.p, high)), float(e.effect.map(down, e.p, low))
        gain = (high - low) / (2.0 * step) if step > 0.0 else 1.0
        return 1.0 / gain if gain > LEAST_GAIN else 1.0

    def _load(
        self,
        i: int,
        bodies: Sequence[Planned],
        spring_hat: np.ndarray,
        link_hat: np.ndarray | float,
        reading: np.ndarray,
    ) -> np.ndarray:
        """Spectrum of the load of a motor: the spring's torque, from the sensors that measure it best. With
        unknown encoder offsets these give it up to a constant only, and it follows from the link's
        dynamics."""
        if self.motion.robot.joints[i].rigid or self._floats(i):
            return self.filter.spectrum(self.loads.carried(i, bodies)) - link_hat
        return self.base(i).combined(spring_hat, reading)

    def _floats(self, i: int) -> bool:
        """Whether the torque of joint i's spring is known up to a constant only: with unknown encoder offsets
        and no torque sensor (by which they are centred)."""
        return self.floating and not np.isfinite(self.motion.readings.tau_t[i, 0])

    def _transmitted(self, i: int, readings: JointReadings, spring_hat: np.ndarray) -> np.ndarray:
        """(N,) the torque of joint i's transmission; with unknown encoder offsets it follows from the
        load."""
        if self.motion.robot.joints[i].rigid or self._floats(i):
            return self.motion.rigid.tau[i]
        return readings.spring if spring_hat is readings.spring_hat else self._time(spring_hat)

    # ------------------------------------------------------------------ sites
    def _true_readings(self, i: int, sensors: Sequence[Planned]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings with the sensors' effects taken back, the last one first."""
        base = self.base(i)
        readings = {"q": base.q, "theta": base.theta, "tau_t": base.tau_t}
        rigid = self.motion.robot.joints[i].rigid
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
                readings[channel] = self._since(e, true, measured)
        q = readings["theta"] if rigid else readings["q"]
        return q, readings["theta"], readings["tau_t"]

    def command(self, i: int, effects: Sequence[Planned]) -> np.ndarray:
        """(N,) what effects of the command make of joint i's torque."""
        base = self.base(i)
        torque = base.torque
        signals = Signals(t=self.t, q=base.q, dq=base.dq, theta=base.theta, dtheta=base.dtheta)
        # 0 where a neighbour's torque is not recorded: then its effect here cannot be seen
        torques = [self.base(k).torque for k in range(len(self.motion.robot.joints))]
        signals.tau_m_before, signals.tau_m_after = neighbours(torques, i)
        for e in signal_order(effects):
            p, before, signals.tau_m = e.p, torque, torque
            if e.effect.overrides("delay"):
                torque = later(torque, float(e.effect.delay(p)) / self.period)
            torque = e.effect.map(signals, p, torque)
            if e.effect.states:
                torque = torque + e.effect.torque(signals, p, state_along(e, signals, self.period, 0))
            torque = self._since(e, torque, before)
        return torque

    def _spring(
        self,
        drive: Drive,
        signals: Signals,
        linear: np.ndarray,
        at: dict[Site, list[Planned]],
    ) -> np.ndarray:
        """Spectrum of s: `linear` part from the filtered encoders, effects from the unfiltered deflection.
        Sets signals.phi and dphi to what the deflection effects leave (SPRING laws see that)."""
        if not at[Site.DEFLECTION] and not at[Site.SPRING]:
            return linear
        extra = np.zeros_like(signals.phi)
        for e in at[Site.DEFLECTION]:
            p = e.p
            mapped = self._since(e, e.effect.map(signals, p, signals.phi), signals.phi)
            left = self._since(e, e.effect.slope(signals, p) * np.ones_like(mapped), np.ones_like(mapped))
            extra = extra + drive.K * (mapped - signals.phi) + drive.D * (left - 1.0) * signals.dphi
            signals.phi, signals.dphi = mapped, left * signals.dphi
        for e in at[Site.SPRING]:
            if e.effect.overrides("torque"):
                torque = e.effect.torque(signals, e.p, self._state(e, signals))
                extra = extra + self._since(e, torque, np.zeros_like(extra))
        return linear + self._filtered(extra)

    def _gated_drive(
        self,
        e: Planned,
        drive: Drive,
        motor: np.ndarray,
        spring: np.ndarray,
        q_hat: np.ndarray,
        theta_hat: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """A change of K, D, B or D_m that sets in during the recording: its torque, gated in time."""
        s, edited = self.jomega, e.effect.edit_drive(drive, e.p)
        gate = (self.t >= (e.since or 0.0)).astype(float)
        shaft = ((edited.B - drive.B) * s**2 + (edited.D_m - drive.D_m) * s) * theta_hat
        motor = motor - self.filter.spectrum(gate * self._time(shaft))
        if np.isfinite(drive.K):
            twist = ((edited.K - drive.K) + (edited.D - drive.D) * s) * (theta_hat - q_hat)
            spring = spring + self.filter.spectrum(gate * self._time(twist))
        return motor, spring

    def _torques(self, effects: Sequence[Planned], signals: Signals) -> np.ndarray | float:
        """Spectrum of the torques (not the dry frictions) that act on the motor or the link."""
        acting = [e for e in effects if e.effect.overrides("torque")]
        if not acting:
            return 0.0
        total = np.zeros(self.filter.count)
        for e in acting:
            torque = e.effect.torque(signals, e.p, self._state(e, signals)) * np.ones_like(total)
            total = total + self._since(e, torque, np.zeros_like(total))
        return self._filtered(total)

    # ------------------------------------------------------------------ dry friction
    def _link_friction(
        self,
        i: int,
        at: Mapping[Site, Sequence[Planned]],
        signals: Signals,
        torque_hat: np.ndarray,
        denoised: Chain | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        load = self.loads.carried(i, at[Site.BODY])
        if self.denoised is not None and denoised is not None:
            own = self._pulling(i, at, denoised.motor, denoised.spring_torque, denoised.reading)
            net, denoised_net = self._times(torque_hat, own + denoised.link)
            net, denoised_net = net - load, denoised_net - self.denoised.loads.carried(i, at[Site.BODY])
        else:
            net = denoised_net = self._time(torque_hat) - load
        if self.floating:
            net, denoised_net = net - np.mean(net), denoised_net - np.mean(denoised_net)
        return self._rubbing(
            _dry(at[Site.LINK]), signals, signals.dq, net, denoised_net, self._link_inertia(i), self._noise(i)
        )

    def _pulling(
        self,
        i: int,
        at: Mapping[Site, Sequence[Planned]],
        motor_hat: np.ndarray,
        spring_hat: np.ndarray,
        reading: np.ndarray,
    ) -> np.ndarray:
        """Spectrum of what pulls at a link from its motor's side."""
        if self.motion.robot.joints[i].rigid:
            return motor_hat
        return self.base(i).combined(spring_hat, reading, None if _dry(at[Site.MOTOR]) else motor_hat)

    def _motor_friction(
        self,
        i: int,
        at: Mapping[Site, Sequence[Planned]],
        signals: Signals,
        drive: Drive,
        net_hat: np.ndarray,
        denoised: Chain | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        rigid = self.motion.robot.joints[i].rigid
        inertia = float(drive.B) + (self._link_inertia(i) if rigid else 0.0)
        if self.denoised is not None and denoised is not None:
            load = self.denoised._load(
                i, at[Site.BODY], denoised.spring_torque, denoised.link, denoised.reading
            )
            denoised_hat = denoised.motor - load
            net, denoised_net = self._times(net_hat, denoised_hat)
        else:
            net = denoised_net = self._time(net_hat)
        return self._rubbing(
            _dry(at[Site.MOTOR]), signals, signals.dtheta, net, denoised_net, inertia, self._noise(i)
        )

    def _noise(self, i: int) -> float:
        """Noise of joint i's positions: an angle without a sensor is made of the other one."""
        return max(float(self.motion.readings.noise[channel][i]) for channel in ("q", "theta"))

    def _link_inertia(self, i: int) -> float:
        return float(np.mean(self.motion.rigid.mass[:, i, i]))

    def _rubbing(
        self,
        effects: Sequence[Planned],
        signals: Signals,
        speed: np.ndarray,
        net: np.ndarray,
        denoised_net: np.ndarray,
        inertia: float,
        noise: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Spectrum of the effects' dry friction, and where it holds (dry_friction.py)."""
        limits = self.motion.readings.settings.balances
        levels = self._levels(effects, signals, speed, limits.rest_speed)
        rest = self.friction.rest_speed(levels, inertia, noise)
        if rest < limits.rest_speed:
            levels = self._levels(effects, signals, speed, rest)
        return self.friction.spectrum(levels, speed, net, denoised_net, inertia, rest)

    def _levels(
        self, effects: Sequence[Planned], signals: Signals, speed: np.ndarray, rest: float
    ) -> np.ndarray:
        """(2, N) levels of the effects' dry friction backward and forward: at rest the sign of the measured
        speed is noise. Below the speed that the data resolve, the levels at that speed are taken."""
        resolved = np.maximum(np.abs(speed), rest)
        ways = [replace(signals, dtheta=v, dq=v) for v in (-resolved, resolved)]
        levels = np.zeros((2, speed.size))
        for e in effects:
            state = self._state(e, signals)
            values = np.array([e.effect.level(going, e.p, state) * np.ones_like(speed) for going in ways])
            levels = levels + self._since(e, values, np.zeros_like(values))
        return levels

    # ------------------------------------------------------------------ helpers
    def _state(self, e: Planned, signals: Signals) -> np.ndarray | float:
        """Internal state of an effect along the recording, driven by its joint's signals without noise."""
        if not e.effect.states:
            return 0.0
        smooth = self._without_noise(e, signals)
        smooth.phi = self.filter.smooth(smooth.phi)
        return state_along(e, smooth, self.period, reach_of_ends(self.motion.readings))

    def _without_noise(self, e: Planned, signals: Signals) -> Signals:
        """A copy of the signals of an effect's joint without their sensors' noise: a state's law takes the
        magnitude of a speed, and a mean of noise does not vanish there."""
        if self.denoised is None or e.joint is None:
            return replace(signals)
        noise = self.base(self.motion.robot.joint_names.index(e.joint)).noise
        less = {name: getattr(signals, name) - getattr(noise, name) for name in DRIVING}
        return replace(signals, **less)

    def _since(self, e: Planned, with_effect: np.ndarray, without: np.ndarray) -> np.ndarray:
        return with_effect if e.since is None else np.where(self.t >= e.since, with_effect, without)

    def _filtered(self, x: np.ndarray) -> np.ndarray:
        return self.filter.spectrum(x) * self.filter.gain

    def _time(self, spectrum: np.ndarray) -> np.ndarray:
        return fft.irfft(spectrum, self.filter.size)[: self.filter.count]

    def _times(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(2, N) the same of two spectra at once, which takes little longer than of one."""
        return fft.irfft(np.array([one, other]), self.filter.size)[:, : self.filter.count]


def _by_site(effects: Sequence[Planned]) -> dict[Site, list[Planned]]:
    sites: dict[Site, list[Planned]] = {site: [] for site in Site}
    for e in effects:
        sites[e.effect.site].append(e)
    return sites


def _dry(effects: Sequence[Planned]) -> list[Planned]:
    """Those that are a dry friction."""
    return [e for e in effects if e.effect.overrides("level")]
