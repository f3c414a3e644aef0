"""Link and motor motion of a recording, completed where a sensor is absent, and the rigid-body torques
along it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import fft
from scipy.linalg import lapack

from flexjoint.core.errors import RecordingError
from flexjoint.diagnosis.signals.signals import Filter, Readings, make_filter
from flexjoint.effects import Drive, Planned
from flexjoint.recording.table import Recording
from flexjoint.rigidbody.numeric import PinBody, inertial_of
from flexjoint.robot.robot import Robot

DRIVEN_SUBSTEPS = 2  # per sample, where a link's motion is simulated from its motor's
DRIVEN_SHARE = 0.05  # of the filter's variance, by which that is smoothed: what it takes off, the link lacks
REGRESSOR_CHUNK = 1000  # samples evaluated at a time
ROWS = 8  # filtered at a time: of the largest excerpt 15 megabytes


WholeMotion = tuple[np.ndarray, np.ndarray, np.ndarray]  # q (N, nq), v and a (N, nv) of a whole model


@dataclass(frozen=True)
class Filtered:
    """A motion before the filter, along which functions of q, q' and q'' are filtered.

    f(F q) differs from F f(q) by a term in the window's variance. With shares 1/4 and 1/2 of the variance
    before f and the rest after it, that term cancels in 2 f(1/4) - f(1/2) (Richardson); noise, to which
    rigid-body torques are nearly linear, passes both alike."""

    robot: Robot
    window: Filter
    q: np.ndarray  # (n, N)
    passive: dict[str, np.ndarray]

    def motion(self, share: float) -> WholeMotion:
        return whole_motion(self.robot, self.window, self.q, self.passive, share)

    def of(self, f: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """(..., N) F f of a function of q, v and a that returns (..., N); in the function's precision."""
        out = 2.0 * self._share(f, 0.25)
        out -= self._share(f, 0.5)
        return out

    def _share(
        self, f: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], share: float
    ) -> np.ndarray:
        values = f(*self.motion(share))
        flat = values.reshape(-1, values.shape[-1])
        for first in range(0, len(flat), ROWS):
            part = slice(first, first + ROWS)
            flat[part] = self.window.smooth_share(flat[part], 1.0 - share)
        return values


class Regressor:
    """Filtered torques per unit of each actuated body's ten inertial parameters along a motion, evaluated
    when they are first asked for. A body loads the joints that carry it: only those are kept."""

    def __init__(self, filtered: Filtered) -> None:
        self._filtered, self._robot = filtered, filtered.robot

    @cached_property
    def _bodies(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Per actuated body: the joints (k,) that it loads, and their torques (10, k, N)."""
        joints = self._robot.joints
        loaded = []
        for joint in joints:
            carried_by = set(self._robot.model.supports[joint.pin_id])
            loaded.append(np.array([k for k, other in enumerate(joints) if other.pin_id in carried_by]))
        every = self._filtered.of(partial(self._evaluated, loaded))
        counts = np.cumsum([rows.size for rows in loaded])[:-1]
        return list(zip(loaded, np.split(every, counts, axis=1), strict=True))

    def _evaluated(
        self, loaded: Sequence[np.ndarray], q: np.ndarray, v: np.ndarray, a: np.ndarray
    ) -> np.ndarray:
        """(10, sum of k, N) torques of all bodies, one after another."""
        joints, body = self._robot.joints, PinBody(self._robot.model)
        out = np.empty((10, sum(rows.size for rows in loaded), len(q)), np.float32)
        rows_v = np.array([joint.idx_v for joint in joints])
        rows = np.concatenate([rows_v[own] for own in loaded])
        columns = np.concatenate(
            [
                np.tile(10 * (joint.pin_id - 1) + np.arange(10), (own.size, 1))
                for joint, own in zip(joints, loaded, strict=True)
            ]
        )
        for first in range(0, len(q), REGRESSOR_CHUNK):
            part = slice(first, first + REGRESSOR_CHUNK)
            whole = body.regressor_batch(q[part], v[part], a[part])
            out[:, :, part] = whole[:, rows[:, None], columns].transpose(2, 1, 0)
        return out

    def forget(self, limit: float) -> None:
        """Give the memory back, where it is more than so many bytes: it can be evaluated again."""
        if sum(kept.nbytes for _, kept in self.__dict__.get("_bodies", [])) > limit:
            del self.__dict__["_bodies"]

    def torque(self, i: int, added: np.ndarray) -> np.ndarray:
        """(n, N) torques of a change (10,) of the inertial parameters of joint i's link."""
        rows, kept = self._bodies[i]
        out = np.zeros((len(self._robot.joints), kept.shape[2]))
        out[rows] = np.tensordot(added, kept, 1)
        return out

    def torques_on(self, joint: int, i: int, added: np.ndarray) -> np.ndarray | None:
        """(d, N) torques on one joint of changes (d, 10) of the inertial parameters of joint i's link; None
        where it does not carry that."""
        rows, kept = self._bodies[i]
        (at,) = np.nonzero(rows == joint)
        return added @ kept[:, at[0]] if at.size else None


@dataclass(frozen=True)
class Rigid:
    """Rigid-body torques along the filtered motion, and their sensitivities, evaluated when they are first
    asked for; n actuated joints."""

    tau: np.ndarray  # (n, N)
    regressor: Regressor
    inertial: np.ndarray  # (n, 10) nominal parameters of those bodies, known payloads left out
    gravity: np.ndarray  # (3,)
    filtered: Filtered

    @property
    def by_q(self) -> np.ndarray:
        """(N, n, n) d tau / d q. Small changes are multiplied by it: single precision will do."""
        return self._derivatives[0]

    @property
    def by_v(self) -> np.ndarray:
        """(N, n, n) d tau / d q', likewise."""
        return self._derivatives[1]

    @property
    def mass(self) -> np.ndarray:
        """(N, n, n) mass matrices."""
        return self._derivatives[2]

    @cached_property
    def mean_mass(self) -> np.ndarray:
        """(n, n) mean of the mass matrices."""
        return np.asarray(np.mean(self.mass, axis=0))

    @cached_property
    def by_gravity(self) -> np.ndarray:
        """(3, n, N) torque per unit of gravity along each base axis."""
        robot = self.filtered.robot
        rows = [joint.idx_v for joint in robot.joints]
        bodies = [PinBody(robot.model, gravity=axis) for axis in np.eye(3)]

        def torques(q: np.ndarray, v: np.ndarray, _a: np.ndarray) -> np.ndarray:
            still = np.zeros_like(v)
            return np.stack([body.rnea_batch(q, still, still)[:, rows].T for body in bodies])

        return self.filtered.of(torques)

    @cached_property
    def _derivatives(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.derivatives(None)

    def derivatives(self, inertial: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`by_q`, `by_v` and `mass` with other inertial parameters (bodies, 10); None: the nominal ones."""
        robot = self.filtered.robot
        rows = np.array([joint.idx_v for joint in robot.joints])
        body = PinBody(robot.model, inertial=inertial)
        by_q, by_v, mass = body.rnea_derivatives_batch(*self.filtered.motion(1.0))
        pick = np.ix_(np.arange(len(mass)), rows, rows)
        return by_q[pick].astype(np.float32), by_v[pick].astype(np.float32), mass[pick]


@dataclass(frozen=True)
class Motion:
    """Angles (n, N) of links and motors; `missing` lists those that no sensor gives, as (channel, joint)."""

    robot: Robot
    readings: Readings
    filter: Filter
    q: np.ndarray
    theta: np.ndarray
    missing: tuple[tuple[str, int], ...]
    rigid: Rigid
    passive: dict[str, np.ndarray]  # angles (N,) of joints without actuator


def reconstruct(
    robot: Robot,
    readings: Readings,
    recording: Recording,
    deviations: Sequence[Planned] = (),
    start: np.ndarray | None = None,
) -> Motion:
    """The motion; an angle without a sensor comes from the nominal model, or with deviations of its numbers,
    as the point about which the balances are linear. It carries no information of its own (whitening.py).
    Links that only their motors tell of start where they rest, or by `start` (2 k,) elsewhere [rad], and as
    fast [rad/s].

    Raises RecordingError for a floating base, a passive joint that was not measured, or a joint without
    any position.
    """
    if robot.floating:
        raise RecordingError(
            f"{robot.name} has a floating base; a diagnosis needs a fixed one: set base: fixed"
        )
    window = make_filter(readings.time.size, readings.period, readings.sigma)
    q, theta, missing = _angles(robot, readings, recording)
    passive = _passive(robot, readings, recording)
    if missing:
        links = Links.of(robot, deviations)
        _complete(robot, links, readings, window, q, theta, missing, passive, start)
    rigid = along(robot, window, q, passive)
    return Motion(robot, readings, window, q, theta, tuple(missing), rigid, passive)


def _angles(
    robot: Robot, readings: Readings, recording: Recording
) -> tuple[np.ndarray, np.ndarray, list[tuple[str, int]]]:
    q, theta = readings.q.copy(), readings.theta.copy()
    missing: list[tuple[str, int]] = []
    for i, joint in enumerate(robot.joints):
        has_q, has_theta = bool(np.isfinite(q[i, 0])), bool(np.isfinite(theta[i, 0]))
        if not has_q and not has_theta:
            raise RecordingError(
                f"{recording.name}: joint {joint.name} has neither q nor theta; measure one or lock it in the"
                " robot YAML"
            )
        if not has_theta:
            missing.append(("theta", i))
            theta[i] = q[i]
        elif not has_q:
            missing.append(("q", i))
            q[i] = theta[i]
    return q, theta, missing


def _passive(robot: Robot, readings: Readings, recording: Recording) -> dict[str, np.ndarray]:
    """Joints that swing freely must be measured: their motion loads the others."""
    out = {}
    for name in list(robot.model.names)[1:]:
        if name in robot.joint_names:
            continue
        if not recording.has("q", name):
            raise RecordingError(
                f"{recording.name}: joint {name} is passive and not measured; add q.{name} or list it"
                " under lock or joints in the robot YAML"
            )
        values = recording.get("q", name)
        present = np.isfinite(values)
        out[name] = np.interp(readings.time, recording.time[present], values[present])
    return out


@dataclass(frozen=True)
class Links:
    """The numbers with which angles are made: actuators by joint, and inertial parameters (bodies, 10)."""

    drives: tuple[Drive, ...]
    inertial: np.ndarray

    @staticmethod
    def of(robot: Robot, deviations: Sequence[Planned]) -> Links:
        drives, inertial = [joint.drive for joint in robot.joints], inertial_of(robot.model)
        for e in deviations:
            if e.joint is None:
                continue
            i = robot.joint_names.index(e.joint)
            drives[i] = e.effect.edit_drive(drives[i], e.p)
            if e.effect.overrides("edit_inertial"):
                body = robot.joints[i].pin_id - 1
                inertial[body] = e.effect.edit_inertial(list(inertial[body]), e.p)
        return Links(tuple(drives), inertial)


def _complete(
    robot: Robot,
    links: Links,
    readings: Readings,
    window: Filter,
    q: np.ndarray,
    theta: np.ndarray,
    missing: Sequence[tuple[str, int]],
    passive: dict[str, np.ndarray],
    start: np.ndarray | None,
) -> None:
    """Fill in phi of joints with one encoder, in place: from tau_t where measured, (D s + K) phi = tau_t;
    without a motor encoder from the link, (D s + K) phi = RNEA(q); without a link encoder from the link's
    dynamics driven by the motor."""
    s = 1j * window.omega
    direct = [(c, i) for c, i in missing if np.isfinite(readings.tau_t[i, 0])]
    driven = [i for c, i in missing if c == "q" and (c, i) not in direct]
    from_link = [i for c, i in missing if c == "theta" and (c, i) not in direct]
    for channel, i in direct:
        drive = links.drives[i]
        phi = _back(window, window.spectrum(readings.tau_t[i]) / (drive.K + drive.D * s))
        if channel == "q":
            q[i] = theta[i] - phi
        else:
            theta[i] = q[i] + phi
    if driven:
        moved = np.zeros(2 * len(driven)) if start is None else start
        _driven_links(robot, links, window, q, theta, driven, passive, moved)
    if from_link:
        tau = along(robot, window, q, passive).tau
        for i in from_link:
            drive = links.drives[i]
            theta[i] = q[i] + _back(window, window.spectrum(tau[i]) / (drive.K + drive.D * s))


def _driven_links(
    robot: Robot,
    links: Links,
    window: Filter,
    q: np.ndarray,
    theta: np.ndarray,
    joints: list[int],
    passive: dict[str, np.ndarray],
    start: np.ndarray,
) -> None:
    """Links without encoder, driven by their measured motors through the nominal spring, in place: linearly
    implicit midpoint steps on M q'' + nle = K (theta - q) + D (theta' - q'), the other links as measured.
    Motors move by cubic polynomials between samples."""
    body = PinBody(robot.model, inertial=links.inertial)
    drives = [links.drives[i] for i in joints]
    stiff, damp = np.array([d.K for d in drives]), np.array([d.D for d in drives])
    at, v, a = whole_motion(robot, window, q, passive, 0.25)
    h = window.period / DRIVEN_SUBSTEPS
    angle, turning = (window.smooth_share(theta[joints], DRIVEN_SHARE, order) for order in (0, 1))
    columns_q, columns_v = (
        _columns([getattr(robot.joints[i], k) for i in joints]) for k in ("idx_q", "idx_v")
    )
    rows = columns_v if isinstance(columns_v, slice) else columns_v[:, None]
    place = theta[joints, 0].copy()
    for _ in range(5):  # start from where the spring carries the load at rest
        at[0, columns_q] = place
        place = theta[joints, 0] - body.gravity_torque(at[0])[columns_v] / stiff
    elsewhere, speed = np.split(start, 2)
    place = place + elsewhere
    give = 0.5 * h * stiff + damp
    added = np.diag(0.5 * h * give)
    # ten thousand steps of a few numbers each: what a step need not do shows
    parts = [(sub + 0.5) / DRIVEN_SUBSTEPS for sub in range(DRIVEN_SUBSTEPS)]
    turned = np.stack([_between(angle, turning, window.period, part).T for part in parts], axis=1)
    rates = [turning + part * (_next(turning) - turning) for part in parts]
    dragged = np.stack([damp * rate.T for rate in rates], axis=1)  # (N, substeps, joints), as `turned`
    a[:, columns_v] = 0.0
    turn = np.zeros(len(joints))
    for k, (here_q, here_v, here_a) in enumerate(zip(at, v, a, strict=True)):
        q[joints, k] = place
        for there, drag in zip(turned[k], dragged[k], strict=True):
            here_q[columns_q] = place + 0.5 * h * speed
            here_v[columns_v] = speed + 0.5 * h * turn  # by the last step's acceleration
            bias = body.rnea(here_q, here_v, here_a)[columns_v]
            mass = body.mass_matrix(here_q)[rows, columns_v]
            pull = stiff * (there - place) + drag - give * speed - bias
            turn = lapack.dgesv(mass + added, pull)[2]
            place, speed = place + h * (speed + 0.5 * h * turn), speed + h * turn


def _next(x: np.ndarray) -> np.ndarray:
    """(..., N) each sample's next one; the last stays."""
    return np.concatenate([x[..., 1:], x[..., -1:]], axis=-1)


def _between(x: np.ndarray, v: np.ndarray, period: float, part: float) -> np.ndarray:
    """(..., N) a signal at a part of the period after each sample, by cubic polynomials that have its values
    and rates at the samples (Hermite)."""
    rest = 1.0 - part
    ends = (1.0 + 2.0 * part) * rest**2 * x + (1.0 + 2.0 * rest) * part**2 * _next(x)
    return np.asarray(ends + period * part * rest * (rest * v - part * _next(v)))


def _columns(indices: list[int]) -> slice | np.ndarray:
    """The indices of an array's entries; as a slice where they are successive, which is quicker to take."""
    first, last = indices[0], indices[-1]
    return slice(first, last + 1) if indices == list(range(first, last + 1)) else np.array(indices)


def whole_motion(
    robot: Robot, window: Filter, q: np.ndarray, passive: dict[str, np.ndarray], share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q (N, nq), v and a (N, nv) of the whole model, filtered with a share of the window's variance."""
    model, count = robot.model, window.count
    start = PinBody(model).neutral
    signals = (np.tile(start, (count, 1)), np.zeros((count, model.nv)), np.zeros((count, model.nv)))
    for order, signal in enumerate(signals):
        for i, joint in enumerate(robot.joints):
            signal[:, joint.idx_q if order == 0 else joint.idx_v] = window.smooth_share(q[i], share, order)
        for name, x in passive.items():
            pin_joint = model.joints[model.getJointId(name)]
            column = pin_joint.idx_q if order == 0 else pin_joint.idx_v
            signal[:, column] = window.smooth_share(x, share, order)
    return signals


def along(
    robot: Robot,
    window: Filter,
    q: np.ndarray,
    passive: dict[str, np.ndarray],
) -> Rigid:
    """Rigid-body torques and sensitivities along link angles q (n, N)."""
    body = PinBody(robot.model)
    rows = [joint.idx_v for joint in robot.joints]
    filtered = Filtered(robot, window, q, passive)

    def torques(at: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(body.rnea_batch(at, v, a)[:, rows].T)

    own = body.inertial if robot.own_inertial is None else robot.own_inertial
    inertial = own[[joint.pin_id - 1 for joint in robot.joints]]
    return Rigid(filtered.of(torques), Regressor(filtered), inertial, robot.gravity, filtered)


def mass_along(motion: Motion, inertial: np.ndarray, every: int) -> np.ndarray:
    """(N / every, n, n) mass matrices along the filtered motion, of every so many samples, with other
    inertial parameters (bodies, 10)."""
    robot = motion.robot
    at, _, _ = whole_motion(robot, motion.filter, motion.q, motion.passive, 1.0)
    body = PinBody(robot.model, inertial=inertial)
    pick = np.ix_(*2 * [[joint.idx_v for joint in robot.joints]])
    return np.array([body.mass_matrix(row)[pick] for row in at[::every]])


def _back(window: Filter, spectrum: np.ndarray) -> np.ndarray:
    return fft.irfft(spectrum, window.size, axis=-1)[..., : window.count]
