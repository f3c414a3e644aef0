"""Section 5.1 of Kameduła et al. 2016: one link on a spring, its step responses and a varying reference.

Two exact solutions are measured against, and they differ: with control held between ticks at 1 kHz, as a
digital controller does (what a scheme at 1 kHz should give), and with continuous control (what the paper's
Matlab simulation approximates).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Literal

import numpy as np

from flexjoint.cli.paper.motions import Call, motion
from flexjoint.core.errors import unknown
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.model.statics.start import at_rest
from flexjoint.robot.robot import load
from flexjoint.simulation.controllers import law_of
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.references import Profile, constant, tomei
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.schemes import DEFAULT
from flexjoint.simulation.schemes.reference import AFTER, References, continuous_control
from flexjoint.simulation.sensors import true_signals

JOINT = "joint2"
RATE = 1000  # Hz, f_c and f_s of the section
SIGNALS = {"q": "rad", "tau_t": "N m", "tau_m": "N m"}
# the transmissions, K_t [N m/rad] and D_t [N m s/rad]
TRANSMISSIONS: Mapping[str, tuple[float, float]] = {
    "K100": (100.0, 0.3),
    "K188": (188.0, 0.5),
    "K500": (500.0, 1.5),
}
# what the paper reports of its Gazebo plugin against Matlab, K188 on the varying reference
PAPER_MAX = {"q": 1.2e-3, "tau_t": 0.12, "tau_m": 2.11}
PAPER_NRMSE = {"q": 4.5e-7, "tau_t": 3.6e-5, "tau_m": 5.3e-4}
# the laser scanner and the camera of rrbot.xacro, 1e-5 kg each at 0.975 and 0.9 m along the link, the camera
# 0.05 m before it; robots/rrbot leaves them out
SENSORS = {"mass": 2e-5, "position": (0.025, 0.0, 0.9375)}

STEP = Profile(((0.0, constant(1.0)),))
STEP_SECONDS = 5.0
RAMP, HOLD, CHIRP = 10.0, 5.0, 20.0  # [s]; the paper states no durations
SPEED = 0.1  # rad/s of the ramp
VARYING = Profile(
    (
        (0.0, lambda t: SPEED * t),
        (RAMP, constant(SPEED * RAMP - 1.0)),
        (RAMP + HOLD, lambda t: _chirp(t - RAMP - HOLD) + SPEED * RAMP - 1.0),
    )
)
VARYING_SECONDS = RAMP + HOLD + CHIRP
# s of computing a second of motion, about
COSTS: Mapping[str, float] = {
    "exact": 0.3,
    "exact step": 0.07,
    "reference": 0.22,
    "rk4": 0.07,
    DEFAULT: 0.035,
}
OTHER_RAMPS = (5.0, 10.0, 20.0)  # [s], to see what the duration does
RAMP_END, AFTER_STEP = 1.0, 3.0  # [s] of a ramp's end and of the motion after its step


def _chirp(t: np.ndarray) -> np.ndarray:
    return 0.5 * np.sin(0.02 * np.pi * t + 0.004 * np.pi * t**2)


@cache
def ramp_and_step(ramp: float) -> Profile:
    """The last second of a ramp of that duration [s], and its step by -1 rad."""
    begin, end = SPEED * (ramp - RAMP_END), SPEED * ramp
    return Profile(((0.0, lambda t: begin + SPEED * t), (RAMP_END, constant(end - 1.0))))


@dataclass(frozen=True)
class Motion:
    """The link at 1 kHz, (N,) each: time [s], q, theta [rad], transmission and motor torque [N m]."""

    time: np.ndarray
    q: np.ndarray
    theta: np.ndarray
    tau_t: np.ndarray
    tau_m: np.ndarray


@dataclass(frozen=True)
class Difference:
    """How far a signal lies from another one: largest difference, root mean square, that over the range of
    the signal, and mean square."""

    max: float
    rms: float
    nrmse: float
    mse: float


@dataclass(frozen=True)
class StepFacts:
    """A step response: peak of q [rad], max |theta - q| [rad], max |tau_t| [N m], time that the motor torque
    is saturated [s, counted in samples], time after which q stays within 2 % [s]."""

    peak: float
    deflection: float
    torque: float
    saturated: float
    settling: float


@cache
def one_link(transmission: str = "K188", sensors: bool = True) -> FlexibleJointModel:
    """The last joint-link of rrbot on one of the paper's springs, without or with its two small sensors.

    Raises UnknownNameError for another transmission.
    """
    if transmission not in TRANSMISSIONS:
        raise unknown("transmission", transmission, TRANSMISSIONS)
    robot = load("rrbot_last_joint")
    K, D = TRANSMISSIONS[transmission]
    joint = replace(robot.joints[0], drive=replace(robot.joints[0].drive, K=K, D=D))
    robot = replace(robot, joints=(joint,))
    carried = [Planned.of("payload", JOINT, SENSORS)] if sensors else []
    return FlexibleJointModel(robot, [*robot.effects, *carried])


def exact(
    transmission: str = "K188", reference: Profile = STEP, seconds: float = STEP_SECONDS, sensors: bool = True
) -> Motion:
    """Continuous control, event-located: DOP853 at rtol 1e-11, restarted where the torque enters or leaves
    saturation and where the reference jumps. From rest where the reference begins."""
    model = one_link(transmission, sensors)
    time = _grid(seconds)
    solution = continuous_control(
        model,
        _start(model, reference),
        law_of(model.robot),
        _commands(model, reference),
        time,
        reference.breaks,
    )
    x = solution.x
    return Motion(time, x[:, 0], x[:, 2], solution.tau_t[:, 0], solution.tau_m[:, 0])


def held(
    transmission: str = "K188",
    reference: Profile = STEP,
    seconds: float = STEP_SECONDS,
    scheme: str = DEFAULT,
    physics: float = RATE,
    sensors: bool = True,
    side: Literal["left", "right"] = "left",
) -> Motion:
    """Control held between ticks at 1 kHz, by a scheme at a physics rate [Hz]; exact with the scheme
    `reference`. A jump of the reference is read at its tick from that side. From rest where it begins."""
    model = one_link(transmission, sensors)
    time = _grid(seconds)
    commands = tomei(model, reference(time + (AFTER if side == "right" else 0.0))[:, None])
    options = RunOptions(rate=physics, scheme=scheme, engine="pin")
    tape = closed_loop(model, _start(model, reference), law_of(model.robot), commands, options)
    stride = round(physics / RATE)
    rows = slice(0, stride * len(time), stride)
    true = true_signals(model, tape)
    q, theta, tau_t = (true[name, JOINT][rows] for name in ("q", "theta", "tau_t"))
    return Motion(time, q, theta, tau_t, tape.tau_m[rows, 0])


def fixed_step(
    transmission: str = "K188", reference: Profile = STEP, seconds: float = STEP_SECONDS, sensors: bool = True
) -> Motion:
    """Continuous control by classical Runge-Kutta at 1 kHz, the law in every stage: what a fixed-step solver
    does (the paper's Matlab)."""
    model = one_link(transmission, sensors)
    law, commands, time, h = law_of(model.robot), _commands(model, reference), _grid(seconds), 1.0 / RATE

    def torque(x: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(law.torque(commands(t), {"theta": x[2:3], "dtheta": x[3:4]}))

    def rate(x: np.ndarray, t: float) -> np.ndarray:
        return np.asarray(model.rhs(x, torque(x, t), None, t))

    x, states, torques = model.pack(model.rest()), [], []
    for t in time:
        states.append(x)
        torques.append(torque(x, t))  # from the left of a jump, as the exact solution is sampled
        k1 = rate(x, t + AFTER)
        k2 = rate(x + 0.5 * h * k1, t + 0.5 * h)
        k3 = rate(x + 0.5 * h * k2, t + 0.5 * h)
        k4 = rate(x + h * k3, t + h)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    q, dq, theta, dtheta = np.array(states).T
    K, D = TRANSMISSIONS[transmission]
    return Motion(time, q, theta, K * (theta - q) + D * (dtheta - dq), np.array(torques)[:, 0])


def _start(model: FlexibleJointModel, reference: Profile) -> State:
    """At rest where a reference begins; a step does so at 0, upright, before it is seen."""
    if reference is STEP:
        return model.rest()
    return at_rest(model, np.atleast_1d(reference(0.0)))


def step_facts(motion: Motion, limit: float = 33.0) -> StepFacts:
    """The figures of a response to a step to 1 rad."""
    outside = np.flatnonzero(np.abs(motion.q - 1.0) > 0.02)
    return StepFacts(
        float(np.max(motion.q)),
        float(np.max(np.abs(motion.theta - motion.q))),
        float(np.max(np.abs(motion.tau_t))),
        float(np.sum(np.abs(motion.tau_m) > limit * (1.0 - 1e-9)) / RATE),
        float(motion.time[outside[-1]]) if len(outside) else 0.0,
    )


def differences(motion: Motion, other: Motion) -> dict[str, Difference]:
    """Of q, tau_t and tau_m; the range is that of the other motion."""
    out = {}
    for signal in SIGNALS:
        a, b = getattr(motion, signal), getattr(other, signal)
        mse = float(np.mean((a - b) ** 2))
        rms = float(np.sqrt(mse))
        out[signal] = Difference(float(np.max(np.abs(a - b))), rms, rms / float(np.ptp(b)), mse)
    return out


@dataclass(frozen=True)
class Table:
    """Differences by run and signal from one exact solution."""

    title: str
    rows: Mapping[str, Mapping[str, Difference]]


RUNS: Mapping[str, tuple[str, float]] = {
    "default scheme, 1 kHz": (DEFAULT, 1000.0),
    "default scheme, 2 kHz": (DEFAULT, 2000.0),
    "rk4, 1 kHz": ("rk4", 1000.0),
    "rk4, 2 kHz": ("rk4", 2000.0),
    "kamedula2016, 1 kHz": ("kamedula2016", 1000.0),
    "kamedula2016_new, 1 kHz": ("kamedula2016_new", 1000.0),
}


def step_tables(transmission: str = "K188", seconds: float = STEP_SECONDS) -> tuple[Table, Table]:
    """The step response of every run against exact held control, and against exact continuous control."""
    runs = {
        name: motion(held, transmission, STEP, seconds, scheme, rate) for name, (scheme, rate) in RUNS.items()
    }
    exact_held = motion(held, transmission, STEP, seconds, "reference")
    continuous = motion(exact, transmission, STEP, seconds)
    beside = {
        "fixed-step, continuous control": motion(fixed_step, transmission, STEP, seconds),
        "exact held control": exact_held,
    }
    title = f"{transmission}, 1 rad step, {seconds:g} s: against exact"
    return (
        _table(f"{title} HELD control", runs, exact_held),
        _table(f"{title} CONTINUOUS control", {**runs, **beside}, continuous),
    )


def varying_table(transmission: str = "K188", seconds: float = VARYING_SECONDS) -> Table:
    """The ramp, step and chirp against exact continuous control, as the paper compares."""
    runs = {
        name: motion(held, transmission, VARYING, seconds, scheme, rate)
        for name, (scheme, rate) in RUNS.items()
        if rate == RATE
    }
    runs["default scheme, read from the right"] = motion(_read_from_the_right, transmission, seconds)
    title = f"{transmission}, ramp, step and chirp, {seconds:g} s: against exact CONTINUOUS control"
    return _table(title, runs, motion(exact, transmission, VARYING, seconds))


def _read_from_the_right(transmission: str, seconds: float) -> Motion:
    return held(transmission, VARYING, seconds, side="right")


# what stands for the paper's plugin
GAZEBO = "kamedula2016, 1 kHz"


def ramp_table(ramps: Sequence[float] = OTHER_RAMPS, transmission: str = "K188") -> Table:
    """What the ramp's duration does to the differences of the paper's scheme from exact continuous control,
    around the step, which has the largest ones."""
    scheme, rate = RUNS[GAZEBO]
    seconds = RAMP_END + AFTER_STEP
    rows = {}
    for ramp in ramps:
        reference = ramp_and_step(ramp)
        run = motion(held, transmission, reference, seconds, scheme, rate)
        rows[f"ramp of {ramp:g} s"] = differences(run, motion(exact, transmission, reference, seconds))
    return Table(f"{transmission}, {GAZEBO}, the end of a ramp and its step, {seconds:g} s", rows)


def total_table(totals: Sequence[float], transmission: str = "K188") -> Table:
    """What the whole duration [s] does to them: those of the first seconds of the varying reference."""
    scheme, rate = RUNS[GAZEBO]
    run = motion(held, transmission, VARYING, VARYING_SECONDS, scheme, rate)
    other = motion(exact, transmission, VARYING, VARYING_SECONDS)
    rows = {f"first {total:g} s": differences(_first(run, total), _first(other, total)) for total in totals}
    return Table(f"{transmission}, {GAZEBO}, ramp, step and chirp: as long as", rows)


def _first(run: Motion, seconds: float) -> Motion:
    rows = slice(0, round(seconds * RATE))
    return Motion(*(getattr(run, field.name)[rows] for field in fields(Motion)))


def calls(steps_only: bool = False) -> list[Call]:
    """All motions of the section's tables, to be prepared."""
    out: list[Call] = []
    for name in TRANSMISSIONS:
        step = (name, STEP, STEP_SECONDS)
        out += [(exact, step), (fixed_step, step), (held, (*step, "reference"))]
        out += [(held, (*step, *run)) for run in RUNS.values()]
    if not steps_only:
        varying = ("K188", VARYING, VARYING_SECONDS)
        out += [(exact, varying), (_read_from_the_right, ("K188", VARYING_SECONDS))]
        out += [(held, (*varying, *run)) for run in RUNS.values() if run[1] == RATE]
        for ramp in OTHER_RAMPS:
            end = ("K188", ramp_and_step(ramp), RAMP_END + AFTER_STEP)
            out += [(exact, end), (held, (*end, *RUNS[GAZEBO]))]
    return out


def cost(call: Call) -> float:
    """About how long a motion takes [s], in proportion."""
    function, (*_, reference, seconds) = call[0], call[1][:3]
    if function is exact:
        return float(seconds) * (COSTS["exact"] if reference is VARYING else COSTS["exact step"])
    if function is not held:
        return float(seconds) * COSTS["rk4" if function is fixed_step else DEFAULT]
    scheme, rate = (*call[1][3:], float(RATE))[:2]
    return float(seconds) * COSTS.get(scheme, COSTS[DEFAULT]) * rate / RATE


def _table(title: str, runs: Mapping[str, Motion], other: Motion) -> Table:
    return Table(title, {name: differences(motion, other) for name, motion in runs.items()})


def _grid(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * RATE)) / RATE


def _commands(model: FlexibleJointModel, reference: Profile) -> References:
    """The references at a time, (n,) each. The load of one link about a level axis is a sine and a cosine of
    its angle, so that of two poses gives all of them."""
    upright, level = tomei(model, np.array([[0.0], [0.5 * np.pi]]))["tau_ff"][:, 0]
    stiffness, still = model.joints[0].drive.K, np.zeros(1)

    def commands(t: float) -> dict[str, np.ndarray]:
        q = float(reference(t))
        load = upright * math.cos(q) + level * math.sin(q)
        return {
            "q_ref": np.array([q]),
            "theta_ref": np.array([q + load / stiffness]),
            "dtheta_ref": still,
            "tau_ff": np.array([load]),
        }

    return commands
