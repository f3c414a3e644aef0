"""A recording against its robot, before any work is done on it: joints, rate, units.

The usual slip is degrees for radians, in one column or in all of them. It is looked for where columns must
agree with each other (positions of one joint, a velocity with the derivative of a position) and, for all
angles of a joint at once, where they must agree with the robot: the URDF's limits, the spring, the control
law and the rigid-body torque.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from flexjoint.core.errors import unknown
from flexjoint.core.messages import shown
from flexjoint.effects import Signals
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.clock import without_pauses
from flexjoint.recording.messages import refusal
from flexjoint.recording.smooth import local_polynomial
from flexjoint.recording.stamps import FASTEST_COUNTED, SLOWEST, UNITS
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint, Robot

UNLIKELY = 0.5  # s; nobody records a motion so slowly: the time column is in another unit
FASTEST = 1e5  # Hz; above it the time column is hardly in seconds
DEGREES = 180.0 / math.pi  # per radian
NEAR = 1.6  # a ratio within this factor of 57.3 counts as 57.3: no physical effect comes near it
ALIKE = 0.95  # correlation from which two columns are taken to show the same motion
OFFSET = 0.3  # rad by which positions of one joint may differ (offsets, deflection, tracking error)
OUTSIDE = 0.1  # share of a joint's range, and rad, beyond its limits that a recording may lie
EXACT = 0.03  # share by which a slope may differ from a gear ratio, or from 57.3 where little deflects ...
RIGID = 0.9995  # ... which this correlation of two encoders shows
SPAN = 0.05  # s over which a velocity is integrated against a position
POINTS = 800  # instants at which torques are compared
ONE_SIGN = 0.02  # of its largest value, below which a torque has no sign
OTHER_SIGN = 0.01  # share of samples of the other sign, which an offset or noise may give
BOTH_SIGNS = 0.2  # of its RMS, that a torque must exceed ...
OFTEN = 0.1  # ... in this share of instants, on either side, to have both signs
FOLLOWS = 0.6  # correlation from which a torque follows the size of another, through friction and noise, ...
CLEARLY = 0.3  # ... and by how much better than that torque itself
EDGE = 0.02  # share of the recording at either end where its derivatives are not used

POSITIONS = ("q", "theta", "q_ref", "theta_ref")
INTEGRALS = {  # positions that a velocity is compared with, the first that is there
    "dq": ("q", "theta", "q_ref", "theta_ref"),
    "dtheta": ("theta", "q", "theta_ref", "q_ref"),
    "dtheta_ref": ("theta_ref", "q_ref", "theta", "q"),
}
TORQUES = ("tau_m", "tau_motor")
REMEDY = "angles are expected in radians, velocities in rad/s"


def check(robot: Robot, recording: Recording) -> None:
    """Refuse a recording that cannot be of this robot or is in wrong units.

    Raises RecordingError that names the column: an unknown joint, no position of any actuated joint, fewer
    than 50 samples a second, angles or velocities wrong by 180/pi, torques without their sign.
    """
    check_joints(robot, recording)
    _check_positions(robot, recording)
    check_rate(recording)
    recording = without_pauses(recording)
    check_columns(robot, recording)
    _compare_with_robot(robot, recording)
    check_signs(robot, recording)


def check_columns(robot: Robot | None, recording: Recording) -> None:
    """Raise RecordingError where columns of one joint say of each other that one is off by 180/pi, in a
    recording without long pauses. A robot tells the gear ratios by which a motor's angle may be larger."""
    for joint in recording.joints:
        _compare_positions(robot, recording, joint)
        _compare_velocities(recording, joint)


def check_joints(robot: Robot, recording: Recording) -> None:
    """Raise RecordingError unless every joint of the recording is one of the robot's."""
    valid = all_joints(robot)
    for channel, joint in recording.columns:
        if joint not in valid:
            reason = unknown("joint", shown(joint), valid)
            column = shown(f"{channel}.{joint}")
            raise refusal(recording.name, f"column {column}: {reason} ({robot.name})")


def all_joints(robot: Robot) -> tuple[str, ...]:
    """Names of the URDF's joints that a recording may hold: actuated, passive and locked."""
    moving = [name for name in robot.model.names if name not in ("universe", "root_joint")]
    return (*moving, *robot.file.lock)


def _check_positions(robot: Robot, recording: Recording) -> None:
    pairs = itertools.product(("q", "theta"), robot.joint_names)
    if not any(recording.has(channel, joint) for channel, joint in pairs):
        raise refusal(
            recording.name,
            f"no position of any actuated joint; expected q.<joint> or theta.<joint> of"
            f" {', '.join(robot.joint_names)}",
        )


def check_rate(recording: Recording) -> None:
    """Raise RecordingError for fewer than 50 samples a second, or for more than any logger takes."""
    period = recording.period
    if period > (1.0 + 1e-9) / SLOWEST:
        raise refusal(
            recording.name,
            f"a sample every {period:.4g} s is too coarse{_unit_hint(period)}; record at {SLOWEST:g} Hz or"
            " faster, and give time in seconds",
        )
    if period < 1.0 / FASTEST:
        raise refusal(recording.name, f"a sample every {period:.3g} s is too fine; give time in seconds")


def _unit_hint(period: float) -> str:
    for unit, factor in UNITS.items() if period > UNLIKELY else ():
        if SLOWEST <= 1.0 / (factor * period) <= FASTEST_COUNTED:
            return f" (in {unit} it were {1.0 / (factor * period):.4g} Hz)"
    return ""


def check_signs(robot: Robot, recording: Recording) -> None:
    """Raise RecordingError for motor torques that never change their sign where those that the motion takes
    do, and that follow the size of those: currents without sign."""
    for channel in TORQUES:
        suspects = [
            name
            for name in robot.joint_names
            if recording.has(channel, name) and keeps_one_sign(recording.get(channel, name))
        ]
        dynamics = _Torques.of(robot, recording, (channel,)) if suspects else None
        for name in suspects:
            if dynamics is not None and dynamics.unsigned(name):
                raise refusal(
                    recording.name,
                    f"{channel}.{name} has one sign only, although the motion needs torques of both signs,"
                    " and it follows their magnitude: the sign is missing; record it with its sign",
                )


def keeps_one_sign(torque: np.ndarray) -> bool:
    """Whether a torque or current (N,) never changes its sign, but for an offset or noise."""
    known = torque[np.isfinite(torque)]
    least = ONE_SIGN * float(np.max(np.abs(known), initial=0.0))
    return bool(known.size) and min(np.mean(known > least), np.mean(known < -least)) < OTHER_SIGN


# --- columns against each other ---------------------------------------------------------------------------
def _compare_positions(robot: Robot | None, recording: Recording, joint: str) -> None:
    """Raise when one position of a joint is 57.3 times another of the same joint, by its unit."""
    there = [channel for channel in POSITIONS if recording.has(channel, joint)]
    large: list[str] = []
    small: list[str] = []
    ratio = DEGREES
    for one, other in itertools.permutations(there, 2):
        x, y = _common(recording.get(one, joint), recording.get(other, joint))
        found = _ratio(x, y)
        if found is None or _geared(robot, joint, one, other, x, y):
            continue
        if abs(np.mean(y) / DEGREES - np.mean(x)) < OFFSET:
            large, small, ratio = [*large, f"{other}.{joint}"], [*small, f"{one}.{joint}"], found
    if not large:
        return
    columns, others = ", ".join(dict.fromkeys(large)), ", ".join(dict.fromkeys(small))
    raise refusal(
        recording.name,
        f"{columns} is {ratio:.1f} times {others}: {columns} looks like degrees (or"
        f" {others} was converted to radians twice); {REMEDY}",
    )


def _geared(robot: Robot | None, joint: str, one: str, other: str, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether y is the motor's angle before its gear, and x that of the link, which is another error
    (`flexjoint.diagnosis.data`): by the gear ratio, or as both agree to a factor that is none of a unit."""
    if not (one.startswith("q") and other.startswith("theta")):
        return False
    slope = float(np.std(y) / np.std(x))
    gear = robot.joint(joint).gear_ratio if robot is not None and joint in robot.joint_names else None
    if gear is not None:
        return abs(slope / gear - 1.0) < min(EXACT, abs(slope / DEGREES - 1.0))
    alike = float(np.corrcoef(x, y)[0, 1])
    return alike > RIGID and abs(slope / DEGREES - 1.0) > EXACT


def _compare_velocities(recording: Recording, joint: str) -> None:
    """Raise when a velocity and the derivative of a position of the same joint differ by 57.3."""
    for channel, positions in INTEGRALS.items():
        position = next((name for name in positions if recording.has(name, joint)), None)
        if position is None or not recording.has(channel, joint):
            continue
        turned, measured = _increments(recording, channel, position, joint)
        velocity, angle = f"{channel}.{joint}", f"{position}.{joint}"
        found = _ratio(measured, turned)
        if found is not None:
            raise refusal(
                recording.name,
                f"{velocity} is {found:.1f} times the derivative of {angle}: {velocity}"
                f" looks like degrees per second; {REMEDY}",
            )
        found = _ratio(turned, measured)
        if found is not None:
            raise refusal(
                recording.name,
                f"the derivative of {angle} is {found:.1f} times {velocity}: {angle} looks"
                f" like degrees (or {velocity} was converted to radians twice); {REMEDY}",
            )


def _increments(
    recording: Recording, channel: str, position: str, joint: str
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) angles turned in abutting spans of 50 ms, by the velocity and by the position."""
    time = recording.time
    edges = np.arange(time[0], time[-1], max(SPAN, 4.0 * recording.period))  # bounded: no long pauses
    known = np.isfinite(recording.get(channel, joint))
    rate = np.interp(time, time[known], recording.get(channel, joint)[known])
    path = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    known = np.isfinite(recording.get(position, joint))
    angle = np.interp(edges, time[known], recording.get(position, joint)[known])
    return np.diff(np.interp(edges, time, path)), np.diff(angle)


def _common(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    both = np.isfinite(x) & np.isfinite(y)
    return x[both], y[both]


def _ratio(x: np.ndarray, y: np.ndarray) -> float | None:
    """How many times x (N,) y varies as much, when that is about 57.3 and both show the same motion."""
    if x.size < 2:
        return None
    spread_x, spread_y = float(np.std(x)), float(np.std(y))
    if spread_x == 0.0 or not DEGREES / NEAR < spread_y / spread_x < DEGREES * NEAR:
        return None
    alike = np.mean((x - np.mean(x)) * (y - np.mean(y))) / (spread_x * spread_y)
    return spread_y / spread_x if alike > ALIKE else None


# --- columns against the robot ----------------------------------------------------------------------------
def _compare_with_robot(robot: Robot, recording: Recording) -> None:
    """Raise when all angles of a joint are in degrees, so that they agree with each other."""
    dynamics = _Torques.of(robot, recording)
    for name in recording.joints:
        if dynamics is not None and dynamics.in_radians(name):
            continue  # the torques say so: a limit or gain of the files that says otherwise is wrong itself
        reason = _beyond_limits(robot, recording, name)
        if reason is None and name in robot.joint_names:
            joint = robot.joint(name)
            reason = _against_spring(joint, recording) or _against_law(robot, joint, recording)
        if reason is not None:
            raise refusal(recording.name, f"{reason}; {REMEDY}")
    if dynamics is not None:
        for names in (*((name,) for name in robot.joint_names), robot.joint_names):
            _refuse_units(dynamics, recording, names)


def _refuse_units(dynamics: _Torques, recording: Recording, names: Sequence[str]) -> None:
    pairs = [pair for pair in recording.columns if pair[0] in POSITIONS and pair[1] in names]
    columns = ", ".join(f"{channel}.{name}" for channel, name in pairs)
    for factor, said in ((1.0 / DEGREES, "divided"), (DEGREES, "multiplied")):
        if dynamics.speak_for(names, factor):
            raise refusal(
                recording.name,
                f"the torques that the motion of {columns} needs agree with the measured"
                f" ones only when {said} by {DEGREES:.1f}: {_slip(said == 'divided')}; {REMEDY}",
            )


def _slip(large: bool) -> str:
    return "they look like degrees" if large else "they look converted to radians twice"


def _beyond_limits(robot: Robot, recording: Recording, name: str) -> str | None:
    if not robot.model.existJointName(name):
        return None  # locked
    place = robot.model.joints[robot.model.getJointId(name)].idx_q
    low, high = float(robot.model.lowerPositionLimit[place]), float(robot.model.upperPositionLimit[place])
    if not 0.0 < high - low < 1e3:
        return None  # without limits
    margin = OUTSIDE * (high - low) + OUTSIDE
    for channel in POSITIONS:
        if not recording.has(channel, name):
            continue
        seen = np.nanpercentile(recording.get(channel, name), [1.0, 99.0])
        # another zero of the encoder shifts it by no more than a turn, and leaves its extent as it is
        beyond = max(low - seen[0], seen[1] - high)
        outside = beyond > 2.0 * math.pi or seen[1] - seen[0] > high - low + 2.0 * margin
        if _before_gear(robot, recording, name, channel, (low - margin, high + margin)):
            continue  # another error: `flexjoint.diagnosis.data` tells
        scaled = seen / DEGREES
        if outside and low - margin < scaled[0] and scaled[1] < high + margin:
            return (
                f"{channel}.{name} goes from {seen[0]:.4g} to {seen[1]:.4g} where the URDF allows {low:.4g}"
                f" to {high:.4g} rad, and fits when divided by {DEGREES:.1f}: it looks like degrees"
            )
    return None


def _before_gear(
    robot: Robot, recording: Recording, name: str, channel: str, limits: tuple[float, float]
) -> bool:
    """Whether a position may be the motor's before its gear: it is beside the link's; or it lies within the
    limits then, and torques can tell."""
    if not channel.startswith("theta"):
        return False
    values = recording.get(channel, name)
    if recording.has("q", name):
        return _geared(robot, name, "q", channel, *_common(recording.get("q", name), values))
    gear = robot.joint(name).gear_ratio if name in robot.joint_names else None
    if gear is None or not any(recording.has(torque, name) for torque in TORQUES):
        return False
    low, high = np.nanpercentile(values, [1.0, 99.0]) / gear
    return bool(limits[0] < low and high < limits[1])


def _against_spring(joint: Joint, recording: Recording) -> str | None:
    """tau_t = K (theta - q) tells the unit of the angles."""
    needed = ("q", "theta", "tau_t")
    if joint.rigid or not all(recording.has(channel, joint.name) for channel in needed):
        return None
    q, theta, tau_t = (recording.get(channel, joint.name) for channel in needed)
    return _against(
        *_common(tau_t, float(joint.drive.K) * (theta - q)),
        f"tau_t.{joint.name}",
        f"stiffness times (theta.{joint.name} - q.{joint.name})",
    )


def _against(measured: np.ndarray, expected: np.ndarray, column: str, formula: str) -> str | None:
    ratio = _ratio(measured, expected)
    if ratio is not None:
        return f"{formula} is {ratio:.1f} times {column}: {_slip(large=True)}"
    ratio = _ratio(expected, measured)
    if ratio is not None:
        return f"{column} is {ratio:.1f} times {formula}: {_slip(large=False)}"
    return None


def _against_law(robot: Robot, joint: Joint, recording: Recording) -> str | None:
    """tau_m = tau_ff + kp (theta_ref - theta) + kd (dtheta_ref - dtheta), where it is not saturated."""
    needed = ("tau_m", "tau_ff", "theta_ref", "theta")
    named = robot.file.joints[joint.name].controller not in (None, "motor_pd")
    if named or joint.kp == 0.0 or not all(recording.has(channel, joint.name) for channel in needed):
        return None
    tau_m, tau_ff, theta_ref, theta = (recording.get(channel, joint.name) for channel in needed)
    expected = joint.kp * (theta_ref - theta)
    for channel, sign in (("dtheta_ref", 1.0), ("dtheta", -1.0)):
        if recording.has(channel, joint.name):
            expected = expected + sign * joint.kd * recording.get(channel, joint.name)
    free = np.abs(tau_m) < 0.999 * min(joint.torque_limit, 1e300)
    return _against(
        *_common((tau_m - tau_ff)[free], expected[free]),
        f"tau_m.{joint.name} less tau_ff.{joint.name}",
        f"kp (theta_ref.{joint.name} - theta.{joint.name}) and its kd part",
    )


class _Torques:
    """Motor torques that a motion takes by the nominal model, against the recorded ones."""

    def __init__(self, model: FlexibleJointModel, motion: dict[str, np.ndarray], tau: np.ndarray) -> None:
        self._model, self._motion, self._tau = model, motion, tau  # tau (M, n), NaN where not recorded
        self._names = model.robot.joint_names
        self._as_given = self._misfit((), 1.0)

    @classmethod
    def of(cls, robot: Robot, recording: Recording, torques: Sequence[str] = TORQUES) -> _Torques | None:
        """From the first of these torques that a joint has.

        None where a moving joint has more than one axis or no recorded position, or there is no torque."""
        joints = [name for name in robot.model.names if name != "universe"]
        sides = {name: [c for c in ("q", "theta") if recording.has(c, name)] for name in joints}
        driven = {name: [c for c in torques if recording.has(c, name)] for name in robot.joint_names}
        one_axis = all(joint.nq == 1 for joint in list(robot.model.joints)[1:])
        if not one_axis or not all(sides.values()) or not any(driven.values()):
            return None
        model = FlexibleJointModel(robot)
        last = recording.time.size - 1
        # evenly among the samples, so that few instants lie in pauses
        at = np.interp(
            np.linspace(EDGE * last, last - EDGE * last, POINTS), np.arange(last + 1), recording.time
        )
        width = max(0.01, 3.0 * recording.period)
        q, v, a = np.tile(model.body.neutral, (POINTS, 1)), *np.zeros((2, POINTS, model.nv))
        motor = np.zeros((3, POINTS, len(robot.joint_names)))
        for name, channels in sides.items():
            joint = robot.model.joints[robot.model.getJointId(name)]
            link = _smoothed(recording, channels[0], name, at, width)
            q[:, joint.idx_q], v[:, joint.idx_v], a[:, joint.idx_v] = link
            if name in robot.joint_names:
                motor[:, :, robot.joint_names.index(name)] = _smoothed(
                    recording, channels[-1], name, at, width
                )
        tau = np.full((POINTS, len(robot.joint_names)), np.nan)
        for i, (name, channels) in enumerate(driven.items()):
            if channels:
                tau[:, i] = _smoothed(recording, channels[0], name, at, width)[0]
        return cls(model, {"q": q, "v": v, "a": a, "motor": motor}, tau)

    def in_radians(self, name: str) -> bool:
        """Whether the torque of a joint speaks for its angles as they are."""
        if name not in self._names:
            return False
        i = self._names.index(name)
        as_given, divided = self._as_given[i], self._misfit((name,), 1.0 / DEGREES)[i]
        return bool(as_given < 0.4 and as_given < 0.25 * divided)

    def speak_for(self, names: Sequence[str], factor: float) -> bool:
        """Whether the torques of these joints speak for their angles times a factor, not as they are."""
        rows = [self._names.index(name) for name in names]
        as_given, scaled = self._as_given[rows], self._misfit(names, factor)[rows]
        return bool(np.all(scaled < 0.25) and np.all(scaled < 0.1 * as_given))

    def unsigned(self, name: str) -> bool:
        """Whether a torque of one sign follows the size of the torque that the motion takes, which has both
        signs, and not that torque."""
        i = self._names.index(name)
        tau, needed = self._tau[:, i], self._needed((), 1.0)[i]
        tau = tau * (1.0 if np.mean(tau) >= 0.0 else -1.0)
        large = BOTH_SIGNS * float(np.sqrt(np.mean(needed**2)))
        if min(np.mean(needed > large), np.mean(needed < -large)) < OFTEN or np.std(tau) == 0.0:
            return False
        size = float(np.corrcoef(tau, np.abs(needed))[0, 1])
        return size > FOLLOWS and size > abs(float(np.corrcoef(tau, needed)[0, 1])) + CLEARLY

    def _misfit(self, names: Iterable[str], factor: float) -> np.ndarray:
        """(n,) mean square of measured less predicted torque over that of the measured one, with the angles
        of some joints times a factor; NaN where there is no torque."""
        misfit = np.empty(len(self._names))
        for i, needed in enumerate(self._needed(names, factor)):
            power = float(np.mean(self._tau[:, i] ** 2))
            misfit[i] = np.mean((self._tau[:, i] - needed) ** 2) / power if power > 0.0 else np.nan
        return misfit

    def _needed(self, names: Iterable[str], factor: float) -> list[np.ndarray]:
        """The motor torque (M,) of each joint that the motion takes, with some angles times a factor."""
        robot, body = self._model.robot, self._model.body
        q, v, a = (self._motion[key].copy() for key in ("q", "v", "a"))
        motor = self._motion["motor"].copy()
        for name in names:
            joint = robot.joint(name)
            motor[:, :, self._names.index(name)] *= factor
            q[:, joint.idx_q] *= factor
            v[:, joint.idx_v] *= factor
            a[:, joint.idx_v] *= factor
        load = body.rnea_batch(q, v, a)
        out, of = [], []
        z = np.zeros((max(self._model.nz, 1), 1))
        for i, flow in enumerate(self._model.flows):
            theta, dtheta, _ = motor[:, :, i]
            of.append(Signals(0.0, q[:, flow.joint.idx_q], v[:, flow.joint.idx_v], theta, dtheta))
            out.append(load[:, flow.joint.idx_v] - flow.torques(of[i], z)[1])
        own = self._model.motor_torques(of, [motor[2, :, i] for i in range(len(of))], z)
        out = [needed + torque for needed, torque in zip(out, own, strict=True)]
        return out


def _smoothed(recording: Recording, channel: str, joint: str, at: np.ndarray, width: float) -> np.ndarray:
    """(3, M) value and its first two derivatives."""
    known = np.isfinite(recording.get(channel, joint))
    return np.array(local_polynomial(recording.time[known], recording.get(channel, joint)[known], at, width))
