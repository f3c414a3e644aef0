"""Synthetic diagnoses with all that a report may show: a tie, an onset, leftovers, refusal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from flexjoint import diagnosis as d
from flexjoint import recording, robot
from flexjoint.effect import plan

LINK = """<link name="link{i}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="continuous"><parent link="link{parent}"/><child link="link{i}"/>
<axis xyz="0 1 0"/></joint>
"""
JOINTS = ("shoulder", "elbow")


@dataclass(frozen=True)
class Simulated:
    """What flexjoint.compare hands over, as far as the page needs it."""

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


def friction(
    joint: str = "elbow", why: str = "the motion never rests, so stiction does not show"
) -> d.Finding:
    values = {"level": 0.4}
    return d.Finding(
        "motor_coulomb_friction",
        joint,
        0.973,
        {"level": d.Fitted(0.4012, 0.0031, "N m")},
        None,
        0.71,
        "mechanical",
        plan("motor_coulomb_friction", joint, values),
        indistinguishable=(d.Tie("stribeck_friction", joint, why), d.Tie("asymmetric_friction", joint, why)),
        hidden_by_refit=True,
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
        plan("sensor_delay", "shoulder", {"delay": 0.005, "channel": "theta"}),
        note="sets in after the pause",
    )


def causes(measured: recording.Recording, before: Simulated, after: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "causes",
        "two causes bring the residual down to its noise",
        findings=(friction(), delay()),
        unexplained=(d.Unexplained("elbow", "spring", 0.043, "theta"),),
        not_excited=(("end_stop", "elbow"), ("end_stop", "shoulder"), ("cable_spring", "elbow")),
        within_tolerance=(d.WithinTolerance("payload", "elbow", 0.008),),
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


def healthy(measured: recording.Recording, before: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "healthy",
        "nothing beats the noise and the tolerances",
        within_tolerance=(d.WithinTolerance("payload", "elbow", 0.008),),
        comparison=gain(before, before),
        residuals=tuple(replace(v, before=v.after) for v in views(measured)),
    )


def unexplained(measured: recording.Recording, before: Simulated) -> d.Diagnosis:
    return d.Diagnosis(
        "unexplained",
        "the best candidate removes 4 % of the error",
        unexplained=(d.Unexplained("elbow", "motor", 0.93, "dtheta"),),
        comparison=gain(before, before),
        ranking=(d.Ranked("backlash", "elbow", 0.04, {"gap": 0.001}),),
        residuals=views(measured, left=1.0),
        next_experiment="turn the elbow slowly both ways",
    )


def refused() -> d.Diagnosis:
    return d.Diagnosis(
        "refused", "the recording holds no motor torque", next_experiment="record tau_m beside theta and q"
    )
