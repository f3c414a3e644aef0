"""States along a recording: where the windows of a comparison start.

One estimator for every model: positions by local polynomials through the samples of position and velocity,
corrected by the model's own sensor effects. A side without an encoder follows from the torque sensor, or
from the links' dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import RecordingError, SimulationError
from flexjoint.core.ops import Value
from flexjoint.effects import Signals, Site
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.joint import neighbours
from flexjoint.model.statics.equilibrium import deflection, equilibrium
from flexjoint.recording.smooth import local_polynomial, noise
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Joint
from flexjoint.simulation.schemes import make_step
from flexjoint.simulation.sensors import spans
from flexjoint.simulation.simulate import command_rate, torque_channel, torque_over

WIDTH = 4e-3  # [s] kernel of the smoothing, or
PERIODS = 1.5  # sampling periods, whichever is longer
INFERRED = 2.5  # times as wide a kernel where noise of a torque or an acceleration is what is smoothed
OFFSET_SPAN = 0.5  # [s] of a recording on which its encoder offsets are estimated (formats)
HEAVY = 1e7  # a motor this many times as heavy follows its measured motion whatever pulls at it
REST_ROUNDS = 30  # rounds of a fixed point that contracts by (dg/dq)/K, at most some tenths
DERIVATIVE = {"q": "dq", "theta": "dtheta"}

Samples = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Motion:
    """States at M times: q (M, nq), v (M, nv), theta, dtheta (M, nf), z (M, nz); see `State`."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    theta: np.ndarray
    dtheta: np.ndarray
    z: np.ndarray


class StateEstimator:
    """States of a model along a recording; times on the recording's clock.

    `offsets` holds the encoder offset [rad] of each joint's theta against q where the robot says that they
    differ from recording to recording, else nothing.

    Args:
        begin: where the time of laws and onsets begins [s], on the recording's clock; default: its first
            sample. A part of a recording has the beginning of the whole.
        offsets: those of the whole recording, of which this is a part; default: estimated.

    Raises RecordingError when a joint has neither q nor theta, SimulationError for a floating base.
    """

    def __init__(
        self,
        recording: Recording,
        model: FlexibleJointModel,
        *,
        begin: float | None = None,
        offsets: Mapping[str, float] | None = None,
    ) -> None:
        if model.robot.floating:
            raise SimulationError(
                "states of a floating base cannot be estimated: no channel measures the base"
            )
        self.recording, self.model = recording, model
        self.begin = float(recording.time[0]) if begin is None else begin
        self.width = max(WIDTH, PERIODS * recording.period)
        self._samples: dict[tuple[str, str], Samples] = {}
        self._inferred: set[tuple[str, str]] = set()  # positions that no encoder measured
        for joint in model.joints:
            for channel in ("q", "dq", "theta", "dtheta", "tau_t"):
                if recording.has(channel, joint.name):
                    self._samples[channel, joint.name] = self._true_samples(channel, joint.name)
        self._passive = self._passive_joints()
        self._complete()
        self.offsets: Mapping[str, float] = self._offsets() if offsets is None else offsets
        for name, offset in self.offsets.items():
            time, theta = self._samples["theta", name]
            self._samples["theta", name] = time, theta - offset
        self._z = self._internal_states() if model.nz else np.zeros((len(recording.time), 0))

    # --- states ------------------------------------------------------------------------------------
    def at(self, time: np.ndarray) -> Motion:
        """The states at times (M,) on the recording's clock."""
        model = self.model
        q, v = np.tile(model.body.neutral, (len(time), 1)), np.zeros((len(time), model.nv))
        theta, dtheta = np.zeros((2, len(time), model.nf))
        for name, idx_q, idx_v in self._passive:
            q[:, idx_q], v[:, idx_v], _ = self._smooth("q", name, time)
        for i, joint in enumerate(model.joints):
            q[:, joint.idx_q], v[:, joint.idx_v], _ = self._smooth("q", joint.name, time)
            if not joint.rigid:
                k = model.flexible.index(i)
                theta[:, k], dtheta[:, k], _ = self._smooth("theta", joint.name, time)
        z = np.empty((len(time), model.nz))
        for k in range(model.nz):
            z[:, k] = np.interp(time, self.recording.time, self._z[:, k])
        return Motion(np.asarray(time), q, v, theta, dtheta, z)

    def state(self, motion: Motion, row: int) -> State:
        """One of the states, as a simulation starts from it."""
        x = self.model.rest(motion.q[row].copy(), float(motion.time[row] - self.begin))
        x.v, x.theta, x.dtheta = motion.v[row].copy(), motion.theta[row].copy(), motion.dtheta[row].copy()
        x.z = motion.z[row].copy()
        return x

    def _smooth(
        self, channel: str, joint: str, at: np.ndarray, widen: float = 1.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time, values = self._samples[channel, joint]
        rates = self._samples.get((DERIVATIVE[channel], joint))
        width = self.width * (INFERRED if (channel, joint) in self._inferred else widen)
        if rates is None:
            return local_polynomial(time, values, at, width)
        sd, rate_sd = noise(values), noise(rates[1])
        if sd == 0.0 or rate_sd == 0.0:  # without noise either will do; a length keeps them in proportion
            sd, rate_sd = width, 1.0
        return local_polynomial(time, values, at, width, *rates, (sd / rate_sd) ** 2)

    # --- samples -----------------------------------------------------------------------------------
    def _true_samples(self, channel: str, joint: str) -> Samples:
        """The samples that are there, corrected by the model's sensor effects, at the times they are of."""
        time, values = self.recording.time.copy(), self.recording.get(channel, joint).copy()
        i = self.model.robot.joint_names.index(joint)
        t = time - self.begin
        for phase, rows in spans(self.model, t):
            flow = phase.flows[i]
            values[rows] = flow.corrected(channel, Signals(t=t[rows]), values[rows])
            time[rows] -= flow.reading_delay(channel)
        known = np.isfinite(values)
        forward = np.concatenate([[True], np.diff(np.maximum.accumulate(time)) > 0.0])  # at an onset
        return time[known & forward], values[known & forward]

    def _passive_joints(self) -> list[tuple[str, int, int]]:
        """(name, idx_q, idx_v) of joints that swing freely; their motion must be measured."""
        model, found = self.model.robot.model, []
        for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
            if name in self.model.robot.joint_names:
                continue
            if not self.recording.has("q", name) or joint.nq != 1:
                raise RecordingError(
                    f"{self.recording.name}: no q for the passive joint {name}; measure it or lock it in the"
                    " robot file"
                )
            known = np.isfinite(self.recording.get("q", name))
            self._samples["q", name] = self.recording.time[known], self.recording.get("q", name)[known]
            found.append((name, joint.idx_q, joint.idx_v))
        return found

    def _complete(self) -> None:
        """Samples of q and theta for the joints that lack either."""
        blind = []
        for i, joint in enumerate(self.model.joints):
            has_q, has_theta = (("q", joint.name) in self._samples), (("theta", joint.name) in self._samples)
            if not has_q and not has_theta:
                raise RecordingError(
                    f"{self.recording.name}: joint {joint.name} has neither q nor theta; record one or lock"
                    " the joint in the robot file"
                )
            if has_q and has_theta:
                continue
            if joint.rigid:
                for one, other in (("q", "theta"), ("theta", "q"), ("dq", "dtheta"), ("dtheta", "dq")):
                    if (one, joint.name) in self._samples:
                        self._samples.setdefault((other, joint.name), self._samples[one, joint.name])
            elif ("tau_t", joint.name) in self._samples:
                time, load = self._samples["tau_t", joint.name]
                self._other_side(i, time, load)
            elif has_q:
                blind.append(i)
        lacking = [joint.name for joint in self.model.joints if ("q", joint.name) not in self._samples]
        if lacking:
            self._follow_motors(lacking)
        if blind:
            time = self.recording.time
            load = self._link_load(time)
            for i in blind:
                self._other_side(i, time, load[:, i])

    def _other_side(self, i: int, time: np.ndarray, load: np.ndarray) -> None:
        """theta from q or q from theta, phi from the transmission torque: (load - D dphi)/K."""
        joint = self.model.joints[i]
        there, lacking, side = ("q", "theta", 1.0)
        if ("q", joint.name) not in self._samples:
            there, lacking, side = ("theta", "q", -1.0)
        position, _, _ = self._smooth(there, joint.name, time)
        phi = np.empty(len(time))
        for phase, rows in spans(self.model, time - self.begin):
            phi[rows] = self._held_deflection(phase, i, time[rows], position[rows], load[rows])
        self._samples[lacking, joint.name] = time, position + side * phi
        self._inferred.add((lacking, joint.name))

    def _held_deflection(
        self, phase: FlexibleJointModel, i: int, time: np.ndarray, q: np.ndarray, load: np.ndarray
    ) -> np.ndarray:
        flow = phase.flows[i]
        if len(time) < 2:
            return load / flow.drive.K
        smooth, load_rate, _ = local_polynomial(time, load, time, INFERRED * self.width)
        return deflection(flow, q, smooth - flow.drive.D * load_rate / flow.drive.K)

    def _link_load(self, time: np.ndarray) -> np.ndarray:
        """(M, n) torque that the links take at the actuated joints: inverse dynamics less link effects."""
        model = self.model
        q, v, a = np.tile(model.body.neutral, (len(time), 1)), *np.zeros((2, len(time), model.nv))
        places = [(joint.name, joint.idx_q, joint.idx_v) for joint in model.joints] + self._passive
        for name, idx_q, idx_v in places:
            q[:, idx_q], v[:, idx_v], a[:, idx_v] = self._smooth("q", name, time, INFERRED)
        load = np.empty((len(time), len(model.joints)))
        for phase, rows in spans(model, time - self.begin):
            full = phase.body.rnea_batch(q[rows], v[rows], a[rows])
            for i, flow in enumerate(phase.flows):
                x, dx = q[rows, flow.joint.idx_q], v[rows, flow.joint.idx_v]
                s = Signals(time[rows] - self.begin, x, dx, x, dx)
                _, on_link = flow.torques(s, np.zeros((model.nz, 1)))
                load[rows, i] = full[:, flow.joint.idx_v] - on_link
        return load

    def _follow_motors(self, lacking: list[str]) -> None:
        """q of joints without link encoder: the links swing on springs whose motor side moves as measured.

        The motors are made too heavy to be moved and set to their measured motion at every step; nothing
        on the motors' side (friction, command) enters. Joints with a link encoder are set to it as well;
        springs with internal states count as relaxed.
        """
        model = self.model
        heavy = tuple(replace(j, drive=replace(j.drive, B=HEAVY * j.drive.B)) for j in model.joints)
        kept = [e for e in model.effects if e.effect.site not in (Site.COMMAND, Site.MOTOR, Site.SENSOR)]
        kept = [e for e in kept if not e.effect.states]
        driven = FlexibleJointModel(replace(model.robot, joints=heavy, couplings=()), kept)
        rate = model.robot.rates.physics
        begin, end = self.recording.time[[0, -1]]
        time = begin + np.arange(int((end - begin) * rate) + 1) / rate
        places = [joint.idx_q for joint in model.joints], [joint.idx_v for joint in model.joints]
        measured = [i for i, joint in enumerate(model.joints) if joint.name not in lacking]
        link, motor = np.zeros((2, len(time), len(model.joints), 3))  # position, velocity, acceleration
        for i, joint in enumerate(model.joints):
            channel = "theta" if ("theta", joint.name) in self._samples else "q"
            motor[:, i] = np.stack(self._smooth(channel, joint.name, time), axis=1)
            if i in measured:
                link[:, i] = np.stack(self._smooth("q", joint.name, time), axis=1)
        flexible = list(model.flexible)
        force = HEAVY * np.array([joint.drive.B for joint in model.joints])
        q, v = np.empty((len(time), model.nq)), np.empty((len(time), model.nv))
        x = driven.rest(self._rest_positions(driven, motor[0, :, 0]))
        for phase, rows in spans(driven, time - self.begin):
            step = make_step(phase, 1.0 / rate)
            for k in range(rows.start, rows.stop):
                x.theta, x.dtheta, x.ddtheta = motor[k, flexible].T
                for i in measured:
                    x.q[places[0][i]], x.v[places[1][i]] = link[k, i, :2]
                q[k], v[k] = x.q, x.v
                x = step(x, force * motor[k, :, 2])
        for name in lacking:
            joint = model.robot.joint(name)
            self._samples["q", name] = time, q[:, joint.idx_q]
            self._samples["dq", name] = time, v[:, joint.idx_v]

    def _rest_positions(self, model: FlexibleJointModel, theta: np.ndarray) -> np.ndarray:
        """(nq,) link positions at rest with the motors at theta (n,): q = theta - phi(g(q))."""
        q = model.body.neutral.copy()
        places = [joint.idx_q for joint in model.joints]
        q[places] = theta
        for _ in range(REST_ROUNDS):
            q[places] = theta - (equilibrium(model, q).theta[0] - q[places])
        return q

    # --- nuisance and internal states ------------------------------------------------------------------
    def _offsets(self) -> dict[str, float]:
        """Encoder offsets of this recording: theta - q in its first 0.5 s less the deflection that carries
        the measured tau_t, or else the links."""
        if self.model.robot.file.offsets != "per_recording":
            return {}
        begin = self.recording.time[0]
        time = self.recording.time[self.recording.time <= begin + OFFSET_SPAN]
        if len(time) < 2:
            return {}
        load = self._link_load(time)
        offsets = {}
        for i, joint in enumerate(self.model.joints):
            measured = self.recording.has("q", joint.name) and self.recording.has("theta", joint.name)
            if joint.rigid or not measured:
                continue
            q, theta = (self._smooth(channel, joint.name, time)[0] for channel in ("q", "theta"))
            carried = load[:, i]
            if ("tau_t", joint.name) in self._samples:
                carried = np.interp(time, *self._samples["tau_t", joint.name])
            phi = self._held_deflection(self.model.phases[0][1], i, time, q, carried)
            offsets[joint.name] = float(np.mean(theta - q - phi))
        return offsets

    def _internal_states(self) -> np.ndarray:
        """(N, nz) internal states of effects along the recording's samples, driven by the smoothed motion."""
        model, time = self.model, self.recording.time
        out = np.tile(model.rest().z, (len(time), 1))
        torque = self._torques()
        for i, joint in enumerate(model.joints):
            if not model.flows[i].stateful:
                continue
            moved, at_motor = self._moved(joint, time), self._motor_of(i, time, torque)
            command, *beside = torque[i], *neighbours(torque, i)
            q, _, theta, _ = moved if at_motor is None else at_motor[:4]
            first = command[0] if at_motor is None else at_motor[4][0]
            for slot, value in model.flows[i].steady_state(Signals(q=q[0], theta=theta[0]), first):
                out[0, slot] = value
            since = time - self.begin
            table = _rows(since, moved, command, beside)
            turning = None if at_motor is None else _rows(since, at_motor[:4], at_motor[4], beside)
            z = out[0].tolist()
            for phase, rows in spans(model, time - self.begin):
                flow = phase.flows[i]
                for k in range(max(rows.start, 1), rows.stop):
                    s, shaft = _at(table[k - 1]), None if turning is None else _at(turning[k - 1])
                    for slot, value in flow.advanced(s, z, table[k][0] - s.t, shaft):
                        z[slot] = value
                        out[k, slot] = value
        return out

    def _moved(self, joint: Joint, time: np.ndarray) -> list[np.ndarray]:
        """q, dq, theta and dtheta (N,) of a joint."""
        q, dq, _ = self._smooth("q", joint.name, time)
        theta, dtheta, _ = (q, dq, None) if joint.rigid else self._smooth("theta", joint.name, time)
        return [q, dq, theta, dtheta]

    def _motor_of(self, i: int, time: np.ndarray, torque: np.ndarray) -> list[np.ndarray] | None:
        """The same of a motor that turns with several joints, and its command; None where it is its
        joint's."""
        for group in self.model.groups:
            for shaft in group.shafts:
                if shaft.joint == i and shaft.takes:
                    moved = {j: self._moved(self.model.joints[j], time) for j in shaft.turns}
                    turned = [shaft.turned({j: x[k] for j, x in moved.items()}) for k in range(4)]
                    return [*turned, shaft.torque({j: torque[j] for j in shaft.takes})]
        return None

    def _torques(self) -> np.ndarray:
        """(n, N) motor torques from each sample to the next, those of the springs where none are recorded: an
        estimate, for what follows a command within milliseconds."""
        recording, names, time = self.recording, self.model.robot.joint_names, self.recording.time
        if torque_channel(recording, names) is not None:
            edges = np.append(time, time[-1] + recording.period)
            return torque_over(recording, names, edges, command_rate(self.model.robot, recording)).T
        out = np.zeros((len(names), len(time)))
        for i in self.model.flexible:
            q, theta = (self._smooth(channel, names[i], time)[0] for channel in ("q", "theta"))
            out[i] = self.model.flows[i].drive.K * (theta - q)
        return out


def _rows(
    t: np.ndarray, moved: Sequence[np.ndarray], command: np.ndarray, beside: Sequence[Value]
) -> list[list[float]]:
    """Time, q, dq, theta, dtheta, command and the neighbours' commands, by sample."""
    rows: list[list[float]] = np.stack(np.broadcast_arrays(t, *moved, command, *beside), axis=1).tolist()
    return rows


def _at(row: Sequence[float]) -> Signals:
    t, q, dq, theta, dtheta, *torques = row
    return Signals(t, q, dq, theta, dtheta, theta - q, dtheta - dq, 0.0, *torques)
