"""From a recording to evenly sampled, gap-aware readings with predicted noise, ready to be filtered.

Positions are never differentiated by differences: one Gaussian filter and its analytic derivatives are
applied in the frequency domain, identically to every signal (Savitzky-Golay's idea with a smoother
window). Noise is predicted from the readings themselves, not fitted to the residual.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.interpolate import Akima1DInterpolator, CubicSpline
from scipy.ndimage import convolve1d, map_coordinates
from scipy.signal import ShortTimeFFT, get_window

from flexjoint.core.errors import RecordingError
from flexjoint.diagnosis.settings import USUAL, Settings, SignalSettings
from flexjoint.diagnosis.signals.command import Source, torque_source
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.noise import step_of, white_noise
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

FILTER_SAMPLES = 2.0  # ... this many samples, below which its sampled kernel aliases
PADDED_SIGMAS = 4.5  # of the filter, within which it mixes in what lies beyond an end
WIENER_SEGMENT = 512  # samples, of the spectra by which noise is separated from motion,
WIENER_HOPS = 4  # ... as many of which overlap,
WIENER_BINS = 9  # ... as many frequencies of which tell a power,
WIENER_SIGNAL = 3.0  # ... and times the noise's, from which it is no noise by chance
SLOWER = 1.5  # times the table's period between a channel's samples, from which it has a rate of its own


@dataclass(frozen=True)
class Readings:
    """Evenly sampled readings of the actuated joints, (n, N) each; a row of NaN was not measured.

    `torque` is the motor torque at the sample times: a command is moved by half its hold, a measured
    torque is not. A rigid joint has one angle: q and theta are both what its `encoder` reads. `valid` (N,)
    marks samples whose surroundings were measured. `noise` maps a channel to its predicted standard
    deviation per sample (n,), quantisation included. `phi` is theta - q; of readings without their noise it
    is that of less noise than the two angles'.
    """

    time: np.ndarray
    q: np.ndarray
    theta: np.ndarray
    phi: np.ndarray
    tau_t: np.ndarray
    torque: np.ndarray
    commanded: np.ndarray  # (n,) bool: torque is a command (held), not a measurement
    feedback: np.ndarray  # (n,) N m/rad, with which a torque was made of the recorded theta; 0: it was not
    valid: np.ndarray
    noise: dict[str, np.ndarray]
    steps: dict[str, np.ndarray]  # per channel of `noise`: (n,) step of quantised samples, or 0
    sigma: float  # [s] of the Gaussian filter
    start: float  # recording time of the first sample [s]
    recording: Recording  # what they were made of, on its regular clock
    settings: Settings = USUAL  # of the whole diagnosis

    @property
    def period(self) -> float:
        return float(self.time[1] - self.time[0])

    def encoder(self, joint: str) -> str:
        """The channel that reads a rigid joint's one angle: its motor's encoder where it has one."""
        return _encoder(self.recording, joint)


def prepare(robot: Robot, recording: Recording, settings: Settings = USUAL) -> Readings:
    """Resample the recording evenly and predict its noise; the readings carry the `settings` on.

    Raises RecordingError when no joint of the robot has a usable position channel.
    """
    recording, signals = on_regular_clock(recording), settings.signals
    period = recording.period
    count = int(np.floor(recording.duration / period + 1e-6)) + 1
    time = recording.time[0] + period * np.arange(count)
    n = len(robot.joints)
    channels = {name: np.full((n, count), np.nan) for name in ("q", "theta", "tau_t", "torque")}
    noise, steps = ({name: np.zeros(n) for name in channels} for _ in range(2))
    commanded, feedback = np.zeros(n, dtype=bool), np.zeros(n)
    valid = np.ones(count, dtype=bool)
    slowest = period
    for row, joint in enumerate(robot.joints):
        for channel in ("q", "theta", "tau_t"):
            if not recording.has(channel, joint.name):
                continue
            samples = recording.get(channel, joint.name)
            own = _own_period(recording.time, samples, period)
            slowest = max(slowest, own)
            channels[channel][row], good = _evenly(recording.time, samples, time, own, signals)
            valid &= good
            noise[channel][row] = white_noise(samples) * float(np.sqrt(own / period))
            steps[channel][row] = step_of(samples[np.isfinite(samples)])
        if joint.rigid:
            one = _encoder(recording, joint.name)
            for of in (channels, noise, steps):
                of["q"][row] = of["theta"][row] = of[one][row]
        source = torque_source(robot, recording, joint)
        if source is None:
            continue
        commanded[row] = source.held
        own = _own_period(recording.time, source.values, period)
        slowest = max(slowest, own)
        values, good = _torque(
            recording.time, source.values, time, own, source.held, robot.rates.control, signals
        )
        channels["torque"][row] = values
        valid &= good
        noise["torque"][row] = torque_noise(source, own, robot.rates.control) * float(np.sqrt(own / period))
        feedback[row] = source.feedback * _unknown_share(source, own, robot.rates.control)
    if not np.any(np.isfinite(channels["q"]) | np.isfinite(channels["theta"])):
        raise RecordingError(
            f"{recording.name}: no position of any joint of {robot.name}; expected q.<joint> or theta.<joint>"
            f" for {', '.join(robot.joint_names)}"
        )
    sigma = max(signals.filter_seconds, FILTER_SAMPLES * slowest)
    return Readings(
        time, **channels, phi=channels["theta"] - channels["q"], commanded=commanded, feedback=feedback,
        valid=_shrink(valid, margin(sigma, signals), period), noise=noise, steps=steps, sigma=sigma,
        start=float(recording.time[0]), recording=recording, settings=settings,
    )  # fmt: skip


def _encoder(recording: Recording, joint: str) -> str:
    return "theta" if recording.has("theta", joint) else "q"


def _own_period(time: np.ndarray, samples: np.ndarray, period: float) -> float:
    """Sampling period [s] of a channel that is sampled more slowly than the table, else the table's.

    A channel of few samples is smoothed by a filter that reaches over several of them, as all are then. Of
    that its white noise has the density per Hz of its own period, which is more than the table's."""
    own = float(np.median(np.diff(time[np.isfinite(samples)])))
    return own if own > SLOWER * period else period


def _evenly(
    time: np.ndarray, samples: np.ndarray, grid: np.ndarray, own: float, settings: SignalSettings
) -> tuple[np.ndarray, np.ndarray]:
    """The signal of its own sampling period on the grid (cubic between samples), and where it was really
    measured."""
    present = np.isfinite(samples)
    t, x = time[present], samples[present]
    period = grid[1] - grid[0]
    if t.size == grid.size and np.allclose(t, grid, atol=1e-6 * period, rtol=0):
        return x.copy(), np.ones(grid.size, dtype=bool)
    values = CubicSpline(t, x)(np.clip(grid, t[0], t[-1]))
    after = np.searchsorted(t, grid, side="right").clip(1, t.size - 1)
    hole = t[after] - t[after - 1]
    good = (hole <= (settings.longest_bridge + 0.5) * own) & (grid >= t[0] - own) & (grid <= t[-1] + own)
    # a cubic across a long hole overshoots: hold it to a straight line there, it is not used anyway
    return np.where(good, values, np.interp(grid, t, x)), good


def _torque(
    time: np.ndarray,
    samples: np.ndarray,
    grid: np.ndarray,
    own: float,
    held: bool,
    rate: float,
    settings: SignalSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """The motor torque of its own sampling period on the grid. A command is held for 1/f_c from its tick; the
    mean of a held signal is the signal moved by half a hold. Missed ticks are interpolated linearly."""
    present = np.isfinite(samples)
    t, x = time[present], samples[present]
    if held:
        ticks, x = _at_ticks(t, x, rate, settings.tick_slack)
        t = ticks / rate + 0.5 / rate
        own = max(own, 1.0 / rate)
    if t.size < 2:
        return np.full(grid.size, x[0]), np.zeros(grid.size, dtype=bool)
    after = np.searchsorted(t, grid, side="right").clip(1, t.size - 1)
    good = (t[after] - t[after - 1]) <= (settings.longest_bridge + 1.5) * own
    good &= (grid >= t[0] - 1.5 * own) & (grid <= t[-1] + 1.5 * own)
    # local cubics: exact to higher order than lines on a smooth command, no ringing at a jump
    values = Akima1DInterpolator(t, x, method="makima")(np.clip(grid, t[0], t[-1]))
    return values, good


def _at_ticks(
    time: np.ndarray, command: np.ndarray, rate: float, slack: float
) -> tuple[np.ndarray, np.ndarray]:
    """The controller's ticks, each once, and the command of each: the mean where several samples lie in one.

    Of two samples in one tick the second is of the next where its stamp is in the tick's second half and the
    next has no sample: its stamp came early."""
    place = time * rate
    ticks = np.floor(place + slack)
    if np.all(np.diff(ticks) > 0.0):
        return ticks, command
    second = np.concatenate([[False], np.diff(ticks) == 0.0])
    free = np.append(ticks[1:] > ticks[:-1] + 1.0, True)
    ticks = np.where(second & free & (place - ticks >= 0.5), ticks + 1.0, ticks)
    unique, place_of, counts = np.unique(ticks, return_inverse=True, return_counts=True)
    return unique, np.bincount(place_of, weights=command) / counts


def torque_noise(source: Source, period: float, rate: float) -> float:
    """Noise of the torque signal. A command is known exactly where it was recorded. Of `ticks` commands a
    record one is known, which stands for the mean of all: of their white noise, slow as the balances are,
    (1 - 1/ticks)^2 for that one and (ticks - 1) / ticks^2 for the others. What the controller makes of
    readings holds their noise, which need not be what the controller saw."""
    return white_noise(source.values) * float(np.sqrt(_unknown_share(source, period, rate)))


def _unknown_share(source: Source, period: float, rate: float) -> float:
    """Share of a recorded torque's white noise that the mean torque of a period does not have, in variance as
    in covariance with a noise that it holds."""
    return 1.0 - 1.0 / max(1.0, period * rate) if source.origin == "tau_m" else 1.0


def margin(sigma: float, settings: SignalSettings) -> float:
    """Seconds beside an end or a gap that are not used, for a filter of this standard deviation [s]."""
    return max(settings.edge_deviations * sigma, settings.edge_seconds)


def reach_of_ends(readings: Readings) -> int:
    """Samples from an end into which the filter mixes what lies beyond it."""
    return int(np.ceil(PADDED_SIGMAS * readings.sigma / readings.period))


def _shrink(valid: np.ndarray, seconds: float, period: float) -> np.ndarray:
    """Drop what lies within so many seconds of an edge or a gap."""
    reach = int(np.ceil(seconds / period))
    bad = np.concatenate([np.ones(reach, bool), ~valid, np.ones(reach, bool)])
    spread = np.convolve(bad.astype(float), np.ones(2 * reach + 1), mode="same") > 0.5
    return ~spread[reach:-reach]


def centred(robot: Robot, readings: Readings) -> Readings:
    """With encoder offsets that are free in each recording: the motors' angles, moved so that springs carry
    the measured torque on average. What is left of the offsets is small, as laws need it that are not linear
    in the deflection (a gap, a friction at rest)."""
    if robot.file.offsets != "per_recording":
        return readings
    theta = readings.theta.copy()
    for i, joint in enumerate(robot.joints):
        apart = theta[i] - readings.q[i] - readings.tau_t[i] / joint.drive.K
        if not joint.rigid and np.all(np.isfinite(apart)):
            theta[i] -= np.mean(apart[readings.valid])
    return replace(readings, theta=theta, phi=theta - readings.q)


def denoised(readings: Readings) -> Readings:
    """The readings with everything passed through a Wiener filter: each frequency is kept to the share of its
    power that is not the predicted white noise. The deflection is filtered by itself: that of a stiff spring
    is far smaller than the motion, which keeps more of the noise of two angles than their difference can."""
    clean = {}
    noise = {**readings.noise, "phi": np.hypot(readings.noise["q"], readings.noise["theta"])}
    for name in ("q", "theta", "phi", "tau_t", "torque"):
        signals = getattr(readings, name).copy()
        for i, x in enumerate(signals):
            if np.isfinite(x[0]):
                signals[i] = wiener(x, float(noise[name][i]))
        clean[name] = signals
    return replace(readings, **clean)


@dataclass(frozen=True)
class Wiener:
    """A time-local Wiener filter of one signal: each frequency is kept, at each time, to the share of its
    power that is not the predicted white noise. A motion that is fast for a while only has little power in
    the mean."""

    count: int
    noise: float  # standard deviation
    transform: ShortTimeFFT
    reach: int  # samples by which both ends are continued
    spectra: np.ndarray  # (F, frames) of the continued signal about `line`
    share: np.ndarray  # (F, frames) that is kept
    line: np.ndarray  # (reach + count + reach,)

    @staticmethod
    def of(x: np.ndarray, noise: float) -> Wiener:
        """The filter of a signal (N,) with white noise of standard deviation `noise`."""
        segment = 2 * (min(x.size, WIENER_SEGMENT) // 2)
        window = get_window("blackmanharris", segment)  # little of a slow motion leaks to where noise is
        # both ends are continued by odd reflection, so that value and slope go on smoothly
        reach = segment - 1
        ahead, behind = 2.0 * x[0] - x[reach:0:-1], 2.0 * x[-1] - x[-2 : -reach - 2 : -1]
        longer = np.concatenate([ahead, x, behind])
        line = np.linspace(longer[0], longer[-1], longer.size)
        transform = ShortTimeFFT(window, max(1, segment // WIENER_HOPS), 1.0)
        spectra = transform.stft(longer - line)
        mean = np.full(WIENER_BINS, 1.0 / WIENER_BINS)
        power = convolve1d(np.abs(spectra) ** 2, mean, axis=0, mode="nearest")
        floor = noise**2 * np.sum(window**2)
        share = np.where(power > WIENER_SIGNAL * floor, 1.0 - floor / np.maximum(power, 1e-300), 0.0)
        share[:2] = 1.0
        return Wiener(x.size, noise, transform, reach, spectra, share, line)

    def signal(self) -> np.ndarray:
        """(N,) the signal without its noise."""
        kept = self.transform.istft(self.spectra * self.share, k1=self.line.size)
        return np.asarray((kept + self.line)[self.reach : self.reach + self.count])

    def error(self) -> np.ndarray:
        """(N,) standard deviation of the signal's error."""
        return self._deviation(np.mean(self.share, axis=0))

    def speed_error(self, window: Filter) -> np.ndarray:
        """(N,) standard deviation of the error of the signal's filtered rate of change. A Wiener filter's
        error has the noise's power times the share that is kept."""
        omega = 2.0 * np.pi * self.transform.f / window.period
        rate = omega * np.interp(omega, window.omega, window.gain)
        return self._deviation(np.mean(self.share * (rate**2)[:, None], axis=0))

    def _deviation(self, variance: np.ndarray) -> np.ndarray:
        """(N,) from the variance in each frame, per that of the noise."""
        times = self.transform.t(self.line.size) - self.reach
        return np.asarray(self.noise * np.sqrt(np.interp(np.arange(self.count), times, variance)))


def wiener(x: np.ndarray, noise: float) -> np.ndarray:
    """(N,) a signal without its white noise of standard deviation `noise` (Wiener)."""
    return Wiener.of(x, noise).signal()


@dataclass(frozen=True)
class Filter:
    """The Gaussian window and its derivatives, in the frequency domain, for signals of N samples."""

    count: int
    period: float  # [s]
    size: int  # padded length
    omega: np.ndarray  # (F,) rad/s
    gain: np.ndarray  # (F,)
    ramp: np.ndarray  # (padding,) from 0 to 1

    def spectrum(self, x: np.ndarray) -> np.ndarray:
        """(..., N) -> (..., F): the unfiltered spectrum; padded so that the ends meet smoothly."""
        pad = self.size - self.count
        if pad:
            ends = x[..., -1:] * (1.0 - self.ramp) + x[..., :1] * self.ramp
            x = np.concatenate([x, ends], axis=-1)
        return fft.rfft(x, axis=-1)

    def smooth(self, x: np.ndarray, order: int = 0) -> np.ndarray:
        """(..., N) -> (..., N): filtered, differentiated `order` times."""
        return self.smooth_share(x, 1.0, order)

    def smooth_share(self, x: np.ndarray, share: float, order: int = 0) -> np.ndarray:
        """The same with a share of the window's variance: shares that add up to 1 make the whole window."""
        shaped = self.spectrum(x) * self.gain**share * (1j * self.omega) ** order
        return fft.irfft(shaped, self.size, axis=-1)[..., : self.count]


def make_filter(count: int, period: float, sigma: float) -> Filter:
    size = fft.next_fast_len(count + int(20 * sigma / period), real=True)
    omega = 2.0 * np.pi * fft.rfftfreq(size, period)
    gain = np.exp(-0.5 * np.minimum((omega * sigma) ** 2, 600.0))
    return Filter(count, period, size, omega, gain, np.linspace(0.0, 1.0, size - count + 2)[1:-1])


def later(x: np.ndarray, samples: float) -> np.ndarray:
    """The signal delayed by a number of samples, by cubic interpolation on the even grid."""
    return np.asarray(map_coordinates(x, [np.arange(x.size) - samples], order=3, mode="nearest"))
