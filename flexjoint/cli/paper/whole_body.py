"""Section 5.2 of Kameduła et al. 2016: CENTAURO goes from its initial pose to a spider's and a mammal's.

The paper gives no reference trajectories. Here both arms reach out on the way to the spider's pose and come
back on the way to the mammal's, while the feet stay on the ground and roll: the wheels turn into the
direction in which their foot will move, the legs move while the wheels roll with them, and the wheels sway
about the pose's heading, ever less, which relaxes the forces between the feet. Joint positions are quintic
blends between the poses of the robot file, so velocities and accelerations begin and end at 0, the shanks
stay vertical, and the base goes up or down and nowhere else. Wheels have the velocity controller (the paper's
wheel_controller, section 4.2.1) with their kd, the torque of their motors' damping fed forward. The motor PD
parks them in the mammal pose after the swaying unless g - J_c' lambda is fed forward: a velocity controller
does not hold a place, and under low gains the robot rolls off and tips over there. All other joints have the
motor PD of the robot file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from scipy.interpolate import CubicSpline

from flexjoint.core.errors import unknown
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.standing import standing
from flexjoint.robot.robot import load
from flexjoint.simulation.compiled.compiler import compilers
from flexjoint.simulation.controllers import Mixed, MotorPD, Velocity, law_of
from flexjoint.simulation.options import Engine, RunOptions
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.trajectory import Trajectory

POSES = ("initial", "spider", "mammal")
# shoulder pitch and elbow in the spider's pose [rad]: hands 0.14 m ahead, with no collision on the way
REACH: Mapping[str, float] = {"j_arm1_1": 0.2, "j_arm1_4": -1.6, "j_arm2_1": 0.2, "j_arm2_4": -1.6}
PHYSICS, CONTROL = 2000, 1000  # Hz, f_s and f_c of the section
KNOT = 0.05  # [s] between the poses whose loads are computed; between them by cubic splines
NUDGE = 1e-4  # of the way between two poses, for the direction in which a foot goes
Gravity = Literal["none", "gravity", "contact"]
Motor = Literal["link", "load"]
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


# in the mammal pose not for long: on such wheels the robot tips over some seven seconds after its move
SWAYS: Mapping[str, Sway] = {"spider": Sway(15.0, 5.0, 1.2), "mammal": Sway(3.0, 3.0, 0.6)}


@dataclass(frozen=True)
class Timing:
    """Durations [s], of which the paper states none: at rest in the initial pose, turning the wheels, moving
    the legs and arms, and in the pose after the longest swaying."""

    wait: float = 1.0
    steer: float = 1.5
    move: float = 4.0
    hold: float = 9.0

    @property
    def leg(self) -> float:
        """From one pose to the next."""
        return self.steer + self.move + max(sway.seconds for sway in SWAYS.values()) + self.hold

    @property
    def total(self) -> float:
        return self.wait + 2 * self.leg


TIMING = Timing()


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
    """One variant: its trajectory at f_s, what its holds say, spider and mammal, and what it followed."""

    gravity: str
    motor: str
    trajectory: Trajectory
    holds: tuple[Hold, ...]
    plan: Plan
    timing: Timing


@cache
def robot_model() -> FlexibleJointModel:
    """CENTAURO on its wheels."""
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


def configuration(pose: str) -> np.ndarray:
    """(nq,) of a pose: the robot file's, and the arms' reach. Raises RobotError for a pose without a name."""
    robot = robot_model().robot
    q = robot.configuration(pose)
    if pose == "spider":
        q[[robot.joint(name).idx_q for name in REACH]] = list(REACH.values())
    return q


@cache
def plan(timing: Timing = TIMING) -> Plan:
    """The reference, the same for all variants."""
    model = robot_model()
    robot, places = model.robot, [joint.idx_q for joint in model.joints]
    time = np.arange(round(timing.total * CONTROL)) / CONTROL
    q = np.tile(configuration(POSES[0])[places], (len(time), 1))
    knots = np.arange(0.0, timing.total + KNOT, KNOT)
    for k, (one, other) in enumerate(pairwise(POSES)):
        begin = timing.wait + k * timing.leg
        move = begin + timing.steer
        there = move + timing.move
        q0, q1 = configuration(one), configuration(other)
        way = quintic(time, move, timing.move)
        into, home = quintic(time, begin, timing.steer), quintic(time, there, timing.steer)
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
def references(gravity: str, motor: str, timing: Timing = TIMING) -> dict[str, np.ndarray]:
    """What the controller follows, (T, n) each. q_d + g/K takes the load that the variant knows: g(q_d), or
    g(q_d) - J_c' lambda where that is fed forward.

    Raises UnknownNameError.
    """
    if gravity not in GRAVITY:
        raise unknown("gravity_ff", gravity, GRAVITY)
    if motor not in MOTOR:
        raise unknown("theta_d", motor, MOTOR)
    way, model = plan(timing), robot_model()
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


def paper_whole_body(
    gravity: Gravity = "none", motor: Motor = "link", *, timing: Timing = TIMING, engine: Engine = "auto"
) -> Run:
    """CENTAURO from its initial to a spider's and a mammal's pose: section 5.2 of Kameduła et al. 2016, one
    variant of it (docs/studies/whole_body.md).

    Args:
        gravity: the feed-forward torque: none, g(q_d) (`gravity`), or g(q_d) - J_c' lambda (`contact`).
        motor: theta_d is q_d (`link`), or q_d + g/K of the load that is known (`load`).
        timing: durations of the motion [s].
        engine: as of a simulation; a minute of motion takes the pin loop half a minute.

    Raises:
        UnknownNameError: for another name. MissingExtraError: the robot's description is not installed.
    """
    return run(gravity, motor, quickest() if engine == "auto" else engine, timing)


@cache
def run(gravity: str, motor: str, which: Engine, timing: Timing = TIMING) -> Run:
    """One variant, from rest in the initial pose. Raises UnknownNameError."""
    model = robot_model()
    tape = simulated(model, gravity, motor, which, timing=timing)
    commands = references(gravity, motor, timing)
    holds = tuple(
        _hold(model, tape, commands, POSES[k], timing.wait + k * timing.leg) for k in range(1, len(POSES))
    )
    return Run(gravity, motor, tape, holds, plan(timing), timing)


def simulated(
    model: FlexibleJointModel,
    gravity: str,
    motor: str,
    which: Engine,
    seconds: float = np.inf,
    timing: Timing = TIMING,
) -> Trajectory:
    """The first seconds of a variant (default: all), by a model with the joints and poses of `robot_model`,
    whose references it follows; from rest in its initial pose. Raises UnknownNameError."""
    commands = references(gravity, motor, timing)
    parked: Any = law_of(model.robot)
    rolls = wheels(model)
    rolling: Any = _velocity_controlled(parked, rolls)
    state = standing(model, model.robot.configuration(POSES[0])).state
    park = timing.wait + timing.leg + timing.steer + timing.move + SWAYS["mammal"].seconds
    parts: list[Trajectory] = []
    options = RunOptions(rate=PHYSICS, engine=which)
    begin = 0
    at_last: Any = rolling if gravity == "contact" else parked
    for law, until in ((rolling, park), (at_last, timing.total)):
        end = round(min(until, seconds) * CONTROL)
        if end == begin:
            break
        rows = {name: values[begin:end] for name, values in commands.items()}
        if law is parked:
            places = [model.joints[i].idx_q for i in np.flatnonzero(rolls)]
            rows["theta_ref"] = rows["theta_ref"].copy()
            rows["theta_ref"][:, rolls] = state.q[places]
        parts.append(closed_loop(model, state, law, rows, options))
        state = parts[-1].state(len(parts[-1].time) - 1)
        begin = end
    return _joined(parts)


def _velocity_controlled(law: MotorPD, rolls: np.ndarray) -> Mixed:
    """The law, with the velocity controller and the same kd and limit on the joints that roll (n,)."""
    still, wheel = np.flatnonzero(~rolls), np.flatnonzero(rolls)
    held = MotorPD(law.kp[still], law.kd[still], law.limit[still])
    turned = Velocity(law.kd[wheel], law.limit[wheel])
    return Mixed(((tuple(map(int, still)), held), (tuple(map(int, wheel)), turned)))


def _joined(parts: list[Trajectory]) -> Trajectory:
    """One trajectory of several, each of which begins where the last ends."""
    names = [field.name for field in fields(Trajectory) if field.name != "first"]
    rows = {
        name: np.concatenate([*(getattr(part, name)[:-1] for part in parts), getattr(parts[-1], name)[-1:]])
        for name in names
    }
    return Trajectory(**rows, first=0)


def _hold(
    model: FlexibleJointModel, tape: Trajectory, commands: Mapping[str, np.ndarray], pose: str, until: float
) -> Hold:
    law, end = law_of(model.robot), round(until * PHYSICS)
    last, tick = slice(end - PHYSICS, end), (end - 1) * CONTROL // PHYSICS
    q = tape.q[last][:, [joint.idx_q for joint in model.joints]]
    stiffness = np.array([joint.drive.K for joint in model.joints])
    tau_t = tape.tau_m[last].mean(axis=0)  # at rest the motor's torque; the rigid joints have it, too
    ahead = commands["theta_ref"][tick] - commands["q_ref"][tick]
    error = q.mean(axis=0) - commands["q_ref"][tick]
    static = ahead - (tau_t - commands["tau_ff"][tick]) / law.kp - tau_t / stiffness
    still = ~wheels(model)
    return Hold(
        pose,
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
