"""One joint's side of the balances, from its readings and the effects assumed on it.

This file knows sites of the signal flow, never effects: every effect enters through its own law. A law is
evaluated on unfiltered positions, then filtered (a filter does not commute with a kink).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.running.lru_cache import LruCache
from flexjoint.diagnosis.balances.joint_readings import JointReadings
from flexjoint.diagnosis.balances.laws import Laws, by_site, dry
from flexjoint.diagnosis.balances.links.loads import Loads
from flexjoint.diagnosis.balances.motion import Motion
from flexjoint.diagnosis.balances.shafts import Shafts
from flexjoint.effects import Drive, Planned, Signals, Site, signal_order

REMEMBERED = 2e7  # bytes of chains
NOWHERE = np.zeros(0, dtype=bool)


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


class Chains(Laws):
    """Chains of all joints along one motion, remembered by the effects on them."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self.denoised: Chains | None = None  # of the same motion without its sensors' noise
        self.noiseless = False  # whether these are such ones
        self._recent: LruCache[Chain] = LruCache()
        self.loads = Loads(motion)
        self.shafts = Shafts(self, self._pull)

    @property
    def has_twin(self) -> bool:
        return self.denoised is not None

    @property
    def is_twin(self) -> bool:
        return self.noiseless

    def get(self, i: int, effects: Sequence[Planned]) -> Chain:
        """The chain of joint i with these effects at work, its own, those of joints tied to it, and of
        bodies."""
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
            Site.MOTOR in sites and (self.motion.robot.joints[i].rigid or self.floats(i))
        )

    def _chain(self, i: int, effects: Sequence[Planned]) -> Chain:
        joint, base, s = self.motion.robot.joints[i], self.base(i), self.jomega
        every = effects
        effects = [e for e in effects if e.effect.site is Site.BODY or e.joint == joint.name]
        drive, gated = self._drive_of(i, effects)
        effects = [e for e in effects if not self.ties.on_shaft(e)]
        at = by_site(effects)
        readings = self.readings(i, at[Site.SENSOR])
        q, q_hat, theta_hat = readings.q, readings.q_hat, readings.theta_hat
        torque, torque_hat, scale = base.torque, base.torque_hat, 1.0
        if at[Site.COMMAND]:
            scale = self.command_scale(i, at[Site.COMMAND])
            torque = self.command(i, at[Site.COMMAND])
            torque_hat = self.filtered(torque)

        # what no effect touches is the same in every chain
        nominal = drive is joint.drive
        signals = self._seen(readings, torque, moving=bool(effects))
        spring_hat = np.zeros_like(theta_hat)
        if not joint.rigid:
            linear = readings.spring_hat if nominal else (drive.K + drive.D * s) * readings.phi_hat
            spring_hat = self._spring(drive, signals, linear, at)
        if effects:
            signals.tau_t = self._transmitted(i, readings, spring_hat)
        shaft_hat = readings.shaft_hat if nominal else (drive.B * s**2 + drive.D_m * s) * theta_hat
        motor_hat = torque_hat - shaft_hat
        for e, edited in gated:
            motor_hat, spring_hat = self._gated_drive(
                e, drive, edited, motor_hat, spring_hat, readings.phi_hat, theta_hat
            )
        turning = self.shafts.torque(i, every)
        if turning is not None:
            motor_hat = motor_hat + turning
        motor_hat = motor_hat + self.along(at[Site.MOTOR], signals)
        link_hat = self.along(at[Site.LINK], signals)
        sticking_motor, sticking_link = NOWHERE, NOWHERE
        denoised = self._denoised(i, every) if dry(effects) else None
        if dry(at[Site.LINK]):
            own = self._pulling(i, at, motor_hat, spring_hat, readings.reading)
            rubbing, sticking_link = self._link_friction(i, at, signals, own + link_hat, denoised)
            link_hat = link_hat + rubbing
        if dry(at[Site.MOTOR]) and base.driven:
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

    def _seen(self, readings: JointReadings, torque: np.ndarray, moving: bool = True) -> Signals:
        """What laws see of a joint's positions and command; of speeds only where it is `moving`."""
        signals = Signals(t=self.t, q=readings.q, theta=readings.theta, phi=readings.phi, tau_m=torque)
        if moving:
            signals.dtheta, signals.dq, signals.dphi = readings.dtheta, readings.dq, readings.dphi
        return signals

    def slightly(self, i: int, effects: Sequence[Planned], now: Planned) -> np.ndarray | None:
        """(F,) change of a rigid joint's torques by one more torque `now`, or other numbers of it, beside its
        `effects`, to first order: what sticks still does. None where it is no such torque."""
        joint, law = self.motion.robot.joints[i], now.effect
        was = [e for e in effects if e.key == now.key]
        changes = law.overrides("level") or law.overrides("edit_drive") or law.reaches_before
        if not joint.rigid or changes or law.site not in (Site.MOTOR, Site.LINK):
            return None
        if i in self.ties.mates(effects):
            return None
        chain, own = self.get(i, effects), by_site([e for e in effects if e.joint == joint.name])
        readings = self.readings(i, own[Site.SENSOR])
        torque = self.command(i, own[Site.COMMAND]) if own[Site.COMMAND] else self.base(i).torque
        signals = self._seen(readings, torque)
        signals.tau_t = self.motion.rigid.tau[i]
        change = self.torque_along([now], signals) - self.torque_along(was, signals)
        for sticking in (chain.sticking_motor, chain.sticking_link):
            if sticking.size:
                change = np.where(sticking, 0.0, change)
        return self.filtered(change)

    def _drive_of(self, i: int, effects: Sequence[Planned]) -> tuple[Drive, list[tuple[Planned, Drive]]]:
        """Joint i's drive as effects change it, and those that do so later, with the drive that they make; of
        a coupled joint without its motor's inertia and damping, which are a shaft's."""
        drive, gated = self.motion.robot.joints[i].drive, []
        for e in effects:
            if e.since is not None and e.effect.overrides("edit_drive"):
                gated.append(e)
            else:
                drive = e.effect.edit_drive(drive, e.p)
        later = [(e, e.effect.edit_drive(drive, e.p)) for e in gated]
        if i in self.ties.coupled:
            drive = replace(drive, B=0.0, D_m=0.0)
            later = [(e, replace(edited, B=0.0, D_m=0.0)) for e, edited in later]
        return drive, later

    def _denoised(self, i: int, effects: Sequence[Planned]) -> Chain | None:
        """Joint i's chain without its own dry frictions and its sensors' noise, where that is known."""
        if self.denoised is None:
            return None
        return self.denoised.get(
            i, [e for e in effects if self.ties.on_shaft(e) or not e.effect.overrides("level")]
        )

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
        if self.motion.robot.joints[i].rigid or self.floats(i):
            return self.filter.spectrum(self.loads.carried(i, bodies)) - link_hat
        return self.base(i).combined(spring_hat, reading)

    def _transmitted(self, i: int, readings: JointReadings, spring_hat: np.ndarray) -> np.ndarray:
        """(N,) the torque of joint i's transmission; with unknown encoder offsets it follows from the
        load."""
        if self.motion.robot.joints[i].rigid or self.floats(i):
            return self.motion.rigid.tau[i]
        return readings.spring if spring_hat is readings.spring_hat else self.time_series(spring_hat)

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
            mapped = self.since(e, e.effect.map(signals, p, signals.phi), signals.phi)
            left = self.since(e, e.effect.slope(signals, p) * np.ones_like(mapped), np.ones_like(mapped))
            extra = extra + drive.K * (mapped - signals.phi) + drive.D * (left - 1.0) * signals.dphi
            signals.phi, signals.dphi = mapped, left * signals.dphi
        for e in at[Site.SPRING]:
            if e.effect.overrides("torque"):
                torque = e.effect.torque(signals, e.p, self.state(e, signals))
                extra = extra + self.since(e, torque, np.zeros_like(extra))
        return linear + self.filtered(extra)

    def _gated_drive(
        self,
        e: Planned,
        drive: Drive,
        edited: Drive,
        motor: np.ndarray,
        spring: np.ndarray,
        phi_hat: np.ndarray,
        theta_hat: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """A change of K, D, B or D_m that sets in during the recording, or ceases: its torque, gated."""
        s = self.jomega
        gate = e.acts(self.t).astype(float)
        shaft = ((edited.B - drive.B) * s**2 + (edited.D_m - drive.D_m) * s) * theta_hat
        motor = motor - self.filter.spectrum(gate * self.time_series(shaft))
        if np.isfinite(drive.K):
            twist = ((edited.K - drive.K) + (edited.D - drive.D) * s) * phi_hat
            spring = spring + self.filter.spectrum(gate * self.time_series(twist))
        return motor, spring

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
            net, denoised_net = self.two_series(torque_hat, own + denoised.link)
            net, denoised_net = net - load, denoised_net - self.denoised.loads.carried(i, at[Site.BODY])
        else:
            net = denoised_net = self.time_series(torque_hat) - load
        if self.floating:
            net, denoised_net = net - np.mean(net), denoised_net - np.mean(denoised_net)
        return self.rubbing(
            dry(at[Site.LINK]),
            signals,
            self.speed(i, "dq", signals),
            net,
            denoised_net,
            self.link_inertia(i),
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
        return self.base(i).combined(spring_hat, reading, None if dry(at[Site.MOTOR]) else motor_hat)

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
        inertia = float(drive.B) + (self.link_inertia(i) if rigid else 0.0)
        if self.denoised is not None and denoised is not None:
            load = self.denoised._load(
                i, at[Site.BODY], denoised.spring_torque, denoised.link, denoised.reading
            )
            denoised_hat = denoised.motor - load
            net, denoised_net = self.two_series(net_hat, denoised_hat)
        else:
            net = denoised_net = self.time_series(net_hat)
        return self.rubbing(
            dry(at[Site.MOTOR]), signals, self.speed(i, "dtheta", signals), net, denoised_net, inertia
        )

    def _pull(self, i: int, effects: Sequence[Planned], sliding: np.ndarray, taken: np.ndarray) -> np.ndarray:
        """(2, N) what pulls at joint i's motor beside dry friction, `sliding` (N,) and the spectrum `taken`
        of which are added, as recorded and without noise."""
        smooth = [e for e in effects if not e.effect.overrides("level")]
        bodies = [e for e in smooth if e.effect.site is Site.BODY]
        out = []
        for chains in (self, self.denoised or self):
            chain = chains.get(i, smooth)
            link = 0.0 if self.motion.robot.joints[i].rigid else chain.link  # of a rigid one `motor` has it
            load = chains._load(i, bodies, chain.spring_torque, link, chain.reading)
            out.append(chain.motor - load + taken)
        return self.two_series(*out) + self.filter.smooth(sliding)
