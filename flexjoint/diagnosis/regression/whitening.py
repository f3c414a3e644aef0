"""Predicted noise of the balances across joints and frequencies, and the transform that makes it white.

Every sensor's white noise is pushed through the linearised balances: with x the noise of q, theta, tau_t
and the torque, balance spectra are T(f) x G(f), so S(f) = T diag(var) T^H G^2 is known, not fitted. A
position without a sensor is one with unbounded noise: its trajectory is eliminated by the same algebra.
The whitened residual of a healthy robot then has energy 1 per degree of freedom.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.ndimage import uniform_filter1d

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, SPRING, Balances, Row, drive_of
from flexjoint.diagnosis.balances.links.movement import Numbers
from flexjoint.diagnosis.balances.motion import mass_along
from flexjoint.diagnosis.signals.rounding import Colour
from flexjoint.diagnosis.signals.signals import PADDED_SIGMAS, margin
from flexjoint.effects import Drive, Planned, Signals, Site
from flexjoint.rigidbody.numeric import inertial_of

ROUNDING = 1e-11
MASSES = 1000  # mass matrices along a motion
CHUNK = 512  # frequencies at a time
UNBOUNDED = 1e4  # noise of a missing position, relative to the largest encoder noise there is
AROUND = 9  # ... as the mean over so many samples ...
DRAWS, DRAWN = 6, 5  # ... and draws, of this seed
SAMPLES = 24  # draws of a noise, which tell a mean chi-square of two numbers to 20 %


@dataclass(frozen=True)
class Band:
    """The spectra of some balances within the whitened band, of one change or of several. They are much
    smaller than whitened series, for such a series of a balance contains parts of all balances before it."""

    rows: np.ndarray  # (k,) ascending
    spectra: np.ndarray  # (..., k, F_band)

    @property
    def first(self) -> int:
        """The first balance that is not zero; 0 where there is none."""
        return int(self.rows[0]) if self.rows.size else 0

    @property
    def nbytes(self) -> int:
        return self.spectra.nbytes


def joined(bands: Sequence[Band]) -> Band:
    """The sum of some bands."""
    if len(bands) == 1:
        return bands[0]
    rows = np.unique(np.concatenate([band.rows for band in bands]))
    *several, _, bins = bands[0].spectra.shape
    spectra = np.zeros((*several, rows.size, bins), dtype=complex)
    for band in bands:
        spectra[..., np.searchsorted(rows, band.rows), :] += band.spectra
    return Band(rows, spectra)


@dataclass(frozen=True)
class Whitening:
    """Linear map from balance spectra to white time series at the band-limited rate."""

    matrix: np.ndarray  # (m, m, F_band) complex, lower triangular: a balance is white beside those before it
    taper: np.ndarray  # (F_band,)
    size: int  # padded length of the balances
    window: np.ndarray  # (size,) 1 where the record is usable, falling smoothly to 0 outside
    length: int  # samples of the white series over the padded record
    keep: np.ndarray  # indices of the usable white samples
    time: np.ndarray  # their times from the start of the recording [s]
    freedom: float  # degrees of freedom per sample: balances minus missing positions
    scale: float
    noise: Noise
    floor: np.ndarray  # (m,) numerical error of each balance [N m], white in the band

    @cached_property
    def deviation(self) -> np.ndarray:
        """(m,) standard deviation of the filtered balances' noise [N m], beyond the band too (spectra are
        smooth: every eighth bin will do)."""
        window = self.noise.balances.filter
        own = np.einsum("faa->fa", self.noise.spectrum(window.omega[::8], window.gain[::8])).real
        return np.asarray(np.sqrt(np.mean(own, axis=0) + self.floor**2))

    @cached_property
    def of_torque(self) -> np.ndarray:
        """(m,) the share of each balance's noise that is its motor torque's, in the whitened band."""
        band = slice(0, self.taper.size, 8)  # spectra are smooth, as above
        balances, n = self.noise.balances, len(self.noise.drives)
        omega, gain = balances.filter.omega[band], balances.filter.gain[band]
        transfer, _ = self.noise.at(omega)
        variance = self.noise.variances[3 * n :]
        total = np.einsum("faa->fa", self.noise.spectrum(omega, gain)).real + self.floor**2
        shares = [
            np.mean(np.abs(transfer[:, r, 3 * n + row.joint] * gain) ** 2 * variance[row.joint] / total[:, r])
            for r, row in enumerate(balances.rows)
        ]
        return np.array(shares)

    @cached_property
    def drawn(self) -> np.ndarray:
        """(draws, m K) the predicted noise drawn at random, whitened. A whitening takes the robot for one of
        constant inertia; along a motion the noise of one encoder reaches several links by inertias that vary,
        so that some correlation of their balances is left, which these draws have."""
        drawn = self.noise.drawn(SAMPLES, self.taper.size, np.random.default_rng(DRAWN))
        spectrum = self.noise.balances.filter.spectrum
        return np.array([self.apply(spectrum(one)).ravel() for one in drawn])

    def apply(self, spectra: np.ndarray) -> np.ndarray:
        """(m, F) -> (m, K): whitened series at the usable samples."""
        return self.white(self.band(dict(enumerate(spectra))))

    def band(self, spectra: Mapping[int, np.ndarray]) -> Band:
        """The part of some balances' spectra (F,), by row, that is whitened."""
        own = {row: spectra[row] for row in sorted(spectra) if np.any(spectra[row])}
        if not own:
            return Band(np.zeros(0, dtype=int), np.zeros((0, self.taper.size), dtype=complex))
        moved = self.noise.balances.moved(own, self.noise.numbers)
        rows = np.array(sorted({*own, *moved}), dtype=int)
        series = np.zeros((rows.size, self.size))
        series[np.searchsorted(rows, list(own))] = fft.irfft(np.array(list(own.values())), self.size, axis=-1)
        for row, change in moved.items():
            series[np.searchsorted(rows, row), : change.size] += change
        return self._windowed(rows, series)

    def bands(self, row: int, spectra: np.ndarray) -> Band:
        """`band` of several changes of one balance (d, F), as one band of several."""
        balances = self.noise.balances
        if not balances.moves_links:
            return self._windowed(np.array([row]), fft.irfft(spectra, self.size, axis=-1)[:, None])
        each = [self.band({row: spectrum}) for spectrum in spectra]
        rows = np.unique(np.concatenate([band.rows for band in each]))
        out = np.zeros((len(each), rows.size, self.taper.size), dtype=complex)
        for band, one in zip(each, out, strict=True):
            one[np.searchsorted(rows, band.rows)] = band.spectra
        return Band(rows, out)

    def band_of(self, series: Mapping[int, np.ndarray]) -> Band:
        """The whitened part of series (N,) of some balances, by row, that links without encoder have moved
        already."""
        rows = np.array(sorted(series), dtype=int)
        padded = np.zeros((rows.size, self.size))
        padded[:, : self.noise.balances.filter.count] = [series[row] for row in rows.tolist()]
        return self._windowed(rows, padded)

    def _windowed(self, rows: np.ndarray, series: np.ndarray) -> Band:
        # what lies beyond edges and gaps is cut off first, for whitening would spread it over the record
        spectra = fft.rfft(series * self.window, axis=-1)
        return Band(rows, spectra[..., : self.taper.size] * self.taper)

    def white(self, band: Band) -> np.ndarray:
        """(..., m, K): whitened series at the usable samples."""
        white = np.zeros((*band.spectra.shape[:-2], len(self.matrix), self.keep.size))
        white[..., band.first :, :] = self.white_from(band, band.first)
        return white

    def white_from(self, band: Band, first: int) -> np.ndarray:
        """(..., m - first, K): the same from some balance on; before the band's first one it is zero."""
        several = band.spectra.shape[:-2]
        mixed = np.zeros((*several, len(self.matrix) - first, self.taper.size), dtype=complex)
        for k, row in enumerate(band.rows):
            mixed[..., row - first :, :] += self.matrix[row:, row] * band.spectra[..., k, None, :]
        return np.asarray(fft.irfft(mixed, self.length, axis=-1)[..., self.keep] * self.scale)

    def white_in(self, band: Band, row: int) -> np.ndarray:
        """(K,) of one band: the same in one balance."""
        before = band.rows <= row
        mixed = np.sum(self.matrix[row, band.rows[before]] * band.spectra[before], axis=0)
        return np.asarray(fft.irfft(mixed, self.length)[self.keep] * self.scale)


def make(
    balances: Balances,
    torque_scale: np.ndarray,
    effects: Sequence[Planned],
    like: Whitening | None = None,
) -> Whitening:
    """The whitening of these balances under a model with these effects; `torque_scale` (m,) is each
    balance's torque RMS [N m]. Effects matter: a payload's inertia turns more encoder noise into torque.
    Samples are those of a whitening `like` it, or all that are white wherever the record ends."""
    limits = balances.settings.regression
    window = balances.filter
    # the band ends a little later, where that makes a length that transforms fast
    length = 2 * fft.next_fast_len(int(np.searchsorted(-window.gain, -limits.band_gain)) - 1, real=True)
    band = length // 2 + 1
    omega, gain = window.omega[:band], window.gain[:band]
    noise, floor = _noise(balances, effects), limits.numerical_floor * torque_scale
    rows = range(len(balances.rows))
    matrix = np.empty((len(rows), len(rows), band), dtype=complex)
    for begin in range(0, band, CHUNK):
        part = slice(begin, begin + CHUNK)
        spectrum = noise.spectrum(omega[part], gain[part])
        # the numerical floor is white: spread over the whole sampled band like any sensor's noise
        spectrum[:, rows, rows] += floor**2
        own = np.einsum("faa->fa", spectrum).real
        spectrum[:, rows, rows] += ROUNDING * own  # balances that share one noise are nearly dependent
        matrix[:, :, part] = np.moveaxis(np.linalg.inv(np.linalg.cholesky(spectrum)), 0, -1)
    edge = int(0.85 * band)
    taper = np.ones(band)
    taper[edge:] = 0.5 * (1.0 + np.cos(np.pi * np.arange(band - edge) / max(1, band - edge)))
    # rfft of N samples of unit white noise has variance N per bin; irfft to `length` divides by length;
    # energy lost in the taper is given back so that the mean energy is 1
    scale = float(np.sqrt(length * length / (window.size * np.sum(taper**2) * 2.0)))
    times = np.arange(length) * (window.size * balances.motion.readings.period / length)
    nearest = np.rint(times / balances.motion.readings.period).astype(int)
    inside = nearest < window.count
    usable = np.zeros(length, dtype=bool)
    usable[inside] = balances.motion.readings.valid[nearest[inside]]
    keep = np.flatnonzero(usable) if like is None else like.keep
    made = Whitening(
        matrix,
        taper,
        window.size,
        _window(balances),
        length,
        keep,
        times[keep],
        len(balances.rows) - len(balances.motion.missing),
        scale,
        noise,
        floor,
    )
    if like is not None:
        return made
    keep = _steady(made)
    return replace(made, keep=keep, time=times[keep])


def _steady(whitening: Whitening) -> np.ndarray:
    """Indices of the white samples that lack little of what was cut off at the record's edges and gaps: where
    damping is low, a whitening rings for as long as the joint does. Found by random draws: balances of the
    predicted noise, and the part of them that the window cuts off."""
    limits = whitening.noise.balances.settings.regression
    rng = np.random.default_rng(DRAWN)
    band, rows = whitening.taper.size, len(whitening.matrix)
    missing = np.zeros((rows, whitening.keep.size))
    factor = np.moveaxis(whitening.matrix, -1, 0)
    for _ in range(DRAWS):
        white = fft.rfft(rng.standard_normal((rows, whitening.length)), axis=-1) / whitening.scale
        white[: whitening.noise.balances.telling] = 0.0  # links are moved so that nothing is left of these
        balances = np.linalg.solve(factor, white.T[:, :, None])[:, :, 0].T
        series = fft.irfft(balances, whitening.size, axis=-1) * (1.0 - whitening.window)
        lost = fft.rfft(series, axis=-1)[:, :band] * whitening.taper
        missing += whitening.white(Band(np.arange(rows), lost)) ** 2 / DRAWS
    seen = uniform_filter1d(missing, AROUND, axis=1, mode="nearest").max(axis=0)
    steady = seen < limits.missing
    return whitening.keep[steady] if np.mean(steady) > limits.least_steady else whitening.keep


def _window(balances: Balances) -> np.ndarray:
    """1 on usable samples, 0 beyond the unused margin, and flanks as flat as it allows."""
    readings = balances.motion.readings
    flanked = margin(readings.sigma, balances.settings.signals) - PADDED_SIGMAS * readings.sigma
    reach = max(2, int(flanked / readings.period))
    flank = np.hanning(2 * reach + 3)[1:-1]
    padded = np.zeros(balances.filter.size)
    padded[: balances.filter.count] = readings.valid
    return np.clip(np.convolve(padded, flank / flank.sum(), mode="same") * 2.0, 0.0, 1.0)


@dataclass(frozen=True)
class Noise:
    """The noise of the balances that the sensors' noise causes, linearised about the mean of a motion; n
    joints."""

    balances: Balances
    drives: tuple[Drive, ...]
    scales: tuple[float, ...]  # of the motors' balances, which are counted in recorded torque
    load: tuple[np.ndarray, np.ndarray, np.ndarray]  # (n, n) torques by q, q' and q''
    heavier: np.ndarray | None  # (n, n) by which the last is more than the nominal robot's; None: nothing
    variances: np.ndarray  # (4 n,) of q, theta, tau_t and the torque
    colours: Mapping[int, Colour]  # of those that are not white
    shared: np.ndarray  # (n,) covariance of a joint's torque and theta, where the torque was made of theta
    spread: Mapping[int, np.ndarray]  # (n, n) covariance of the mass matrix's columns along the motion

    @property
    def numbers(self) -> Numbers:
        """The numbers on which links without encoder move."""
        return Numbers(self.drives, self.heavier, self.scales)

    def at(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """T (F, m, channels), and the part (F, m, m) that a varying mass matrix adds."""
        balances = self.balances
        n, m, s = len(self.drives), len(balances.rows), 1j * omega
        by_q, by_v, mass = self.load
        transfer = np.zeros((omega.size, m, 4 * n), dtype=complex)
        columns = tuple(k * n + np.arange(n) for k in range(4))
        q, theta = columns[:2]
        links = [joint.rigid for joint in balances.motion.robot.joints]
        ties = balances.chains.ties
        for r, row in enumerate(balances.rows):
            drive = self.drives[row.joint]
            if row.joint in ties.coupled:
                drive = replace(drive, B=0.0, D_m=0.0)
                for k, motor in enumerate(self.drives) if row.balance == MOTOR else ():
                    turns = ties.turns(k)
                    for j, share in turns.items() if row.joint in turns and k in ties.coupled else ():
                        shaft = turns[row.joint] * share * (motor.B * s**2 + motor.D_m * s)
                        transfer[:, r, theta[j]] -= shaft
            sprung = row.joint in balances.sprung_links
            for column, entry in _row_transfer(row, drive, links[row.joint], sprung, s, columns):
                transfer[:, r, column] += entry
            if row.balance == LINK or (row.balance == MOTOR and links[row.joint]):
                for k in range(n):
                    load = by_q[row.joint, k] + by_v[row.joint, k] * s + mass[row.joint, k] * s**2
                    transfer[:, r, theta[k] if links[k] else q[k]] -= load
            if row.balance == MOTOR:
                transfer[:, r, : 3 * n] *= self.scales[row.joint]
        extra = np.zeros((omega.size, m, m), dtype=complex)
        rows = {row.joint: r for r, row in enumerate(balances.rows) if row.balance == LINK}
        for k, covariance in self.spread.items():
            reading = np.abs(self._of_link(k, omega)) ** 2 @ self.variances
            for i, ri in rows.items():
                for j, rj in rows.items():
                    extra[:, ri, rj] += reading * covariance[i, j] * omega**4
        return transfer, extra

    def _of_link(self, k: int, omega: np.ndarray) -> np.ndarray:
        """(F, 4 n) the angle of a joint's link by the readings: its encoder's, the motor's where the joint is
        rigid, or else the motor's less the deflection that the spring's torque takes; 0 where none tells."""
        n, balances = len(self.drives), self.balances
        out = np.zeros((omega.size, 4 * n), dtype=complex)
        if balances.motion.robot.joints[k].rigid:
            out[:, n + k] = 1.0
        elif ("q", k) not in balances.motion.missing:
            out[:, k] = 1.0
        elif k in self.spread:
            drive = self.drives[k]
            out[:, n + k], out[:, 2 * n + k] = 1.0, -1.0 / (drive.K + 1j * omega * drive.D)
        return out

    def spectrum(self, omega: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """(F, m, m) of the balances, filtered with this gain (F,)."""
        transfer, extra = self.at(omega)
        spread = (transfer * self._coloured(omega)[:, None, :]) @ transfer.conj().swapaxes(1, 2)
        n = len(self.drives)
        for i in (int(i) for i in np.flatnonzero(self.shared)):
            theta, torque = transfer[:, :, n + i], transfer[:, :, 3 * n + i]
            both = self._adding(i, omega)[:, None, None] * torque[:, :, None] * theta.conj()[:, None, :]
            spread = spread + both + both.conj().swapaxes(1, 2)
        return np.asarray((spread + extra) * (gain**2)[:, None, None])

    def drawn(self, count: int, band: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
        """(m, N) of the balances, so many draws, with the inertias as they are along the motion, in the first
        `band` frequencies. Positions without a sensor have no noise."""
        window, n = self.balances.filter, len(self.drives)
        omega, gain = window.omega[:band], window.gain[:band]
        deviations = np.sqrt(self._coloured(omega)).T
        deviations[[k if channel == "q" else n + k for channel, k in self.balances.motion.missing]] = 0.0
        white = [fft.rfft(rng.standard_normal((4 * n, window.size)))[:, :band] for _ in range(count)]
        readings = np.array(white) * (deviations * gain)
        spectra = np.empty((count, len(self.balances.rows), band), dtype=complex)
        for begin in range(0, band, CHUNK):
            part = slice(begin, begin + CHUNK)
            transfer, _ = self.at(omega[part])
            of_all = transfer @ readings[:, :, part].transpose(2, 1, 0)  # (F, m, draws)
            spectra[:, :, part] = of_all.transpose(2, 1, 0)
        links = np.array([self._of_link(k, omega) for k in range(n)])  # (n, F, 4 n)
        links[[k for channel, k in self.balances.motion.missing if channel == "q"]] = 0.0  # moved by balances
        beyond = self.balances.motion.rigid.mass - self.load[2]
        for own, noise in zip(spectra, readings, strict=True):
            yield self._along_motion(own, -(omega**2) * np.einsum("kfc,cf->kf", links, noise), beyond)

    def _along_motion(self, spectra: np.ndarray, accelerations: np.ndarray, beyond: np.ndarray) -> np.ndarray:
        """(m, N) balances of these spectra (m, F), and what the noise of the links' accelerations (n, F) adds
        where inertias are `beyond` (N, n, n) their mean."""
        window, joints = self.balances.filter, self.balances.motion.robot.joints
        both = fft.irfft(np.concatenate([spectra, accelerations]), window.size)[:, : window.count]
        series, turning = both[: len(spectra)], both[len(spectra) :]
        for r, row in enumerate(self.balances.rows):
            if row.balance == LINK or joints[row.joint].rigid:
                scale = self.scales[row.joint] if row.balance == MOTOR else 1.0
                series[r] -= scale * np.einsum("tk,kt->t", beyond[:, row.joint], turning)
        return np.asarray(series)

    def _coloured(self, omega: np.ndarray) -> np.ndarray:
        """(F, 4 n) variances, as white noise would have to have them at each frequency."""
        out = np.tile(self.variances, (omega.size, 1))
        for channel, colour in self.colours.items():
            out[:, channel] *= colour.at(omega)
        return out

    def _adding(self, i: int, omega: np.ndarray) -> np.ndarray:
        """(F,) covariance of the noise of joint i's torque and theta, for a controller that makes the torque
        of theta: at frequencies at which the spring's torque exceeds that of the motor's inertia the two add
        up. Above these they would cancel, but count as independent: the controller may have seen another
        noise than the recorded one."""
        drive, colour = self.drives[i], self.colours.get(len(self.drives) + i)
        share = 1.0 if colour is None else np.minimum(1.0, colour.at(omega))
        return np.where(drive.B * omega**2 < drive.K, share * self.shared[i], 0.0)


def _noise(balances: Balances, effects: Sequence[Planned]) -> Noise:
    limits = balances.settings.regression
    robot, readings, rigid = balances.motion.robot, balances.motion.readings, balances.motion.rigid
    n, used = len(robot.joints), readings.valid
    inertias, there, nominal = _masses(balances, effects)
    by_q, by_v = (x[used].mean(axis=0, dtype=float) for x in (rigid.by_q, rigid.by_v))
    mass = inertias[there].mean(axis=0, dtype=float)
    heavier = None if nominal is None else mass - nominal[there].mean(axis=0, dtype=float)
    q, theta, tau_t = (k * n + np.arange(n) for k in range(3))
    noise = np.stack([readings.noise[name] for name in ("q", "theta", "tau_t", "torque")]).ravel()
    largest = max(float(np.max(noise[: 2 * n])), 1e-7)
    variances = noise**2
    for e in effects:
        i = robot.joint_names.index(e.joint) if e.joint is not None else 0
        at = {"q": q[i], "theta": theta[i], "tau_t": tau_t[i]}
        if robot.joints[i].rigid:  # its one angle has the noise of theta
            at = {readings.encoder(robot.joint_names[i]): theta[i], "tau_t": tau_t[i]}
        for channel, index in at.items():
            if e.effect.site is Site.SENSOR and channel in e.effect.channels(e.p):
                variances[index] /= sensor_slope(e) ** 2
    for channel, i in balances.motion.missing:
        variances[q[i] if channel == "q" else theta[i]] = (UNBOUNDED * largest) ** 2
    told = np.isfinite(readings.tau_t[:, 0])
    unmeasured = {i for channel, i in balances.motion.missing if channel == "q" and not told[i]}
    off = inertias[there] - mass
    spread = {
        k: np.einsum("ti,tj->ij", off[:, :, k], off[:, :, k]) / max(1, len(off))
        for k, joint in enumerate(robot.joints)
        if k not in unmeasured and not joint.rigid
    }
    drives = tuple(drive_of(joint, effects) for joint in robot.joints)
    of_theta, of_torque = np.sqrt(variances[theta]), np.sqrt(variances[3 * n :])
    fed_back = readings.feedback * of_theta
    # a torque with less noise than that was made of other readings
    most = limits.most_fed_back * of_torque
    fed_back = np.where(fed_back < limits.fed_back * of_torque, np.minimum(fed_back, most), 0.0)
    shared = -of_theta * fed_back
    scales = tuple(
        balances.chains.command_scale(
            i, [e for e in effects if e.joint == joint.name and e.effect.site is Site.COMMAND]
        )
        for i, joint in enumerate(robot.joints)
    )
    return Noise(
        balances, drives, scales, (by_q, by_v, mass), heavier, variances, balances.colours, shared, spread
    )


def _row_transfer(
    row: Row,
    drive: Drive,
    rigid: bool,
    sprung: bool,
    s: np.ndarray,
    columns: tuple[np.ndarray, ...],
) -> list[tuple[int, np.ndarray | float]]:
    """Sensitivity of one balance to the readings of its own joint (without the rigid body's load), which is
    `sprung` where the spring's torque is the sensor's."""
    q, theta, tau_t, torque = (int(column[row.joint]) for column in columns)
    shaft = drive.B * s**2 + drive.D_m * s
    if rigid:
        return [(torque, 1.0), (theta, -shaft)]
    impedance = drive.K + drive.D * s
    if sprung and row.balance != SPRING:
        return [(tau_t, 1.0)] if row.balance == LINK else [(torque, 1.0), (theta, -shaft), (tau_t, -1.0)]
    if row.balance == MOTOR:
        return [(torque, 1.0), (theta, -shaft - impedance), (q, impedance)]
    if row.balance == LINK:
        return [(theta, impedance), (q, -impedance)]
    return [(tau_t, 1.0), (theta, -impedance), (q, impedance)]


def sensor_slope(e: Planned) -> float:
    """The factor by which a sensor effect scales its channel."""
    signals, p = Signals(), e.p
    return float(e.effect.map(signals, p, 1.0) - e.effect.map(signals, p, 0.0))


def changes_noise(e: Planned) -> bool:
    """Whether an effect changes how the sensors' noise enters the balances."""
    if e.effect.site is Site.SENSOR:
        return not np.isclose(sensor_slope(e), 1.0, atol=0.01)
    drives = e.effect.overrides("edit_drive") and not e.effect.for_rigid
    return drives or e.effect.overrides("edit_inertial")


def shapes_noise(e: Planned, balances: Balances) -> bool:
    """Whether an effect that is evaluated on the recording as it is would change its noise: one that changes
    the balances' noise, a limit that clips the peaks of a noisy torque, a law by which a joint is stiffer at
    some deflections than at others, whose noise then is more torque, or a joint that bends, whose link does
    not follow its encoder's noise: with less noise than predicted that would fit any recording better."""
    if e.effect.site is Site.COMMAND and not e.effect.overrides("delay") and e.joint is not None:
        joint = balances.motion.robot.joint_names.index(e.joint)
        return bool(balances.motion.readings.noise["torque"][joint] > 0.0)
    return changes_noise(e) or e.effect.overrides("slope") or e.effect.for_rigid


def _masses(
    balances: Balances, effects: Sequence[Planned]
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """(N', n, n) mass matrices along the motion with what BODY effects add, (N',) which of them are of usable
    samples, and the nominal ones (N', n, n), if these are others. Where they are computed again, a part of
    the samples is enough for mean and spread."""
    motion = balances.motion
    inertial = inertial_of(motion.robot.model)
    changed = False
    for e in effects:
        if e.effect.overrides("edit_inertial") and e.joint is not None:
            body = motion.robot.joint(e.joint).pin_id - 1
            inertial[body] = np.array(e.effect.edit_inertial(list(inertial[body]), e.p), dtype=float)
            changed = True
    valid = motion.readings.valid
    if not changed:
        return motion.rigid.mass, valid, None
    every = max(1, valid.size // MASSES)
    return mass_along(motion, inertial, every), valid[::every], motion.rigid.mass[::every]
