"""Torque balances of every joint: what the model says must vanish, evaluated on readings.

Per flexible joint, with s the spring torque that the model makes of the encoders,

    motor   F tau - B theta'' - D_m theta' - s + F friction
    link    s + F (link torques) - RNEA(F q, F q', F q'')
    spring  F tau_t - s

where F is the Gaussian filter. The measured tau_t stays out of the first two: encoders give s with far
less noise. A rigid joint (infinite stiffness) has the sum of the first two. Every effect enters through
its own law; this file knows sites, never effects. A law is evaluated on unfiltered positions, then
filtered (a filter does not commute with a kink).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from flexjoint import ops
from flexjoint.body import PinBody
from flexjoint.diagnose.signals import Filter, Readings, make_filter
from flexjoint.effect import Drive, Planned, Signals, Site
from flexjoint.errors import RecordingError
from flexjoint.recording import Recording
from flexjoint.robot import Joint, Robot

MOTOR, LINK, SPRING = "motor", "link", "spring"
INVERSION_ROUNDS = 6  # of the fixed point true = measured - (map(true) - true); slopes below 0.3 assumed


@dataclass(frozen=True)
class Rigid:
    """Rigid-body torques along the filtered motion and their sensitivities; (n, ...) actuated joints."""

    tau: np.ndarray  # (n, N)
    by_q: np.ndarray  # (N, n, n) d tau / d q
    by_v: np.ndarray  # (N, n, n)
    mass: np.ndarray  # (N, n, n)
    regressor: np.ndarray  # (N, n, 10 n) columns of the bodies of the actuated joints
    by_gravity: np.ndarray  # (3, n, N) torque per unit of gravity along each base axis
    inertial: np.ndarray  # (n, 10) nominal parameters of those bodies
    gravity: np.ndarray  # (3,)


@dataclass(frozen=True)
class Chain:
    """One joint's spectra (F,), already filtered: motor and link sides, spring reading, and what the
    sensor effects change of its link angle."""

    motor: np.ndarray
    spring_torque: np.ndarray  # s
    link: np.ndarray  # link torques other than the spring's
    reading: np.ndarray  # tau_t, corrected
    q_change: np.ndarray  # corrected minus base link angle


@dataclass(frozen=True)
class Row:
    """A balance of a joint."""

    balance: str
    joint: int


class Balances:
    """All balances of a recording against a robot, as functions of the effects assumed.

    `rows` lists the balances that exist, `missing` the position channels that no sensor gives (their
    trajectories are free: see whitening.py).
    """

    def __init__(self, robot: Robot, readings: Readings, recording: Recording) -> None:
        self.robot, self.readings = robot, readings
        count = readings.time.size
        self.filter: Filter = make_filter(count, readings.period, readings.sigma)
        self.jomega = 1j * self.filter.omega
        self.t = readings.time - readings.start
        self.missing: list[tuple[str, int]] = []
        self.q, self.theta = self._complete(recording)
        self.rigid = self._along(recording)
        self.rows: list[Row] = []
        for index, joint in enumerate(robot.joints):
            driven = bool(np.isfinite(readings.torque[index, 0]))
            if driven:
                self.rows.append(Row(MOTOR, index))
            if joint.rigid:
                continue
            self.rows.append(Row(LINK, index))
            if np.isfinite(readings.tau_t[index, 0]):
                self.rows.append(Row(SPRING, index))
        self._cache: dict[tuple[int, tuple[object, ...]], Chain] = {}
        self._rigid_spectrum = self.filter.spectrum(self.rigid.tau)
        # RNEA is evaluated on filtered motion: it is filtered already

    # ------------------------------------------------------------------ positions
    def _complete(self, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Link and motor angles (n, N); those without a sensor by the nominal model, as the point about
        which the balances are linear. They carry no information of their own."""
        q, theta = self.readings.q.copy(), self.readings.theta.copy()
        unknown_links = []
        for i, joint in enumerate(self.robot.joints):
            has_q, has_theta = np.isfinite(q[i, 0]), np.isfinite(theta[i, 0])
            if not has_q and not has_theta:
                raise RecordingError(
                    f"{recording.name}: joint {joint.name} has neither q nor theta; lock it in the robot YAML or"
                    " measure one"
                )
            if joint.rigid:
                theta[i] = theta[i] if has_theta else q[i]
                q[i] = theta[i]
            elif not has_theta:
                self.missing.append(("theta", i))
                theta[i] = q[i]
            elif not has_q:
                self.missing.append(("q", i))
                q[i] = theta[i]
                unknown_links.append(i)
        self.q, self.theta = q, theta
        if self.missing:
            self._solve_missing(recording)
        return self.q, self.theta

    def _solve_missing(self, recording: Recording) -> None:
        """phi of joints with one encoder: from tau_t where measured, else from the link's dynamics.

        Fixed point of (M0 s^2 + D s + K) phi = RNEA(theta - phi) + M0 phi'' per joint without link
        encoder, with M0 the mean of M's diagonal; (D s + K) phi = RNEA(q) without a motor encoder.
        """
        s = self.jomega
        phi = np.zeros_like(self.q)
        for _ in range(8):
            rigid = None
            for channel, i in self.missing:
                drive = self.robot.joints[i].drive
                impedance = drive.K + drive.D * s
                if np.isfinite(self.readings.tau_t[i, 0]):
                    load = self.filter.spectrum(self.readings.tau_t[i]) * self.filter.gain
                    spectrum = load / impedance
                else:
                    rigid = rigid or self._along(recording)
                    load = self.filter.spectrum(rigid.tau[i])
                    if channel == "q":
                        inertia = float(np.mean(rigid.mass[:, i, i])) * s**2
                        load = load + inertia * self.filter.spectrum(phi[i]) * self.filter.gain
                        impedance = impedance + inertia
                    spectrum = load / impedance
                phi[i] = fft.irfft(spectrum, self.filter.size)[: self.filter.count]
            for channel, i in self.missing:
                if channel == "q":
                    self.q[i] = self.theta[i] - phi[i]
                else:
                    self.theta[i] = self.q[i] + phi[i]

    # ------------------------------------------------------------------ rigid body
    def _along(self, recording: Recording) -> Rigid:
        robot, count = self.robot, self.filter.count
        model = robot.model
        body = PinBody(model)
        if robot.floating:
            raise RecordingError(
                f"{robot.name} has a floating base; the balances need a fixed one: set base: fixed"
            )
        rows = [joint.idx_v for joint in robot.joints]
        # RNEA(F q) differs from F RNEA(q) by a term in the window's variance. With shares 1/4 and 1/2 of the
        # variance before RNEA and the rest after it, that term cancels in 2 R(1/4) - R(1/2) (Richardson);
        # noise, to which RNEA is nearly linear, passes both alike.
        quarter, half = (
            self.filter.smooth_share(
                body.rnea_batch(*self._motion(recording, body.neutral, share))[:, rows].T, 1.0 - share
            )
            for share in (0.25, 0.5)
        )
        tau = 2.0 * quarter - half
        q, v, a = self._motion(recording, body.neutral, 1.0)
        by_q, by_v, mass = body.rnea_derivatives_batch(q, v, a)
        pick = np.ix_(range(count), rows, rows)
        bodies = np.concatenate([10 * (joint.pin_id - 1) + np.arange(10) for joint in robot.joints])
        regressor = body.regressor_batch(q, v, a)[np.ix_(range(count), rows, bodies)]
        still = np.zeros_like(v)
        by_gravity = np.stack(
            [PinBody(model, gravity=axis).rnea_batch(q, still, still)[:, rows].T for axis in np.eye(3)]
        )
        inertial = body.inertial[[joint.pin_id - 1 for joint in robot.joints]]
        return Rigid(tau, by_q[pick], by_v[pick], mass[pick], regressor, by_gravity, inertial, robot.gravity)

    def _motion(self, recording: Recording, neutral: np.ndarray, share: float) -> list[np.ndarray]:
        """q (N, nq), v and a (N, nv) of the whole model, filtered with a share of the window's variance."""
        count, nv = self.filter.count, self.robot.model.nv
        motion = [np.tile(neutral, (count, 1)), np.zeros((count, nv)), np.zeros((count, nv))]
        for order, signal in enumerate(motion):
            smooth = self.filter.smooth_share(self.q, share, order)
            for i, joint in enumerate(self.robot.joints):
                signal[:, joint.idx_q if order == 0 else joint.idx_v] = smooth[i]
        self._passive(recording, motion)
        return motion

    def _passive(self, recording: Recording, motion: list[np.ndarray]) -> None:
        """Joints that swing freely must be measured: their motion loads the others."""
        model = self.robot.model
        for index, name in enumerate(model.names):
            if index == 0 or name in self.robot.joint_names:
                continue
            if not recording.has("q", name):
                raise RecordingError(
                    f"{recording.name}: joint {name} is passive and not measured; add q.{name} or list it under"
                    " lock or joints in the robot YAML"
                )
            x = np.interp(self.readings.time, recording.time, recording.get("q", name))
            for order, signal in enumerate(motion):
                column = model.joints[index].idx_q if order == 0 else model.joints[index].idx_v
                signal[:, column] = self.filter.smooth(x, order)

    # ------------------------------------------------------------------ one joint
    def chain(self, index: int, effects: Sequence[Planned]) -> Chain:
        """One joint's side of the balances with these effects of its own at work."""
        key = (index, tuple((e.effect.name, tuple(map(_hashable, e.p)), e.since) for e in effects))
        if key not in self._cache:
            if len(self._cache) > 64:
                self._cache.clear()
            self._cache[key] = self._chain(index, effects)
        return self._cache[key]

    def _chain(self, i: int, effects: Sequence[Planned]) -> Chain:
        joint, window, s = self.robot.joints[i], self.filter, self.jomega
        at = _by_site(effects)
        drive = joint.drive
        gated = [e for e in effects if e.since is not None and e.effect.overrides("edit_drive")]
        for e in effects:
            if e not in gated:
                drive = e.effect.edit_drive(drive, e.p)
        q, theta, tau_t = self._true_readings(i, at[Site.SENSOR])
        q_hat, theta_hat = window.spectrum(q) * window.gain, window.spectrum(theta) * window.gain
        torque = self._command(i, at[Site.COMMAND])
        driven = np.isfinite(torque[0])
        torque_hat = (window.spectrum(torque) if driven else np.zeros_like(theta_hat)) * window.gain
        inertial_hat = (drive.B * s**2 + drive.D_m * s) * theta_hat

        signals = Signals(t=self.t, q=q, theta=theta, phi=theta - q, tau_m=np.where(driven, torque, 0.0))
        # velocities only as far as a law asks for them (each is a transform)
        dynamic = bool(effects)
        if dynamic:
            signals.dtheta, signals.dq = self._time(s * theta_hat), self._time(s * q_hat)
            signals.dphi = signals.dtheta - signals.dq
        if joint.rigid:
            spring_hat = np.zeros_like(theta_hat)
        else:
            spring_hat = self._spring(drive, signals, q_hat, theta_hat, at)
        if dynamic:
            signals.tau_t = self._time(spring_hat) if not joint.rigid else self.rigid.tau[i]

        motor_hat = torque_hat - inertial_hat
        for e in gated:
            motor_hat, spring_hat = self._gated_drive(e, drive, motor_hat, spring_hat, q_hat, theta_hat)
        link_hat = self._body_torques(at[Site.LINK], signals, dt=self.readings.period)
        motor_hat = motor_hat + self._body_torques(at[Site.MOTOR], signals, dt=self.readings.period)
        link_dry = [e for e in at[Site.LINK] if e.effect.overrides("level")]
        if link_dry:
            own = spring_hat if not joint.rigid else motor_hat
            net = self._time(own + link_hat) - self.rigid.tau[i]
            link_hat = link_hat + self._dry(link_dry, signals, signals.dq, net, self._link_inertia(i), self.readings.noise["q"][i])
        motor_dry = [e for e in at[Site.MOTOR] if e.effect.overrides("level")]
        if motor_dry and driven:
            load = spring_hat if not joint.rigid else window.spectrum(self.rigid.tau[i]) - link_hat
            net = self._time(motor_hat - load)
            motor_hat = motor_hat + self._dry(motor_dry, signals, signals.dtheta, net, self._motor_inertia(i, drive), self.readings.noise["theta"][i])
        reading = window.spectrum(tau_t) * window.gain if np.isfinite(tau_t[0]) else np.zeros_like(q_hat)
        change = q_hat - window.spectrum(self.q[i]) * window.gain if at[Site.SENSOR] else np.zeros_like(q_hat)
        if joint.rigid:
            motor_hat, link_hat = motor_hat + link_hat, np.zeros_like(link_hat)
            if at[Site.SENSOR]:
                change = theta_hat - window.spectrum(self.theta[i]) * window.gain
        return Chain(motor_hat, spring_hat, link_hat, reading, change)

    def _true_readings(
        self, i: int, sensors: Sequence[Planned]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Readings with the sensors' effects taken back, the last one first."""
        readings = {"q": self.q[i], "theta": self.theta[i], "tau_t": self.readings.tau_t[i]}
        for e in reversed(sensors):
            p = e.p
            for channel in e.effect.channels(p):
                if channel not in readings or not np.isfinite(readings[channel][0]):
                    continue
                measured = readings[channel]
                true = measured
                if e.effect.overrides("map"):
                    signals = Signals(t=self.t)
                    for _ in range(INVERSION_ROUNDS):
                        true = measured - (e.effect.map(signals, p, true) - true)
                if e.effect.overrides("delay"):
                    true = self._shift(true, float(e.effect.delay(p)))
                readings[channel] = self._since(e, true, measured)
        if self.robot.joints[i].rigid:
            readings["q"] = readings["theta"]
        return readings["q"], readings["theta"], readings["tau_t"]

    def _shift(self, x: np.ndarray, seconds: float) -> np.ndarray:
        """x(t + seconds) by cubic interpolation on the even grid (exact in the limit of smooth signals)."""
        from scipy.ndimage import map_coordinates  # local: costs start-up time and is used here only

        at = np.arange(x.size) + seconds / self.readings.period
        return map_coordinates(x, [at], order=3, mode="nearest")

    def _command(self, i: int, effects: Sequence[Planned]) -> np.ndarray:
        torque = self.readings.torque[i]
        if not np.isfinite(torque[0]):
            return torque
        for e in effects:
            p, before = e.p, torque
            signals = Signals(t=self.t, q=self.q[i], theta=self.theta[i], tau_m=torque)
            if e.effect.overrides("delay"):
                at = self.t - float(e.effect.delay(p))
                torque = np.interp(at, self.t, torque)
            if e.effect.states:
                z = self._state(e, signals)
                torque = e.effect.map(signals, p, torque) + e.effect.torque(signals, p, z)
            else:
                torque = e.effect.map(signals, p, torque)
            torque = self._since(e, torque, before)
        return torque

    def _since(self, e: Planned, with_effect: np.ndarray, without: np.ndarray) -> np.ndarray:
        return with_effect if e.since is None else np.where(self.t >= e.since, with_effect, without)

    def _spring(
        self, drive: Drive, signals: Signals, q_hat: np.ndarray, theta_hat: np.ndarray, at: dict[Site, list[Planned]]
    ) -> np.ndarray:
        """Spectrum of s: linear part from the filtered encoders, effects from the unfiltered deflection.
        Sets signals.phi to what the deflection effects leave (SPRING laws see that)."""
        s = self.jomega
        spring_hat = (drive.K + drive.D * s) * (theta_hat - q_hat)
        extra = np.zeros_like(signals.phi)
        for e in at[Site.DEFLECTION]:
            p = e.p
            mapped = e.effect.map(signals, p, signals.phi)
            left = e.effect.slope(signals, p) * np.ones_like(mapped)
            change = drive.K * (mapped - signals.phi) + drive.D * (left - 1.0) * signals.dphi
            extra = extra + self._since(e, change, np.zeros_like(change))
            after = replace(signals, phi=mapped, dphi=left * signals.dphi)
            signals.phi = self._since(e, after.phi, signals.phi)
            signals.dphi = self._since(e, after.dphi, signals.dphi)
        for e in at[Site.SPRING]:
            if e.effect.overrides("torque"):
                torque = e.effect.torque(signals, e.p, self._state(e, signals))
                extra = extra + self._since(e, torque, np.zeros_like(extra))
        return spring_hat + self.filter.spectrum(extra) * self.filter.gain if at[Site.DEFLECTION] + at[
            Site.SPRING
        ] else spring_hat

    def _gated_drive(
        self, e: Planned, drive: Drive, motor: np.ndarray, spring: np.ndarray, q_hat: np.ndarray, theta_hat: np.ndarray
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

    def _body_torques(self, effects: Sequence[Planned], signals: Signals, dt: float) -> np.ndarray:
        """Spectrum of the torques (not the dry frictions) that act on the motor or the link."""
        total = np.zeros(self.filter.count)
        for e in effects:
            if e.effect.overrides("torque"):
                torque = e.effect.torque(signals, e.p, self._state(e, signals)) * np.ones_like(total)
                total = total + self._since(e, torque, np.zeros_like(total))
        return self.filter.spectrum(total) * self.filter.gain

    def _dry(
        self, effects: Sequence[Planned], signals: Signals, speed: np.ndarray, net: np.ndarray, inertia: float, encoder: float
    ) -> np.ndarray:
        """Spectrum of the dry friction, a set-valued law evaluated on data: level sgn(speed) in motion; at
        rest what holds the body, which the balance itself tells, within +-level.

        The filter rounds the kinks that friction itself makes in speed and net torque; what it takes away,
        (1 - F) friction, is known from the friction and given back, a few rounds until they agree.
        """
        level = np.zeros_like(speed)
        for e in effects:
            value = e.effect.level(signals, e.p) * np.ones_like(speed)
            level = level + self._since(e, value, np.zeros_like(value))
        # what the encoder's noise makes of inertia x acceleration in the net torque
        slack = WIDE * inertia * encoder * float(np.sqrt(np.mean((self.filter.omega**2 * self.filter.gain) ** 2)))
        lost = 1.0 - self.filter.gain
        integral = np.divide(lost, self.jomega, out=np.zeros_like(self.jomega), where=self.filter.omega > 0)
        sharp_speed, sharp_net = speed, net
        for _ in range(FRICTION_ROUNDS):
            held = np.clip(sharp_net, -level - slack, level + slack)
            friction = np.where(np.abs(sharp_speed) > REST_SPEED, level * np.sign(sharp_speed), held)
            spectrum = self.filter.spectrum(friction)
            sharp_net = net + self._time(spectrum * lost)
            sharp_speed = speed - self._time(spectrum * integral) / inertia
        return -self.filter.spectrum(friction) * self.filter.gain

    def _link_inertia(self, i: int) -> float:
        return float(np.mean(self.rigid.mass[:, i, i]))

    def _motor_inertia(self, i: int, drive: Drive) -> float:
        return float(drive.B) + (self._link_inertia(i) if self.robot.joints[i].rigid else 0.0)

    def _state(self, e: Planned, signals: Signals) -> np.ndarray | float:
        """Internal state of an effect along the recording; rates are affine in the state."""
        if not e.effect.states:
            return 0.0
        p, one = e.p, np.ones(self.filter.count)
        smooth = replace(signals, phi=self.filter.smooth(signals.phi))
        offset = e.effect.rate(smooth, p, 0.0 * one) * one
        decay = offset - e.effect.rate(smooth, p, one)
        h = self.readings.period
        keep = np.exp(-np.maximum(decay, 0.0) * h)
        small = decay * h < 1e-6
        gain = np.where(small, h, (1.0 - keep) / np.where(small, 1.0, decay))
        add = (gain * offset).tolist()
        z, out = float(e.effect.states[0]), []
        for k, a in zip(keep.tolist(), add, strict=True):
            out.append(z)
            z = k * z + a
        return np.array(out)

    def _time(self, spectrum: np.ndarray) -> np.ndarray:
        return fft.irfft(spectrum, self.filter.size)[: self.filter.count]

    # ------------------------------------------------------------------ all joints
    def residual(self, effects: Sequence[Planned]) -> np.ndarray:
        """(rows, F) spectra of all balances with these effects at work."""
        chains = [self.chain(i, _of(effects, joint)) for i, joint in enumerate(self.robot.joints)]
        rigid = self._rigid_spectrum + self.rigid_change(effects, chains)
        out = np.empty((len(self.rows), self.filter.omega.size), dtype=complex)
        for r, row in enumerate(self.rows):
            chain, load = chains[row.joint], rigid[row.joint]
            if row.balance == MOTOR:
                rigid_joint = self.robot.joints[row.joint].rigid
                out[r] = chain.motor - (load if rigid_joint else chain.spring_torque)
            elif row.balance == LINK:
                out[r] = chain.spring_torque + chain.link - load
            else:
                out[r] = chain.reading - chain.spring_torque
        return out

    def rigid_change(self, effects: Sequence[Planned], chains: Sequence[Chain]) -> np.ndarray:
        """(n, F): change of the rigid-body torques by BODY effects and by corrected link angles, to first
        order in the correction."""
        n = len(self.robot.joints)
        change = np.zeros((n, self.filter.count))
        touched = False
        gravity = self.rigid.gravity
        for e in effects:
            if e.effect.site is not Site.BODY:
                continue
            touched, p = True, e.p
            if e.effect.overrides("edit_inertial") and e.joint is not None:
                i = self.robot.joint_names.index(e.joint)
                nominal = list(self.rigid.inertial[i])
                added = np.array(e.effect.edit_inertial(nominal, p), dtype=float) - self.rigid.inertial[i]
                torque = np.einsum("tjk,k->jt", self.rigid.regressor[:, :, 10 * i : 10 * i + 10], added)
                change = change + self._since(e, torque, np.zeros_like(torque))
            if e.effect.overrides("edit_gravity"):
                turned = np.array(e.effect.edit_gravity(list(gravity), p), dtype=float)
                torque = np.einsum("a,ajt->jt", turned - gravity, self.rigid.by_gravity)
                change = change + self._since(e, torque, np.zeros_like(torque))
        for k, chain in enumerate(chains):
            if not np.any(chain.q_change):
                continue
            touched = True
            shift = [self._time(self.jomega**order * chain.q_change) for order in range(3)]
            for gain, x in zip((self.rigid.by_q, self.rigid.by_v, self.rigid.mass), shift, strict=True):
                change = change + gain[:, :, k].T * x
        return self.filter.spectrum(change) if touched else np.zeros((n, self.filter.omega.size))


REST_SPEED = 0.04  # rad/s, below which the sign of a measured speed is not trusted
WIDE = 3.0  # standard deviations of the net torque's noise by which its clip is widened
FRICTION_ROUNDS = 4


def _by_site(effects: Sequence[Planned]) -> dict[Site, list[Planned]]:
    sites: dict[Site, list[Planned]] = {site: [] for site in Site}
    for e in effects:
        sites[e.effect.site].append(e)
    return sites


def _of(effects: Sequence[Planned], joint: Joint) -> list[Planned]:
    return [e for e in effects if e.joint == joint.name and e.effect.site is not Site.BODY]


def _hashable(value: object) -> object:
    return tuple(value) if isinstance(value, (list, tuple, np.ndarray)) else value


__all__ = ["LINK", "MOTOR", "SPRING", "Balances", "Chain", "Rigid", "Row", "ops"]
