"""Synthetic diagnoses with all that a report may show: a tie, an onset, what is left, steps, refusal."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import yaml

from flexjoint.diagnosis import result as d
from flexjoint.effects import Planned, effect
from flexjoint.recording import table as recording
from flexjoint.robot import robot

LINK = """<link name="link{i}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="continuous"><parent link="link{parent}"/><child link="link{i}"/>
<axis xyz="0 1 0"/></joint>
"""
JOINTS = ("shoulder", "elbow")


@dataclass(frozen=True)
class Simulated:
    """What flexjoint.diagnosis.comparison.compare hands over, as far as the page needs it."""

    rms: dict[str, float]
    nrmse: dict[str, float]
    horizon: float
    windows: int
    time: np.ndarray
    simulated: dict[tuple[str, str], np.ndarray]


def arm(folder: Path, names: tuple[str, ...] = JOINTS) -> robot.Robot:
    links = "".join(LINK.format(i=i + 1, parent=i, name=name) for i, name in enumerate(names))
    (folder / "arm2.urdf").write_text(f'<robot name="arm2"><link name="link0"/>{links}</robot>')
    joint = {"stiffness": 260, "damping": 0.7, "motor_inertia": 0.09, "motor_damping": 6}
    file = {"name": "arm2", "urdf": "arm2.urdf", "joints": {name: joint for name in names}}
    (folder / "arm2.yaml").write_text(yaml.safe_dump(file))
    return robot.load(folder / "arm2.yaml")


def signals(seconds: float = 20.0, rate: float = 250.0, seed: int = 1) -> recording.Recording:
    """Smooth motion of both joints with a spring torque; noise as of 16-bit encoders."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1 / rate)
    columns: dict[tuple[str, str], np.ndarray] = {}
    for i, joint in enumerate(JOINTS):
        q = 0.6 * np.sin(2.1 * time + i) + 0.25 * np.sin(5.3 * time + 2 * i)
        dq = np.gradient(q, time)
        tau = 4 * np.sin(q) + 0.3 * np.gradient(dq, time)
        theta = q + tau / 260
        for channel, values, noise in (
            ("q", q, 1e-4),
            ("dq", dq, 2e-3),
            ("theta", theta, 1e-4),
            ("dtheta", np.gradient(theta, time), 2e-3),
            ("tau_t", tau, 0.02),
        ):
            columns[channel, joint] = values + noise * rng.standard_normal(time.size)
    return recording.make(time, columns, "runs/monday.csv")


def simulation(measured: recording.Recording, size: float, seed: int = 2) -> Simulated:
    """The recording plus an error that grows in each window of 0.5 s and with the elbow's speed."""
    rng = np.random.default_rng(seed)
    time = measured.time
    inside = (time % 0.5) / 0.5
    simulated, rms, nrmse = {}, {}, {}
    for (channel, joint), values in measured.columns.items():
        spread = float(np.std(values))
        wrong = size * spread * (1.0 if joint == "elbow" else 0.2)
        error = wrong * inside * np.sin(1.3 * time) * np.sign(measured.get("dtheta", joint))
        simulated[channel, joint] = np.where(time < time[-1] - 0.3, values + error, np.nan)
        simulated[channel, joint] += 1e-3 * spread * rng.standard_normal(time.size)
        left = simulated[channel, joint] - values
        rms[f"{channel}.{joint}"] = float(np.sqrt(np.nanmean(left**2)))
        nrmse[f"{channel}.{joint}"] = rms[f"{channel}.{joint}"] / spread
    return Simulated(rms, nrmse, 0.5, 39, time, simulated)


def views(measured: recording.Recording, left: float = 0.0) -> tuple[d.ResidualView, ...]:
    """Motor, link and spring balances; dry friction on the elbow's motor, of which `left` stays."""
    rng = np.random.default_rng(3)
    out = []
    for joint in JOINTS:
        at = {c: measured.get(c, joint) for c in ("q", "dq", "theta", "dtheta", "tau_t")}
        at["phi"] = at["theta"] - at["q"]
        for balance, noise in (("motor", 0.05), ("link", 0.08), ("spring", 0.03)):
            floor = noise * rng.standard_normal(measured.time.size)
            lacking = -0.4 * np.sign(at["dtheta"]) if (joint, balance) == ("elbow", "motor") else 0.0
            out.append(
                d.ResidualView(
                    joint, balance, measured.time, floor + lacking, floor + left * lacking, noise, at
                )
            )
    return tuple(out)


def gain(before: Simulated, after: Simulated) -> d.Gain:
    return d.Gain(
        held_out=True,
        horizon=0.5,
        before={"rms": before.rms, "nrmse": before.nrmse},
        after={"rms": after.rms, "nrmse": after.nrmse},
        noise_floor={"rms": {key: 0.01 * before.rms[key] / before.nrmse[key] for key in before.rms}},
    )


def friction(joint: str = "elbow", why: str = "fits as well, as the motion never rests") -> d.Finding:
    values = {"level": 0.4}
    return d.Finding(
        "motor_coulomb_friction",
        joint,
        0.973,
        {"level": d.Fitted(0.4012, 0.0031, "N m")},
        None,
        0.71,
        "mechanical",
        Planned.of("motor_coulomb_friction", joint, values),
        indistinguishable=(d.Tie("stribeck_friction", joint, why), d.Tie("asymmetric_friction", joint, why)),
        hidden_by_refit=True,
        removed=d.Removed(joint, "motor", 4.02, 0.161, 0.02, "dtheta"),
    )


def delay() -> d.Finding:
    return d.Finding(
        "sensor_delay",
        "shoulder",
        0.88,
        {"delay": d.Fitted(0.00512, 0.00012, "s"), "channel": "theta"},
        7.5,
        0.09,
        "timing",
        effect("sensor_delay", "shoulder", delay=0.005, channel="theta"),
        note="sets in after the pause",
        removed=d.Removed("shoulder", "spring", 0.91, 0.11, 0.01, "q"),
    )


def preload() -> d.Finding:
    """A cause that is more likely absent than there."""
    return d.Finding(
        "spring_preload",
        "shoulder",
        0.23,
        {"torque": d.Fitted(0.31, 0.06, "N m")},
        None,
        0.02,
        "mechanical",
        effect("spring_preload", "shoulder", torque=0.31),
        removed=d.Removed("shoulder", "spring", 0.13, 0.11, 0.01, "q"),
    )


def remaining(after: float = 0.161, structured: float = 0.02) -> tuple[d.Remaining, ...]:
    """A shoulder that was right and an elbow that was not [N m]."""
    return (
        d.Remaining("shoulder", 12.0, 0.13, 0.11, 0.1, 0.01, "q"),
        d.Remaining("elbow", 8.05, 4.02, after, 0.05, structured, "dtheta"),
    )


@dataclass(frozen=True)
class Step:
    """A change of the set of causes, as far as the page needs it."""

    stage: str
    action: str
    effect: str
    joint: str | None
    by: tuple[str, str | None] | None
    check: str
    evidence: float
    text: str


@dataclass(frozen=True)
class Traced(d.Diagnosis):
    """A diagnosis that says how its causes were found."""

    trace: tuple[Step, ...] = ()


STEPS = (
    Step(
        "search",
        "added",
        "motor_coulomb_friction",
        "elbow",
        None,
        "search",
        8123.4,
        "motor_coulomb_friction on elbow: the largest gain of all candidates",
    ),
    Step(
        "balances",
        "dropped",
        "backlash",
        "elbow",
        None,
        "certainty",
        1.2,
        "backlash on elbow: its size is known to 1.2 standard errors only",
    ),
)


def traced(diagnosis: d.Diagnosis, steps: tuple[Step, ...] = STEPS) -> d.Diagnosis:
    """The diagnosis with the steps that led to it."""
    kept = {f.name: getattr(diagnosis, f.name) for f in fields(d.Diagnosis) if f.name != "trace"}
    return Traced(**kept, trace=steps)


def slide(verdict: d.Verdict = "causes", after: float = 2.2) -> d.Diagnosis:
    """A linear drive without springs, whose friction differs by direction [N]."""
    levels = {"level_positive": 23.6, "level_negative": 17.2}
    return d.Diagnosis(
        verdict,
        "the cause named explains the error",
        findings=(
            d.Finding(
                "asymmetric_friction",
                "slide",
                0.96,
                {name: d.Fitted(value, 0.11, "N") for name, value in levels.items()},
                None,
                0.9991,
                "mechanical",
                effect("asymmetric_friction", "slide", **levels),
                removed=d.Removed("slide", "motor", 53.0, after, 0.8, "tau_t"),
            ),
        ),
        remaining=(d.Remaining("slide", 120.0, 53.0, after, 0.4, 0.8 * after, "tau_t"),),
        comparison=d.Gain(
            True,
            0.5,
            {"rms": {"theta.slide": 0.0032}, "nrmse": {"theta.slide": 0.032}},
            {"rms": {"theta.slide": 0.0028}, "nrmse": {"theta.slide": 0.028}},
            {"rms": {"theta.slide": 1e-6}},
        ),
        next_experiment="Record slow and fast sweeps of slide over its whole range.",
    )


def causes(measured: recording.Recording, before: Simulated, after: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "causes",
        "two causes bring the residual down to its noise",
        findings=(friction(), delay()),
        unexplained=(d.Unexplained("elbow", "spring", 0.043, "theta"),),
        remaining=remaining(),
        not_excited=(("end_stop", "elbow"), ("end_stop", "shoulder"), ("cable_spring", "elbow")),
        within_tolerance=(d.WithinTolerance("payload", "elbow", "mass", 0.008),),
        comparison=gain(before, after),
        next_experiment="hold the elbow still for 2 s between moves, so that stiction shows",
        ranking=(
            d.Ranked("motor_coulomb_friction", "elbow", 0.71, {"level": 0.4}),
            d.Ranked("stribeck_friction", "elbow", 0.705, {"level": 0.39, "static_extra": 0.02}),
            d.Ranked("motor_viscous_friction", "elbow", 0.31, {"coefficient": 0.4}),
            d.Ranked("sensor_delay", "shoulder", 0.09, {"delay": 0.0051, "channel": "theta"}),
            d.Ranked("payload", "elbow", 0.02, {"mass": 0.1, "position": (0.1, 0.0, 0.2)}),
            d.Ranked("backlash", "elbow", -0.01, {"gap": 1e-4}),
        ),
        residuals=views(measured),
        explained=0.96,
        energy=(64.2, 1.04),
        notes=("encoder offsets were estimated on the first 0.5 s",),
    )


def two_causes() -> d.Diagnosis:
    """`causes` of a short recording."""
    measured = signals(seconds=4.0)
    return causes(measured, simulation(measured, 0.3), simulation(measured, 0.02))


def healthy(measured: recording.Recording, before: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "healthy",
        "nothing beats the noise and the tolerances",
        remaining=(d.Remaining("elbow", 8.05, 0.31, 0.055, 0.05, 0.0, "q"),),
        within_tolerance=(d.WithinTolerance("payload", "elbow", "mass", 0.008),),
        comparison=gain(before, before),
        residuals=tuple(replace(v, before=v.after) for v in views(measured)),
    )


def unexplained(measured: recording.Recording, before: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "unexplained",
        "the best candidate removes 4 % of the error",
        unexplained=(d.Unexplained("elbow", "motor", 0.93, "dtheta"),),
        remaining=remaining(after=3.86, structured=3.1),
        comparison=gain(before, before),
        ranking=(d.Ranked("backlash", "elbow", 0.04, {"gap": 0.001}),),
        residuals=views(measured, left=1.0),
        next_experiment="turn the elbow slowly both ways",
    )


def refused() -> d.Diagnosis:
    return d.Diagnosis(
        "refused", "the recording holds no motor torque", next_experiment="record tau_m beside theta and q"
    )
