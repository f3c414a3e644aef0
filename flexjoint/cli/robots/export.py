"""`flexjoint export`: a robot for another simulator, with what that cannot express, and what it costs."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from flexjoint.cli.options import load_chosen, mapping_of
from flexjoint.cli.outputs import check_place, print_table
from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.messages import escaped
from flexjoint.diagnosis.comparison.compare import Comparison, compared
from flexjoint.diagnosis.result.wording import clean, number, unit_of
from flexjoint.effects import Planned
from flexjoint.export.base import Level, lines
from flexjoint.export.mujoco_run import MujocoRun
from flexjoint.export.targets import Exported, exported, find
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.checks import check
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.importing import read
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot
from flexjoint.simulation.options import Engine
from flexjoint.simulation.simulate import torque_channel

WIDTH = 100  # of a line
Columns = tuple[Sequence[str], Sequence[Sequence[str]]]  # heads and rows of a table
POSITIONS = ("q", "dq", "theta", "dtheta")  # channels that both simulations have


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    target, out = find(arguments.to), arguments.out
    inputs = [Path(arguments.robot), arguments.measure, arguments.mapping]
    check_place(out, target.suffixes, [path for path in inputs if path is not None])
    if arguments.measure is not None and target.name != "mjcf":
        raise FlexJointError(f"--measure runs MuJoCo, and {target.name} is not its file; use --to mjcf")
    if not arguments.horizon > 0.0:
        raise FlexJointError(f"--horizon: expected seconds above 0, got {arguments.horizon:g}; give e.g. 0.5")
    robot = load_chosen(arguments)
    if robot.urdf is not None and out.exists() and out.samefile(robot.urdf):
        raise FlexJointError(f"cannot write {out}: it is the robot's own description; give another name")
    done = exported(robot, target.name)
    tables = _losses(arguments, robot, done) if arguments.measure is not None else ()
    done.write(out)
    for line in lines(done.account):
        print(textwrap.fill(clean(line), WIDTH, subsequent_indent="      "))
    for table in tables:
        print()
        print_table(Console(), *table)
    print(f"wrote {escaped(str(out))}: {robot.name} for {target.title}")


# --- what an export costs -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Windows:
    """A recording, and the two simulations of it in windows."""

    robot: Robot
    recording: Recording
    horizon: float
    engine: Engine

    def ours(self, effects: Sequence[Planned], engine: Engine | None = None) -> Comparison:
        model = FlexibleJointModel(self.robot, effects)
        return compared(model, self.recording, self.horizon, engine=engine or self.engine)

    def theirs(self, effects: Sequence[Planned]) -> Comparison:
        """In MuJoCo, of the file that these effects make; effects on readings act as in ours."""
        model = FlexibleJointModel(self.robot, effects)
        done = exported(replace(self.robot, effects=tuple(effects)), "mjcf")
        return compared(model, self.recording, self.horizon, rollout=MujocoRun(done.text, model).rollout)


def _losses(arguments: argparse.Namespace, robot: Robot, done: Exported) -> list[Columns]:
    """What the export costs, by channel, and what each effect costs that is not exact."""
    recording = read(arguments.measure, mapping_of(arguments), robot).recording
    check(robot, recording)
    recording = of_robot(robot, on_regular_clock(recording))
    if torque_channel(recording, robot.joint_names) is None:
        raise RecordingError(
            f"{recording.name}: expected tau_m or tau_motor of every joint, which drive both simulations;"
            " record them, or leave --measure out"
        )
    windows = _Windows(robot, recording, arguments.horizon, arguments.engine)
    ours = windows.ours(robot.effects)
    return [_by_channel(windows, ours), *_by_effect(windows, done, ours)]


def _by_channel(windows: _Windows, ours: Comparison) -> Columns:
    """MuJoCo against our simulation, and that against the recording."""
    heads = (
        f"{clean(Path(windows.recording.name).name)}, {ours.windows} windows of {ours.horizon:g} s",
        "MuJoCo against flexjoint",
        "flexjoint against recording",
    )
    apart = differences(ours, windows.theirs(windows.robot.effects))
    rows = [
        (clean(name), _with_unit(rms, name, windows.robot), _with_unit(ours.rms[name], name, windows.robot))
        for name, rms in apart.items()
    ]
    return heads, rows


def _by_effect(windows: _Windows, done: Exported, ours: Comparison) -> Iterator[Columns]:
    """The largest error of a position for the exact effects together, for each near one added to these, and
    for our simulation without each that is not expressible."""
    effects = windows.robot.effects
    levels = {(row.what, row.joint): row.way.level for row in done.account}
    exact = [e for e in effects if levels[e.key] is Level.EXACT]
    rest = {e.effect.name: levels[e.key] for e in effects if levels[e.key] is not Level.EXACT}
    if not rest:
        return
    rows = [("all that is exact", str(Level.EXACT), _worst(windows, windows.ours(exact, "pin"), exact))]
    for name, level in rest.items():
        if level is Level.NEAR:
            added = [e for e in effects if e in exact or e.effect.name == name]
            rows.append((f"... and {name}", str(level), _worst(windows, windows.ours(added, "pin"), added)))
        else:
            left = windows.ours([e for e in effects if e.effect.name != name], "pin")
            rows.append((f"without {name}", str(level), _largest(windows.robot, differences(ours, left))))
    yield ("largest RMS error of a position", "", ""), rows


def _worst(windows: _Windows, ours: Comparison, effects: Sequence[Planned]) -> str:
    return _largest(windows.robot, differences(ours, windows.theirs(effects)))


def _largest(robot: Robot, apart: Mapping[str, float]) -> str:
    at = {name: rms for name, rms in apart.items() if name.startswith(("q.", "theta."))}
    name = max(at, key=lambda key: at[key])
    return f"{_with_unit(at[name], name, robot)} ({clean(name)})"


def _with_unit(rms: float, name: str, robot: Robot) -> str:
    channel, _, joint = name.partition(".")
    return f"{number(rms)} {unit_of(channel, joint in robot.prismatic)}"


def differences(ours: Comparison, theirs: Comparison) -> dict[str, float]:
    """RMS difference of two simulations of a recording, by channel and joint as `compare` has them."""
    apart = {
        key: theirs.simulated[key] - values for key, values in ours.simulated.items() if key[0] in POSITIONS
    }
    out = {}
    for (channel, joint), difference in apart.items():
        out[f"{channel}.{joint}"] = _rms(difference)
        if channel == "theta" and ("q", joint) in apart:
            phi = difference - apart["q", joint]
            out[f"phi.{joint}"] = _rms(phi - np.nanmean(phi))
    return out


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
