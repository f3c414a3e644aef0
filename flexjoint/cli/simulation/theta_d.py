"""`flexjoint theta-d`: a table of poses in, a table of what holds them out (docs/howto/theta_d.md)."""

from __future__ import annotations

import argparse
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from flexjoint.cli import options
from flexjoint.cli.outputs import check_place
from flexjoint.core.errors import RecordingError, RobotError, unknown
from flexjoint.core.files import write_bytes
from flexjoint.core.limits import RECORDING
from flexjoint.core.messages import escaped, shown
from flexjoint.core.units import of_joint
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import Equilibrium, equilibrium
from flexjoint.model.statics.forces import Contact
from flexjoint.recording.table import read_csv, read_parquet
from flexjoint.report.progress import Progress
from flexjoint.robot.robot import Robot

SUFFIXES = (".csv", ".parquet")
POSITIONS = ("q", "q_ref")  # channels that may hold the poses
TILTS = ("roll", "pitch")  # of a floating base; its place and heading do not matter at rest
SHOWN = 20  # violations that are printed


@dataclass(frozen=True)
class Poses:
    """Link positions q (N, nq), and the table's time (N,) [s] where it has one."""

    q: np.ndarray
    time: np.ndarray | None


def run(arguments: argparse.Namespace) -> None:
    """The command; raises FlexJointError on unusable input, before anything is written."""
    check_place(arguments.out, SUFFIXES, [arguments.poses, Path(arguments.robot)])
    loaded = options.load_chosen(arguments)
    if loaded.floating and not arguments.contact:
        raise RobotError(f"{loaded.name} has a floating base: name what it stands on, e.g. --contact FRAME")
    poses = read_poses(arguments.poses, loaded)
    model = FlexibleJointModel(loaded)
    limit = arguments.max_deflection
    largest = {} if limit is None else {joint.name: limit for joint in loaded.joints}
    contacts = [Contact(frame, pushes=True) for frame in arguments.contact]
    with Progress() as bar:
        rest = equilibrium(
            model, poses.q, contacts, path=arguments.path, max_deflection=largest, progress=bar
        )
    write_bytes(arguments.out, table_bytes(columns(rest, loaded, poses, arguments.details), arguments.out))
    report(rest, loaded, arguments.out)


def read_poses(path: Path, loaded: Robot) -> Poses:
    """The poses of a table. Raises RecordingError that names the column or row."""
    data = _read(path)
    rows = len(next(iter(data.values()), ()))
    if rows == 0:
        raise RecordingError(f"{path} holds no poses; expected columns q.<joint> and one row per pose")
    time = data.pop("time", None)
    if time is not None and np.any(np.diff(time) <= 0.0):
        raise RecordingError(f"{path}: time must increase strictly; sort the table or leave the column out")
    places = _places(loaded)
    q = np.tile(FlexibleJointModel(loaded, []).body.neutral, (rows, 1))
    for name, value in loaded.file.initial.items():
        if name in places:
            q[:, places[name]] = value
    tilts = {f"base.{tilt}": np.zeros(len(q)) for tilt in TILTS} if loaded.floating else {}
    seen: dict[str, str] = {}
    for column, values in data.items():
        if column in tilts:
            tilts[column] = values
            continue
        channel, _, joint = column.partition(".")
        if channel not in POSITIONS:
            valid = [f"{POSITIONS[0]}.{name}" for name in places] + ["time", *tilts]
            raise RecordingError(f"{path}: {unknown('column', column, valid)}")
        if joint not in places:
            raise RecordingError(f"{path}: column {column}: {unknown('joint', joint, places)}")
        if joint in seen:
            raise RecordingError(f"{path}: joint {joint} appears in {seen[joint]} and in {column}; keep one")
        seen[joint] = column
        q[:, places[joint]] = values
    lacking = [name for name in loaded.joint_names if name not in seen]
    if lacking:
        raise RecordingError(
            f"{path}: no column q.{lacking[0]}; every actuated joint needs its position [rad]"
        )
    if loaded.floating:
        q[:, 3:7] = _quaternions(tilts["base.roll"], tilts["base.pitch"])
    return Poses(q, time)


def columns(rest: Equilibrium, loaded: Robot, poses: Poses, details: bool) -> dict[str, np.ndarray]:
    """The table: time where there was one, then of every actuated joint q_ref, theta_ref, tau_ff and tau_t,
    as in a recording; with details also g and phi."""
    out: dict[str, np.ndarray] = {} if poses.time is None else {"time": poses.time}
    places = [joint.idx_q for joint in loaded.joints]
    blocks: dict[str, np.ndarray] = {
        "q_ref": rest.q[:, places],
        "theta_ref": rest.theta,
        "tau_ff": rest.tau_m,
        "tau_t": rest.tau,
    }
    if details:
        blocks |= {"g": rest.gravity, "phi": rest.deflection}
    for channel, values in blocks.items():
        out |= {f"{channel}.{name}": values[:, k] for k, name in enumerate(loaded.joint_names)}
    return out


def table_bytes(data: Mapping[str, np.ndarray], path: Path) -> bytes:
    """CSV or Parquet by the suffix."""
    table = pa.table({name: np.ascontiguousarray(values) for name, values in data.items()})
    sink = io.BytesIO()
    if path.suffix == ".parquet":
        pa.parquet.write_table(table, sink, compression="zstd")
    else:
        pa.csv.write_csv(table, sink)
    return sink.getvalue()


def report(rest: Equilibrium, loaded: Robot, out: Path) -> None:
    """What was written, and the limits that are broken."""
    pose, k = np.unravel_index(int(np.argmax(np.abs(rest.deflection))), rest.deflection.shape)
    name = loaded.joint_names[int(k)]
    unit = of_joint("rad", name in loaded.prismatic)
    print(
        f"wrote {escaped(str(out))}: {len(rest.q)} poses of {len(loaded.joints)} joints; largest deflection"
        f" {rest.deflection[pose, k]:.4g} {unit} ({name}, pose {pose})"
    )
    for violation in rest.violations[:SHOWN]:
        print(f"beyond limits: {violation}")
    if len(rest.violations) > SHOWN:
        print(f"and {len(rest.violations) - SHOWN} more limits")


def _read(path: Path) -> dict[str, np.ndarray]:
    """Columns of numbers without gaps."""
    if not path.is_file():
        raise RecordingError(f"table of poses {path} does not exist; give a .csv or .parquet file")
    try:
        if path.suffix == ".parquet":
            table = read_parquet(path)
        elif path.suffix == ".csv":
            table = read_csv(path)
        else:
            raise RecordingError(
                f"{path}: expected a .csv or .parquet file, got {path.suffix or 'no suffix'}"
            )
        names = table.column_names
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{path} cannot be read as {path.suffix[1:]}: {' '.join(str(error).split())[:200]}"
        ) from None
    if table.num_rows > RECORDING.poses:
        raise RecordingError(
            f"{path} holds {table.num_rows} poses, expected at most {RECORDING.poses}; split the table"
        )
    out: dict[str, np.ndarray] = {}
    for name in names:
        if names.count(name) > 1:
            raise RecordingError(f"{path}: column {name} appears twice; keep one")
        column = table.column(name)
        if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            raise RecordingError(f"{path}: column {name} holds {column.type}, expected numbers")
        values = column.cast(pa.float64()).to_numpy(zero_copy_only=False).astype(float)
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise RecordingError(
                f"{path}: column {name} has no number in row {wrong[0] + 1}; a pose needs all of its numbers"
            )
        largest = float(np.max(np.abs(values), initial=0.0))
        if largest > RECORDING.value:
            raise RecordingError(f"{path}: column {shown(name)} reaches {largest:.3g}; no joint gets there")
        out[name] = values
    return out


def _places(loaded: Robot) -> dict[str, int]:
    """Places in q of the joints with one position."""
    model = loaded.model
    joints = [(str(model.names[k]), model.joints[k]) for k in range(1, model.njoints)]
    return {name: joint.idx_q for name, joint in joints if joint.nq == 1}


def _quaternions(roll: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """(N, 4) x, y, z, w of R_y(pitch) R_x(roll)."""
    sr, cr, sp, cp = np.sin(roll / 2), np.cos(roll / 2), np.sin(pitch / 2), np.cos(pitch / 2)
    return np.stack([cp * sr, sp * cr, -sp * sr, cp * cr], axis=1)
