"""An exported MJCF, run in MuJoCo under the motor torques of a simulation of ours."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import MissingExtraError, ModelError, SimulationError
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.robot.numbers import floats
from flexjoint.robot.reading.mjcf_drives import CREEP, ROTOR
from flexjoint.simulation.loop import check_torque
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.trajectory import Past, Trajectory


def available() -> bool:
    """Whether MuJoCo is installed."""
    return importlib.util.find_spec("mujoco") is not None


class MujocoRun:
    """An exported robot in MuJoCo.

    Args:
        text: the MJCF.
        model: the model that was exported; its rate f_s is how often torques change and states are kept.

    Raises MissingExtraError without MuJoCo, ModelError for a robot with joints of more than one axis beside a
    floating base, and for a file that MuJoCo refuses.
    """

    def __init__(self, text: str, model: FlexibleJointModel) -> None:
        if not available():
            raise MissingExtraError("mujoco", "mujoco")
        self._mujoco: Any = importlib.import_module("mujoco")
        self.model, self.body = model, model.robot.model
        self._free = floats(self.body)
        if model.nq - model.nv != int(self._free):
            raise ModelError(
                f"{model.robot.name}: MuJoCo is run with a floating base and single-axis joints only; lock"
                " the others"
            )
        try:
            self.engine = self._mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            said = " ".join(str(error).split())
            version = self._mujoco.__version__
            raise ModelError(f"MuJoCo {version} does not take the exported file: {said}") from None
        # our simulation takes recorded torques as they are, and has no stops but those of the effects
        self.engine.jnt_limited[:] = 0
        self.engine.opt.disableflags |= self._mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        self.data = self._mujoco.MjData(self.engine)
        self._rotors = [self._place(f"{ROTOR}{model.joints[i].name}") for i in model.flexible]
        self._creep = [self._creeping(i) for i in model.flexible]

    def _place(self, joint: str) -> tuple[int, int]:
        """Where a joint stands in MuJoCo's positions and velocities."""
        k = self.engine.joint(joint).id
        return int(self.engine.jnt_qposadr[k]), int(self.engine.jnt_dofadr[k])

    def _creeping(self, i: int) -> tuple[int, int] | None:
        """The hinge of a creeping spring, and its place in the model's z."""
        name = self.model.joints[i].name
        found = [e for e in self.model.effects if e.key == ("spring_creep", name) and e.since is None]
        if not found or found[0].p.stiffness <= 0.0:
            return None
        return self._place(f"{CREEP}{name}")[0], self.model.slot("spring_creep", name)

    # --- states ---------------------------------------------------------------------------------------------
    def set(self, state: State) -> None:
        """Bring MuJoCo to a state: positions, velocities, what the command's lag and Dahl's friction hold."""
        self._mujoco.mj_resetData(self.engine, self.data)
        q, v = self.data.qpos, self.data.qvel
        q[: self.model.nq], v[: self.model.nv] = state.q, state.v
        if self._free:
            q[3:7] = np.roll(state.q[3:7], 1)
            v[:3] = pin.Quaternion(np.asarray(state.q[3:7])).toRotationMatrix() @ state.v[:3]
        for k, (place, dof) in enumerate(self._rotors):
            q[place], v[dof] = state.theta[k], state.dtheta[k]
            creep = self._creep[k]
            if creep is not None:  # z is what stretches the spring in front of the damper
                phi = state.theta[k] - state.q[self.model.joints[self.model.flexible[k]].idx_q]
                q[creep[0]] = phi - state.z[creep[1]]
        for effect in ("dahl_friction", "spring_hysteresis"):
            for joint in self.model.joints:
                loop = next((e.p for e in self.model.effects if e.key == (effect, joint.name)), None)
                if loop is None or loop.level <= 0.0:
                    continue
                z = state.z[self.model.slot(effect, joint.name)]
                self.data.act[self._act(f"{effect}.{joint.name}")] = z * loop.scale / loop.level

    def _act(self, actuator: str) -> int:
        return int(self.engine.actuator_actadr[self.engine.actuator(actuator).id])

    def _lags(self, state: State) -> None:
        """The states of the command's lags at the start: what is in the model's z."""
        for planned in self.model.effects:
            name = str(planned.joint)
            if planned.effect.name == "current_lag" and planned.p.time_constant > 0.0:
                self.data.act[self._act(name)] = state.z[self.model.slot("current_lag", name)]

    def state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """q (nq,), v (nv,), theta and dtheta (nf,) in the model's order."""
        q, v = self.data.qpos[: self.model.nq].copy(), self.data.qvel[: self.model.nv].copy()
        if self._free:
            q[3:7] = np.roll(q[3:7], -1)
            v[:3] = pin.Quaternion(q[3:7]).toRotationMatrix().T @ v[:3]
        theta = np.array([self.data.qpos[place] for place, _ in self._rotors])
        dtheta = np.array([self.data.qvel[dof] for _, dof in self._rotors])
        return q, v, theta, dtheta

    # --- runs -----------------------------------------------------------------------------------------------
    def rollout(
        self,
        model: FlexibleJointModel,
        start: State,
        torque: np.ndarray,
        options: RunOptions = DEFAULTS,
        *,
        past: Past | None = None,
        runs: int = 1,
    ) -> Trajectory:
        """As `flexjoint.simulation.rollout.rollout`, in MuJoCo. Internal states of effects are not kept: z of
        the trajectory stays that of the start, and tau_rigid is 0.

        Raises SimulationError where MuJoCo's step does not divide that of the torques, or it diverges.
        """
        torque = check_torque(model, torque)
        h = 1.0 / options.rate_for(model.robot)
        stride = max(1, round(h / self.engine.opt.timestep))
        if abs(stride * self.engine.opt.timestep - h) > 1e-9 * h:
            raise SimulationError(
                f"MuJoCo's step of {self.engine.opt.timestep:.4g} s does not divide that of the torques,"
                f" {h:.4g} s"
            )
        first = 0 if past is None else len(past.tau_m)
        rows = first + len(torque) + 1
        tape = Trajectory(
            time=start.t + h * (np.arange(rows) - first),
            q=np.empty((rows, model.nq)),
            v=np.empty((rows, model.nv)),
            theta=np.empty((rows, model.nf)),
            dtheta=np.empty((rows, model.nf)),
            z=np.tile(np.asarray(start.z), (rows, 1)),
            tau_rigid=np.zeros((rows, len(model.rigid))),
            tau_m=np.concatenate([*([] if past is None else [past.tau_m]), torque, torque[-1:]]),
            first=first,
        )
        if past is not None:
            for name in ("q", "v", "theta", "dtheta"):
                getattr(tape, name)[:first] = getattr(past, name)
        self.set(start)
        self._lags(start)
        self._history(torque[:1] if past is None else past.tau_m, stride)
        controls = [self.engine.actuator(name).id for name in model.robot.joint_names]
        places = np.array([self._control(k) for k in controls])
        self._keep(tape, first)
        for k, tau in enumerate(torque):
            self.data.ctrl[places] = tau
            self._mujoco.mj_step(self.engine, self.data, stride)
            self._keep(tape, first + k + 1)
        if not np.isfinite(tape.v).all() or int(self.data.warning[self._bad()].number):
            raise SimulationError(
                "MuJoCo's simulation left the finite numbers; give the file a shorter timestep"
            )
        return tape

    def _bad(self) -> int:
        return int(self._mujoco.mjtWarning.mjWARN_BADQACC)

    def _control(self, actuator: int) -> int:
        """Where an actuator's command stands in ctrl; passive motors have none."""
        places = getattr(self.engine, "actuator_ctrladr", None)
        return actuator if places is None else int(places[actuator])

    def _keep(self, tape: Trajectory, row: int) -> None:
        tape.q[row], tape.v[row], tape.theta[row], tape.dtheta[row] = self.state()

    def _history(self, before: np.ndarray, stride: int) -> None:
        """What delayed actuators look up: the torques before the start, oldest first; the first one holds."""
        delays = getattr(self.engine, "actuator_delay", None)
        if delays is None:
            return
        step = self.engine.opt.timestep
        for i, name in enumerate(self.model.robot.joint_names):
            k = self.engine.actuator(name).id
            if delays[k] <= 0.0:
                continue
            samples = int(self.engine.actuator_history[k, 0])
            back = np.arange(samples, 0, -1)
            rows = np.maximum(len(before) - -(-back // stride), 0)
            self._mujoco.mj_initCtrlHistory(
                self.engine, self.data, k, -step * back.astype(float), np.ascontiguousarray(before[rows, i])
            )
