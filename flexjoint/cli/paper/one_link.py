"""Section 5.1 of Kameduła et al. 2016: one link on a spring, its step responses and a varying reference.

Two exact solutions are measured against, and they differ: with control held between ticks at 1 kHz, as a
digital controller does (what a scheme at 1 kHz should give), and with continuous control (what the paper's
Matlab simulation approximates).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np

from flexjoint.core.errors import unknown
from flexjoint.effects import Planned
from flexjoint.model.dynamics import FlexibleJointModel
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
RAMP, HOLD = 10.0, 5.0  # [s] of the ramp and of the stand after the step; the paper states no durations
VARYING = Profile(
    (
        (0.0, lambda t: 0.1 * t),
        (RAMP, constant(0.1 * RAMP - 1.0)),
        (RAMP + HOLD, lambda t: _chirp(t - RAMP - HOLD) + 0.1 * RAMP - 1.0),
    )
)
VARYING_SECONDS = 35.0


def _chirp(t: np.ndarray) -> np.ndarray:
    return 0.5 * np.sin(0.02 * np.pi * t + 0.004 * np.pi * t**2)


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
    saturation and where the reference jumps."""
    model = one_link(transmission, sensors)
    time = _grid(seconds)
    solution = continuous_control(
        model, model.rest(), law_of(model.robot), _commands(model, reference), time, reference.breaks
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
    `reference`. A jump of the reference is read at its tick from that side."""
    model = one_link(transmission, sensors)
    time = _grid(seconds)
    commands = tomei(model, reference(time + (AFTER if side == "right" else 0.0))[:, None])
    options = RunOptions(rate=physics, scheme=scheme, engine="pin")
    tape = closed_loop(model, model.rest(), law_of(model.robot), commands, options)
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
    runs = {name: held(transmission, STEP, seconds, scheme, rate) for name, (scheme, rate) in RUNS.items()}
    exact_held = held(transmission, STEP, seconds, "reference")
    continuous = exact(transmission, STEP, seconds)
    beside = {
        "fixed-step, continuous control": fixed_step(transmission, STEP, seconds),
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
        name: held(transmission, VARYING, seconds, scheme, rate)
        for name, (scheme, rate) in RUNS.items()
        if rate == RATE
    }
    runs["default scheme, read from the right"] = held(transmission, VARYING, seconds, side="right")
    title = f"{transmission}, ramp, step and chirp, {seconds:g} s: against exact CONTINUOUS control"
    return _table(title, runs, exact(transmission, VARYING, seconds))


def _table(title: str, runs: Mapping[str, Motion], other: Motion) -> Table:
    return Table(title, {name: differences(motion, other) for name, motion in runs.items()})


def _grid(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * RATE)) / RATE


def _commands(model: FlexibleJointModel, reference: Profile) -> References:
    """The references at a time, (n,) each; one that stays is worked out once."""
    known: dict[float, dict[str, np.ndarray]] = {}

    def commands(t: float) -> dict[str, np.ndarray]:
        q = float(reference(t))
        if q not in known:
            known.clear()
            known[q] = {name: rows[0] for name, rows in tomei(model, np.array([[q]])).items()}
        return known[q]

    return commands
