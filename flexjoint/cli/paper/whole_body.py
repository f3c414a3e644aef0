"""Section 5.2 of Kameduła et al. 2016: CENTAURO goes from its initial pose to a spider's and a mammal's.

The paper gives no reference trajectories. Here the feet stay on the ground and roll: the wheels turn into the
direction in which their foot will move, the legs move while the wheels roll with them, and the wheels sway
about the pose's heading, ever less, which relaxes the forces between the feet. Joint positions are quintic
blends between the poses of the robot file, so velocities and accelerations begin and end at 0, the shanks
stay vertical, and the base goes up or down and nowhere else. Wheels roll freely, their motors' damping fed
forward. The motor PD brakes them in the initial pose, and in the mammal pose after the swaying unless
g - J_c' lambda is fed forward: on free wheels the robot tips over there. All other joints have the motor PD
of the robot file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline

from flexjoint.core.errors import unknown
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.standing import standing
from flexjoint.robot.robot import load
from flexjoint.simulation.compiled.compiler import compilers
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.trajectory import Trajectory

POSES = ("initial", "spider", "mammal")
PHYSICS, CONTROL = 2000, 1000  # Hz, f_s and f_c of the section
WAIT, STEER, MOVE, HOLD = 1.0, 1.5, 4.0, 9.0  # [s]
KNOT = 0.05  # [s] between the poses whose loads are computed; between them by cubic splines
NUDGE = 1e-4  # of the way between two poses, for the direction in which a foot goes
Gravity = Literal["none", "gravity", "contact"]
GRAVITY: Mapping[str, str] = {"none": "none", "gravity": "g", "contact": "g - J'l"}  # l: lambda
MOTOR: Mapping[str, str] = {"link": "q_d", "load": "q_d+g/K"}
SHOWN: Mapping[str, str] = {  # Fig. 8 and 9; the shoulder is its pitch
    "shoulder": "j_arm1_1",
    "elbow": "j_arm1_4",
    "hip yaw": "hip_yaw_1",
    "hip pitch": "hip_pitch_1",
}


@dataclass(frozen=True)
class Sway:
    """How the wheels sway in a pose: for so many seconds, so many times to and fro, by an angle [rad] of
    which (1 - s)^2 is left after a share s of the time."""

    seconds: float
    swings: float
    angle: float


# in the mammal pose not for long: on free wheels the robot tips over some eight seconds after its move
SWAYS: Mapping[str, Sway] = {"spider": Sway(15.0, 5.0, 1.2), "mammal": Sway(3.0, 3.0, 0.6)}
LEG = STEER + MOVE + max(sway.seconds for sway in SWAYS.values()) + HOLD  # [s] from one pose to the next
SECONDS = WAIT + 2 * LEG


@dataclass(frozen=True)
class Plan:
    """Of T control ticks: time (T,) [s]; q, dq (T, n) of the joints; gravity and load (T, n), g(q_d) and
    g(q_d) - J_c' lambda [N m]; rolling (T, n): the torque that the wheels' motor damping takes [N m]."""

    time: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    gravity: np.ndarray
    load: np.ndarray
    rolling: np.ndarray


@dataclass(frozen=True)
class Hold:
    """The last second of a pose's hold, means over it, all (n,). error: link position less reference [rad];
    law: the same as the static law has it, (theta_d - q_d) - (tau_t - tau_ff)/Kp - tau_t/K; both NaN of
    wheels. tau_t: transmission torque [N m]. drift: how far any other joint moved in that second [rad].
    weight: what the contacts carry over the robot's weight."""

    pose: str
    error: np.ndarray
    law: np.ndarray
    tau_t: np.ndarray
    drift: float
    weight: float


@dataclass(frozen=True)
class Run:
    """One variant: its trajectory at f_s, and what its holds say, spider and mammal."""

    gravity: str
    motor: str
    trajectory: Trajectory
    holds: tuple[Hold, ...]


@cache
def robot_model() -> FlexibleJointModel:
    """CENTAURO on its wheels, which are velocity controlled."""
    robot = load("centauro")
    return FlexibleJointModel(replace(robot, rates=robot.rates.model_copy(update={"control": CONTROL})))


def wheels(model: FlexibleJointModel) -> np.ndarray:
    """(n,) which joints are wheels."""
    rolling = {item.rolls for item in model.robot.contacts}
    return np.array([joint.name in rolling for joint in model.joints])


# --- the plan ------------------------------------------------------------------------------------
def quintic(t: np.ndarray, begin: float, seconds: float) -> np.ndarray:
    """From 0 to 1 in that time, with velocity and acceleration 0 at both ends."""
    s = np.clip((t - begin) / seconds, 0.0, 1.0)
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


@cache
def plan() -> Plan:
    """The reference, the same for all variants."""
    model = robot_model()
    robot, places = model.robot, [joint.idx_q for joint in model.joints]
    time = np.arange(round(SECONDS * CONTROL)) / CONTROL
    q = np.tile(robot.configuration(POSES[0])[places], (len(time), 1))
    knots = np.arange(0.0, SECONDS + KNOT, KNOT)
    for k, (one, other) in enumerate(pairwise(POSES)):
        begin = WAIT + k * LEG
        move = begin + STEER
        there = move + MOVE
        q0, q1 = robot.configuration(one), robot.configuration(other)
        way = quintic(time, move, MOVE)
        into, home = quintic(time, begin, STEER), quintic(time, there, STEER)
        swing = _swing(SWAYS[other], time - there)
        q += way[:, None] * (q1 - q0)[places]
        shares = np.linspace(0.0, 1.0, 81)
        angle, speed = _steering(model, q0, q1, shares)
        for foot, item in enumerate(robot.contacts):
            yaw = robot.joint_names.index(f"ankle_yaw_{item.frame[-1]}")
            wheel = robot.joint_names.index(str(item.rolls))
            last = angle[-1, foot]
            steered = into * CubicSpline(shares, angle[:, foot])(way)
            q[:, yaw] += steered - home * last + np.sign(last) * swing
            q[:, wheel] += CubicSpline(shares, speed[:, foot]).antiderivative()(way) / item.radius
    dq = np.asarray(CubicSpline(time, q).derivative()(time))
    gravity, load = _loads(model, CubicSpline(time, q)(knots))
    damping = np.array([joint.drive.D_m for joint in model.joints]) * wheels(model)
    return Plan(time, q, dq, CubicSpline(knots, gravity)(time), CubicSpline(knots, load)(time), damping * dq)


def _swing(sway: Sway, t: np.ndarray) -> np.ndarray:
    """The angle (T,) [rad] at times t (T,) from the swaying's start [s]."""
    share = np.clip(t / sway.seconds, 0.0, 1.0)
    size = quintic(t, 0.0, 1.0) * (1.0 - share) ** 2
    return np.asarray(sway.angle * size * np.sin(2.0 * np.pi * sway.swings * share))


def _steering(
    model: FlexibleJointModel, q0: np.ndarray, q1: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(S, c) each: what the ankle's yaw turns beyond the pose [rad] so that the wheel points along its foot's
    way, and how far the wheel rolls then per share of the way [m]."""
    angle, speed = np.empty((len(shares), 4)), np.empty((len(shares), 4))
    body = model.body
    for row, share in enumerate(shares):
        q, onward = q0 + share * (q1 - q0), q0 + (share + NUDGE) * (q1 - q0)
        for foot, item in enumerate(model.robot.contacts):
            wheel, steer = str(item.rolls), f"ankle_yaw_{item.frame[-1]}"
            way = (body.frame_placement(onward, wheel) - body.frame_placement(q, wheel))[:2, 3] / NUDGE
            axis = body.frame_jacobian(q, wheel)[3:5, model.robot.joint(wheel).idx_v]
            up = body.frame_jacobian(q, steer)[5, model.robot.joint(steer).idx_v]
            ahead = np.array([axis[1], -axis[0]])  # axis x vertical
            angle[row, foot] = np.arctan2(ahead[0] * way[1] - ahead[1] * way[0], ahead @ way)
            angle[row, foot] *= np.sign(up)
            speed[row, foot] = np.linalg.norm(way)
    angle = np.unwrap(angle, axis=0)
    middle = 0.5 * (angle.max(axis=0) + angle.min(axis=0))
    half_turns = np.round(middle / np.pi)  # backwards, rather than more than a quarter turn
    return angle - np.pi * half_turns, speed * (-1.0) ** half_turns


def _loads(model: FlexibleJointModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """g(q) and g(q) - J_c' lambda (N, n) of the robot standing at joint positions q (N, n)."""
    at, rates = model.body.neutral.copy(), [joint.idx_v for joint in model.joints]
    gravity, load = np.empty_like(q), np.empty_like(q)
    for k, row in enumerate(q):
        at[[joint.idx_q for joint in model.joints]] = row
        rest = standing(model, at)
        gravity[k], load[k] = model.body.gravity_torque(rest.state.q)[rates], rest.tau
        at = rest.state.q.copy()
    return gravity, load


# --- runs ----------------------------------------------------------------------------------------
def references(gravity: str, motor: str) -> dict[str, np.ndarray]:
    """What the controller follows, (T, n) each. q_d + g/K takes the load that the variant knows: g(q_d), or
    g(q_d) - J_c' lambda where that is fed forward.

    Raises UnknownNameError.
    """
    if gravity not in GRAVITY:
        raise unknown("gravity_ff", gravity, GRAVITY)
    if motor not in MOTOR:
        raise unknown("theta_d", motor, MOTOR)
    way, model = plan(), robot_model()
    stiffness = np.array([joint.drive.K for joint in model.joints])
    known = way.load if gravity == "contact" else way.gravity
    forward = known if gravity != "none" else np.zeros_like(known)
    ahead = known / stiffness if motor == "load" else np.zeros_like(known)
    return {
        "q_ref": way.q,
        "theta_ref": way.q + ahead,
        "dtheta_ref": way.dq,
        "tau_ff": np.where(wheels(model), 0.0, forward) + way.rolling,
    }


def quickest() -> Engine:
    """The compiled clockwork where there is a C compiler: the pin loop takes minutes for all variants."""
    return "compiled" if compilers() else "pin"


@cache
def run(gravity: str, motor: str, which: Engine) -> Run:
    """One variant, from rest in the initial pose. Raises UnknownNameError."""
    model = robot_model()
    tape = simulated(model, gravity, motor, which)
    commands = references(gravity, motor)
    holds = tuple(_hold(model, law_of(model.robot), tape, commands, k) for k in (1, 2))
    return Run(gravity, motor, tape, holds)


def simulated(
    model: FlexibleJointModel, gravity: str, motor: str, which: Engine, seconds: float = SECONDS
) -> Trajectory:
    """The first seconds of a variant, by a model with the joints and poses of `robot_model`, whose
    references it follows; from rest in its initial pose. Raises UnknownNameError."""
    commands = references(gravity, motor)
    held: Any = law_of(model.robot)
    rolls = wheels(model)
    free = replace(held, kp=np.where(rolls, 0.0, held.kp), kd=np.where(rolls, 0.0, held.kd))
    state = standing(model, model.robot.configuration(POSES[0])).state
    brake = WAIT + LEG + STEER + MOVE + SWAYS["mammal"].seconds
    parts: list[Trajectory] = []
    options = RunOptions(rate=PHYSICS, engine=which)
    begin = 0
    at_last = free if gravity == "contact" else held
    for law, until in ((held, WAIT), (free, brake), (at_last, WAIT + 2 * LEG)):
        end = round(min(until, seconds) * CONTROL)
        if end == begin:
            break
        rows = {name: values[begin:end] for name, values in commands.items()}
        if law is held:
            places = [model.joints[i].idx_q for i in np.flatnonzero(rolls)]
            rows["theta_ref"] = rows["theta_ref"].copy()
            rows["theta_ref"][:, rolls] = state.q[places]
        parts.append(closed_loop(model, state, law, rows, options))
        state = parts[-1].state(len(parts[-1].time) - 1)
        begin = end
    return _joined(parts)


def _joined(parts: list[Trajectory]) -> Trajectory:
    """One trajectory of several, each of which begins where the last ends."""
    names = [field.name for field in fields(Trajectory) if field.name != "first"]
    rows = {
        name: np.concatenate([*(getattr(part, name)[:-1] for part in parts), getattr(parts[-1], name)[-1:]])
        for name in names
    }
    return Trajectory(**rows, first=0)


def _hold(
    model: FlexibleJointModel, law: Any, tape: Trajectory, commands: Mapping[str, np.ndarray], k: int
) -> Hold:
    end = round((WAIT + k * LEG) * PHYSICS)
    last, tick = slice(end - PHYSICS, end), (end - 1) * CONTROL // PHYSICS
    q = tape.q[last][:, [joint.idx_q for joint in model.joints]]
    stiffness = np.array([joint.drive.K for joint in model.joints])
    tau_t = tape.tau_m[last].mean(axis=0)  # at rest the motor's torque; the rigid joints have it, too
    ahead = commands["theta_ref"][tick] - commands["q_ref"][tick]
    error = q.mean(axis=0) - commands["q_ref"][tick]
    static = ahead - (tau_t - commands["tau_ff"][tick]) / law.kp - tau_t / stiffness
    still = ~wheels(model)
    return Hold(
        POSES[k],
        np.where(still, error, np.nan),
        np.where(still, static, np.nan),
        tau_t,
        float(np.max(np.ptp(q[:, still], axis=0))),
        float(contact_forces(model, tape, end)[:, 2].sum() / (model.robot.mass * 9.81)),
    )


def largest(values: np.ndarray) -> float:
    """Of magnitudes (n,), wheels left out."""
    return float(np.nanmax(np.abs(values)))


def contact_forces(model: FlexibleJointModel, tape: Trajectory, row: int) -> np.ndarray:
    """(c, 3) of the contacts on the robot in a row of a trajectory, along world axes [N]."""
    if model.ground is None:
        return np.zeros((0, 3))
    return np.array(model.ground.touch(model.body, tape.q[row], tape.v[row], tape.z[row]).forces)


# --- figures -------------------------------------------------------------------------------------
def draw(found: Run, folder: Path) -> list[Path]:
    """Fig. 8 (arm) and Fig. 9 (leg) of a variant as PNG files in the folder, which is made: reference and
    link position, velocity, motor position and velocity, motor and transmission torque of two joints each.

    Needs matplotlib (the extra `report`).
    """
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    model, commands = robot_model(), references(found.gravity, found.motor)
    tape, ticks = found.trajectory, plan().time
    names = list(SHOWN)
    files = []
    for number, pair in (("8", names[:2]), ("9", names[2:])):
        figure = Figure(figsize=(10.0, 9.0), layout="constrained")
        axes = figure.subplots(3, 2, sharex=True)
        for column, label in enumerate(pair):
            i = model.robot.joint_names.index(SHOWN[label])
            joint, k = model.joints[i], model.flexible.index(i)
            drive, q, v = joint.drive, tape.q[:, joint.idx_q], tape.v[:, joint.idx_v]
            theta, dtheta = tape.theta[:, k], tape.dtheta[:, k]
            spring = drive.K * (theta - q) + drive.D * (dtheta - v)
            where = {"q_d": commands["q_ref"][:, i], "q": q, "theta": theta}
            speed = {"dq_d": commands["dtheta_ref"][:, i], "dq": v, "dtheta": dtheta}
            torque = {"tau_m": tape.tau_m[:, i], "tau_t": spring}
            panels = {"rad": where, "rad/s": speed, "N m": torque}
            for ax, (unit, curves) in zip(axes[:, column], panels.items(), strict=True):
                for name, y in curves.items():
                    t = ticks if len(y) == len(ticks) else tape.time
                    ax.plot(t, y, label=name, linewidth=1.0)
                ax.set_ylabel(unit)
                ax.legend(loc="upper right", fontsize="small")
            axes[0, column].set_title(f"{label} ({SHOWN[label]})")
            axes[2, column].set_xlabel("t [s]")
        title = f"gravity_ff {GRAVITY[found.gravity]}, theta_d {MOTOR[found.motor]}"
        figure.suptitle(f"{title}: initial, spider, mammal")
        files.append(folder / f"fig{number}_{found.gravity}_{found.motor}.png")
        figure.savefig(files[-1], dpi=110)
    return files
