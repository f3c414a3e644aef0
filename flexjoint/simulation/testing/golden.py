"""Golden runs: signals of a simulation, and of which robot, versions and settings they are, in one file."""

from __future__ import annotations

import io
import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from flexjoint.core.errors import FlexJointError, unknown
from flexjoint.core.files import write_bytes
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import FREE, model_parameters
from flexjoint.recording import table as recording
from flexjoint.simulation.sensors import true_signals
from flexjoint.simulation.trajectory import Trajectory

SCHEMA = 1
KEY = b"flexjoint.golden"  # of the Parquet file's metadata
SIGNALS = ("q", "dq", "theta", "dtheta", "tau_t", "tau_m")
UNITS: Mapping[str, str] = MappingProxyType(
    {**{channel: recording.UNITS[channel] for channel in SIGNALS}, "base": "m, 1"}
)
CHANNELS = ("q", "theta", "tau_t", "tau_m")
BASE = ("x", "y", "z", "qx", "qy", "qz", "qw")
PACKAGES = ("flexjoint", "pin", "casadi", "numpy", "scipy")
Setting = str | float | int | bool


@dataclass(frozen=True)
class About:
    """Of which run: the robot's name, physics rate [Hz], what the caller said of it, versions of the
    packages behind it, and the model's numbers by name (`model.parameters`, gains, limits, contacts)."""

    robot: str
    physics: float
    settings: Mapping[str, Setting]
    versions: Mapping[str, str]
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class GoldenRun:
    """time (N,) [s]; signals by name, <channel>.<joint> or the caller's own, (N,) each; about."""

    time: np.ndarray
    signals: Mapping[str, np.ndarray]
    about: About

    def with_signals(self, signals: Mapping[str, np.ndarray]) -> GoldenRun:
        """The run with signals of the caller's own beside, (N,) each, e.g. {"height.hand": ...}.

        Raises FlexJointError for another shape or a name that is taken.
        """
        for name, values in signals.items():
            if name in self.signals or name == "time":
                raise FlexJointError(f"signal {name}: the run has one of this name; choose another")
            if np.shape(values) != self.time.shape:
                raise FlexJointError(
                    f"signal {name}: expected {len(self.time)} values, one for each time of the run, got"
                    f" shape {np.shape(values)}"
                )
        merged = {**self.signals, **{name: np.asarray(v, dtype=float) for name, v in signals.items()}}
        return replace(self, signals=MappingProxyType(merged))


def golden_run(
    model: FlexibleJointModel,
    trajectory: Trajectory,
    rate: float,
    channels: Sequence[str] = CHANNELS,
    joints: Sequence[str] | None = None,
    settings: Mapping[str, Setting] | None = None,
) -> GoldenRun:
    """The part of a simulated motion that a golden file keeps.

    Args:
        rate: rows per second, a divisor of the physics rate. A difference that lasts shows at 10 or 20.
        channels: of q, dq, theta, dtheta, tau_t, tau_m, and base: a floating base's position and quaternion.
        joints: default: all actuated ones.
        settings: what else makes this run this one (controller, scheme, engine, seed), by name; a golden
            file is compared only with a run of the same settings.

    Raises:
        FlexJointError: a rate that does not divide the physics rate.
        UnknownNameError: a channel or joint that does not exist.
    """
    robot = model.robot
    names = robot.joint_names if joints is None else tuple(joints)
    for name in names:
        robot.joint(name)
    valid = [name for name in UNITS if name != "base" or robot.floating]
    for channel in channels:
        if channel not in valid:
            raise unknown("channel", channel, valid)
    physics = 1.0 / float(trajectory.time[1] - trajectory.time[0])
    stride = round(physics / rate) if rate > 0 else 0
    if stride < 1 or abs(stride * rate - physics) > 1e-6 * physics:
        raise FlexJointError(f"rate: expected a divisor of the physics rate {physics:g} Hz, got {rate:g}")
    rows = slice(trajectory.first, None, stride)
    kept = {item.name: getattr(trajectory, item.name)[rows] for item in fields(Trajectory)[:-1]}
    part = Trajectory(**kept, first=0)
    true = true_signals(model, part)
    signals: dict[str, np.ndarray] = {}
    for channel in channels:
        if channel == "base":
            signals.update({f"base.{axis}": part.q[:, k].copy() for k, axis in enumerate(BASE)})
            continue
        for name in names:
            place = robot.joint_names.index(name)
            values = part.tau_m[:, place] if channel == "tau_m" else true[channel, name]
            signals[f"{channel}.{name}"] = np.array(values)
    about = About(robot.name, round(physics, 6), dict(settings or {}), _versions(), _numbers(model))
    return GoldenRun(part.time.copy(), MappingProxyType(signals), about)


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "machine": f"{platform.system()} {platform.machine()}"}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"  # used from a checkout
    return found


def _numbers(model: FlexibleJointModel) -> dict[str, float]:
    """The model's numbers by name."""
    robot = model.robot
    table = {name: item.value for name, item in model_parameters(robot, model.effects, FREE).items()}
    for joint in model.joints:
        table.update({f"{key}.{joint.name}": getattr(joint, key) for key in ("kp", "kd", "torque_limit")})
    for contact in robot.contacts:
        for key, value in asdict(contact).items():
            if isinstance(value, float):
                table[f"contact.{contact.frame}.{key}"] = value
    table.update({f"gravity.{axis}": value for axis, value in zip("xyz", robot.gravity, strict=True)})
    return {name: float(value) for name, value in table.items() if np.isfinite(value)}


def record_golden(run: GoldenRun, path: str | os.PathLike[str]) -> None:
    """Write a golden file (Parquet), whole or not at all; one that is there is replaced.

    Raises FlexJointError for numbers that are not finite, another suffix, or a place that cannot be written.
    """
    out = _parquet(path)
    for name, values in run.signals.items():
        if not np.all(np.isfinite(values)):
            raise FlexJointError(
                f"{out}: signal {name} is not finite everywhere; such a run cannot be a golden file"
            )
    about = json.dumps({"schema": SCHEMA, **_plain(run.about)}, sort_keys=True)
    table = pa.table({"time": run.time, **run.signals}).replace_schema_metadata({KEY: about.encode()})
    sink = io.BytesIO()
    # doubles whose bytes stand together by place pack to half of what they do otherwise
    pa.parquet.write_table(
        table,
        sink,
        compression="zstd",
        use_dictionary=False,
        use_byte_stream_split=True,
        write_statistics=False,  # as large as the columns of a short run
    )
    write_bytes(out, sink.getvalue())


def read_golden(path: str | os.PathLike[str]) -> GoldenRun:
    """A golden file. Raises FlexJointError when it does not exist or is none."""
    source = _parquet(path)
    try:
        table = pa.parquet.read_table(source)
        about = json.loads((table.schema.metadata or {})[KEY])
        if about.pop("schema") != SCHEMA:
            raise FlexJointError(f"{source}: a golden file of another version of flexjoint; record it anew")
        columns = {name: table.column(name).to_numpy().astype(float) for name in table.column_names}
        return GoldenRun(columns.pop("time"), MappingProxyType(columns), About(**about))
    except FileNotFoundError:
        raise FlexJointError(f"golden file {source} does not exist") from None
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, FlexJointError):
            raise
        line = " ".join(str(error).split())[:200]
        raise FlexJointError(f"{source} is no golden file: {line}; record it anew") from None


def _parquet(path: str | os.PathLike[str]) -> Path:
    found = Path(path)
    if found.suffix != ".parquet":
        raise FlexJointError(f"{found}: expected a name that ends in .parquet")
    return found


def _plain(about: About) -> dict[str, Any]:
    return {item.name: _copied(getattr(about, item.name)) for item in fields(About)}


def _copied(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value
