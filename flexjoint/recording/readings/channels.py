"""Channels that do not show what their name says: held, stuck, saturated, without sign, or filtered.

Samples that are no measurement become empty cells, a velocity that lags is left out, a torque without its
sign is refused. Every change is a note with channel, joint and span.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from flexjoint.recording.checks import check_rate, check_signs
from flexjoint.recording.noise import step_of, usual_noise, white_noise
from flexjoint.recording.table import Recording, was_measured
from flexjoint.robot.robot import Robot

MEASURED = ("q", "theta", "tau_t", "tau_motor", "dq", "dtheta")  # a command and a reference may be held

# repeated samples
RUNS = 50  # changes of a channel, at least, that tell at which rows it changes
SHORTER = 0.02  # share of its runs that may be shorter than usual: a channel whose samples are held has none
USUAL = 0.8  # share of usual ones; the others are longer, where the machine stands still
COARSE = 3.0  # steps of an encoder by which it changes, up to which its runs are those of rounding

# stuck encoders
STUCK_SECONDS = 0.1  # at least; a body that is faster than its encoder's step shows less
STUCK_SAMPLES = 20
BEYOND = 3.0  # times what the two sides differ by elsewhere, that the other side must move
STEPS = 10.0  # and of its encoder, or standard deviations of its noise
ALWAYS = 0.9  # share of a recording, from which on there is no elsewhere: then ...
MOVED = 0.1  # rad (or m) must the other side move: more than springs and gaps allow

# stuck or saturated encoders that nothing beside them shows: no body stops and starts between two samples
ABRUPT = 0.5  # of the usual speed, that it has right before and right after, or more, and ...
FLAT_SECONDS = 0.05  # at least
CLEAR = 10.0  # ... as many times its noise or its step, from sample to sample

# saturated sensors
FLAT = 5  # samples in a row at the largest value, and
FLAT_SAMPLES = 10  # in all: noise gives the largest value once
REPEATS = 0.05  # share of samples elsewhere that repeat the one before, up to which they carry noise
LIMIT = 0.02  # of a motor's torque limit, within which a torque that is flat is the motor's own

# lag of a velocity
SPAN = 0.05  # s over which positions and integrated velocities are compared
BLOCKS = 20  # such spans, at least
NOISY = 0.1  # share of noise in the change of a velocity, beyond which its lag would come out too small
SURE = 5.0  # standard errors that a lag must have; and it must be longer than a sampling period, since two
# channels of one row may be read that far apart
VELOCITIES = {"dq": "q", "dtheta": "theta"}


@dataclass
class _Work:
    """Columns and notes on the way."""

    recording: Recording
    columns: dict[tuple[str, str], np.ndarray]
    notes: list[str] = field(default_factory=list)


def inspected(robot: Robot, recording: Recording) -> Recording:
    """The recording with empty cells where a channel shows no measurement, and notes about that; the
    recording itself where all do.

    Raises RecordingError for a rate at which nothing can be diagnosed, and for torques without their sign.
    """
    check_rate(recording)
    work = _Work(recording, dict(recording.columns))
    for key in list(work.columns):
        if key[0] in MEASURED:
            _unheld(work, key)
    for joint in robot.joint_names:
        for channel in ("q", "theta"):
            _unstuck(work, robot, channel, joint)
            _unfrozen(work, channel, joint)
        for channel in ("tau_t", "dq", "dtheta", "tau_motor"):
            _unsaturated(work, robot, channel, joint)
        for velocity, position in VELOCITIES.items():
            _without_lag(work, velocity, position, joint)
    for key in [key for key, values in work.columns.items() if not was_measured(values)]:
        work.notes.append(f"{'.'.join(key)} has too few samples left and is not used")
        del work.columns[key]
    if work.notes:
        recording = replace(recording, columns=work.columns, notes=(*recording.notes, *work.notes))
    check_signs(robot, recording)
    return recording


# --- repeated and stuck samples ---------------------------------------------------------------------------
def _runs(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First samples and lengths of the runs in which a signal (N,) stays exactly the same."""
    first = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0.0) + 1])
    return first, np.diff(np.append(first, x.size))


def _unheld(work: _Work, key: tuple[str, str]) -> None:
    """A channel that repeats each sample until the next: one sample each, at a rate of its own."""
    rows = np.flatnonzero(np.isfinite(work.columns[key]))
    x = work.columns[key][rows]
    first, length = _runs(x)
    if first.size < RUNS:
        return
    usual = int(np.median(length))
    slack = 1 if usual > 2 else 0
    if usual < 2 or np.mean(length < usual - slack) > SHORTER or np.mean(length <= usual + slack) < USUAL:
        return
    quantum = step_of(x)
    if quantum > 0.0 and np.median(np.abs(np.diff(x[first]))) <= COARSE * quantum:
        return
    since = np.arange(x.size) - np.repeat(first, length)
    long = np.repeat(length, length) > usual + slack
    fresh = (since == 0) | (long & (since % usual == 0))
    values = np.full(work.recording.time.size, np.nan)
    values[rows[fresh]] = x[fresh]
    work.columns[key] = values
    work.notes.append(
        f"{'.'.join(key)} repeats each sample {usual} times: read as a channel of"
        f" {1.0 / (usual * work.recording.period):.4g} Hz"
    )


def _unstuck(work: _Work, robot: Robot, channel: str, joint: str) -> None:
    """Without the spans in which an encoder stays the same while another signal shows that it moves."""
    if (channel, joint) not in work.columns:
        return
    x, time = work.columns[channel, joint], work.recording.time
    rows = np.flatnonzero(np.isfinite(x))
    first, length = _runs(x[rows])
    begin, end = rows[first], rows[first + length - 1]
    long = (length >= STUCK_SAMPLES) & (time[end] - time[begin] >= STUCK_SECONDS)
    begin, end = begin[long], end[long]
    if not begin.size:
        return
    still = np.zeros(time.size, dtype=bool)
    for a, b in zip(begin, end, strict=True):
        still[a : b + 1] = True
    for witness, w in _witnesses(work, channel, joint).items():
        apart = (w - x)[~still & np.isfinite(w - x)]
        always = np.mean(still[rows]) > ALWAYS
        usual = MOVED if always else BEYOND * float(np.ptp(apart))
        usual += STEPS * max(step_of(w[np.isfinite(w)]), white_noise(w))
        found = []
        for a, b in zip(begin, end, strict=True):
            there = w[a : b + 1][np.isfinite(w[a : b + 1])]
            moved = float(np.ptp(there)) if there.size else 0.0
            if moved > usual + _deflected(work, robot, joint, slice(a, b + 1)):
                found.append((a, b, moved))
        if not found:
            continue
        values = x.copy()
        for a, b, _ in found:
            values[a : b + 1] = np.nan
        work.columns[channel, joint] = values
        a, b, moved = max(found, key=lambda span: span[2])
        more = f", and in {len(found) - 1} more spans" if len(found) > 1 else ""
        work.notes.append(
            f"{channel}.{joint} stays at {x[a]:.6g} from {time[a]:.4g} to {time[b]:.4g} s while"
            f" {witness}.{joint} moves by {moved:.3g}{more}: a stuck encoder; these samples are not"
            " used"
        )
        return


def _unfrozen(work: _Work, channel: str, joint: str) -> None:
    """Without the spans in which an encoder stays the same and before and behind which it moves at full speed
    from one sample to the next, as no body does: one that sticks, or at the end of its range. And a note
    where it never changes."""
    if (channel, joint) not in work.columns:
        return
    values, time = work.columns[channel, joint], work.recording.time
    rows = np.flatnonzero(np.isfinite(values))
    x = values[rows]
    if x.size < FLAT:
        return
    if np.ptp(x) == 0.0:
        work.notes.append(
            f"{channel}.{joint} is {x[0]:.6g} throughout: the joint stands still or is locked, or its"
            " encoder is dead"
        )
        return
    steps = np.abs(np.diff(x))
    moving = steps[steps > 0.0]
    least = max(ABRUPT * float(np.sqrt(np.mean(moving**2))), CLEAR * max(step_of(x), usual_noise(x)))
    first, length = _runs(x)
    found = []
    for a, n in zip(first.tolist(), length.tolist(), strict=True):
        end = a + n - 1
        long = n >= FLAT and time[rows[end]] - time[rows[a]] >= FLAT_SECONDS
        if long and a >= 2 and end + 1 < x.size and min(steps[a - 2], steps[end]) > least:
            found.append((a, end))
    if not found:
        return
    out = values.copy()
    for a, end in found:
        out[rows[a : end + 1]] = np.nan
    for extreme in {x[a] for a, _ in found} & {np.max(x), np.min(x)}:
        out[rows[x == extreme]] = np.nan  # the end of its range, however slowly it came there
    work.columns[channel, joint] = out
    a, end = max(found, key=lambda span: span[1] - span[0])
    more = f", and in {len(found) - 1} more spans" if len(found) > 1 else ""
    work.notes.append(
        f"{channel}.{joint} stays at {x[a]:.6g} from {time[rows[a]]:.4g} to {time[rows[end]]:.4g} s, and"
        f" moves at full speed right before and behind{more}: an encoder that is stuck or at the end of its"
        " range; these samples are not used"
    )


def _witnesses(work: _Work, channel: str, joint: str) -> dict[str, np.ndarray]:
    """Signals (N,) that move as a position does: the other side, the references, its integrated velocity."""
    other = "theta" if channel == "q" else "q"
    names = (other, f"{channel}_ref", f"{other}_ref")
    found = {name: work.columns[name, joint] for name in names if (name, joint) in work.columns}
    rate = work.columns.get((f"d{channel}", joint))
    if rate is not None and was_measured(rate):
        time, known = work.recording.time, np.isfinite(rate)
        steady = np.interp(time, time[known], rate[known])
        steps = 0.5 * (steady[1:] + steady[:-1]) * np.diff(time)
        # an integral drifts against its position with the velocity's offset: a whole recording says nothing
        path = np.concatenate([[0.0], np.cumsum(steps)])
        position = work.columns[channel, joint]
        here = np.isfinite(position)
        drift = np.polyfit(time[here] - time[0], path[here] - position[here], 1)[0]
        found[f"the integral of d{channel}"] = path - drift * (time - time[0])
    return found


def _deflected(work: _Work, robot: Robot, joint: str, rows: slice) -> float:
    """How far [rad] one side of a spring may move alone by what its torque changes there."""
    stiffness = float(robot.joint(joint).drive.K) if not robot.joint(joint).rigid else np.inf
    for channel in ("tau_t", "tau_motor", "tau_m"):
        torque = work.columns.get((channel, joint))
        if torque is not None and np.any(np.isfinite(torque[rows])):
            return BEYOND * float(np.nanmax(torque[rows]) - np.nanmin(torque[rows])) / stiffness
    return 0.0


# --- saturated sensors ------------------------------------------------------------------------------------
def _unsaturated(work: _Work, robot: Robot, channel: str, joint: str) -> None:
    """Without the samples at the end of a sensor's range, where it is noisy elsewhere and exact there."""
    if (channel, joint) not in work.columns:
        return
    values = work.columns[channel, joint]
    rows = np.flatnonzero(np.isfinite(values))
    x = values[rows]
    first, length = _runs(x)
    flat = np.zeros(x.size, dtype=bool)
    for extreme in (np.max(x), np.min(x)):
        at = x[first] == extreme
        if np.sum(length[at]) >= FLAT_SAMPLES and np.max(length[at]) >= FLAT:
            flat |= x == extreme
    elsewhere = np.repeat(length, length)[~flat]
    if not np.any(flat) or not elsewhere.size or np.mean(elsewhere > 1) > REPEATS:
        return
    size = float(np.max(np.abs(x[flat])))
    spans = np.flatnonzero(np.diff(np.concatenate([[False], flat, [False]]).astype(int)) == 1)
    where = (
        f"{channel}.{joint} stays at {size:.4g}, the end of its range, in {np.count_nonzero(flat)} samples"
        f" from {work.recording.time[rows[spans[0]]]:.4g} s on"
    )
    if channel == "tau_motor":
        limit = float(robot.joint(joint).torque_limit)
        if abs(size - limit) > LIMIT * limit:
            work.notes.append(
                f"{where}, which is not the robot file's torque_limit of {limit:.4g}: taken as the motor's"
            )
        return
    out = values.copy()
    out[rows[flat]] = np.nan
    work.columns[channel, joint] = out
    work.notes.append(f"{where}: a saturated sensor, whose samples there are not used")


# --- velocities -------------------------------------------------------------------------------------------
def _without_lag(work: _Work, velocity: str, position: str, joint: str) -> None:
    """Without a velocity that lags its position: a filtered one."""
    if (velocity, joint) not in work.columns or (position, joint) not in work.columns:
        return
    lag = lag_of(work.recording.time, work.columns[position, joint], work.columns[velocity, joint])
    if lag is None:
        return
    said = (
        f"{velocity}.{joint} lags the derivative of {position}.{joint} by {1e3 * lag:.2g} ms: a sensor lag,"
        " as of a velocity that is filtered with this time constant"
    )
    torque = any((channel, joint) in work.columns for channel in ("tau_m", "tau_motor"))
    if velocity == "dtheta" and not torque:
        work.notes.append(f"{said}; the controller's torque is computed with it as it is")
        return
    del work.columns[velocity, joint]
    work.notes.append(f"{said}; it is not used")


def lag_of(time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> float | None:
    """Lag [s] of a velocity (N,) behind the derivative of a position (N,), where it is sure and longer than a
    sampling period; else None.

    A first-order filter T dv/dt = dq/dt - v leaves q = integral of v + T v, and a short delay T nearly so
    (Ljung 1999, "System Identification", chapter 7): T by regression over spans, with a gain and an offset of
    the velocity.
    """
    both = np.isfinite(position) & np.isfinite(velocity)
    t, q, v = time[both], position[both], velocity[both]
    if t.size < BLOCKS:
        return None
    period = float(np.median(np.diff(t)))
    path = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    count = max(2, round(SPAN / period))
    edges = np.arange(0, t.size, count)
    whole = np.diff(t[edges]) < 1.5 * count * period
    if np.count_nonzero(whole) < BLOCKS:
        return None
    turned, integral, change, passed = (np.diff(x[edges])[whole] for x in (q, path, v, t))
    noise = 2.0 * usual_noise(v) ** 2
    if noise > NOISY * float(np.mean(change**2)):
        return None
    design = np.stack([change, integral, passed], axis=1)
    scale = np.linalg.norm(design, axis=0)
    if not np.all(scale > 0.0):
        return None
    solution, _, rank, _ = np.linalg.lstsq(design / scale, turned, rcond=None)
    if rank < 3:
        return None
    rest = turned - design / scale @ solution
    inverse = np.linalg.inv((design / scale).T @ (design / scale))
    error = float(np.sqrt(np.mean(rest**2) * inverse[0, 0])) / scale[0]
    lag = float(solution[0]) / scale[0]
    return float(lag) if lag > max(period, SURE * error) else None
