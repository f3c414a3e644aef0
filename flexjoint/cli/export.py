"""`flexjoint export`: a robot for another simulator, with what that cannot express, and what it costs."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from flexjoint.cli.options import load_chosen, mapping_of
from flexjoint.cli.outputs import check_place, print_table
from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.messages import escaped
from flexjoint.diagnosis.comparison.compare import Comparison, compared
from flexjoint.diagnosis.result.wording import clean, number, unit_of
from flexjoint.export.base import lines
from flexjoint.export.mujoco_run import MujocoRun
from flexjoint.export.targets import Exported, exported, find
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.checks import check
from flexjoint.recording.clock import on_regular_clock
from flexjoint.recording.currents import with_torques
from flexjoint.recording.importing import read
from flexjoint.robot.robot import Robot
from flexjoint.simulation.simulate import torque_channel

WIDTH = 100  # of a line
POSITIONS = ("q", "dq", "theta", "dtheta")  # channels that both simulations have


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    target, out = find(arguments.to), arguments.out
    inputs = [Path(arguments.robot), arguments.measure, arguments.mapping]
    check_place(out, target.suffixes, [path for path in inputs if path is not None])
    if arguments.measure is not None and target.name != "mjcf":
        raise FlexJointError(f"--measure runs MuJoCo, and {target.name} is not its file; use --to mjcf")
    robot = load_chosen(arguments)
    if robot.urdf is not None and out.exists() and out.samefile(robot.urdf):
        raise FlexJointError(f"cannot write {out}: it is the robot's own description; give another name")
    done = exported(robot, target.name)
    loss = _loss(arguments, robot, done) if arguments.measure is not None else None
    done.write(out)
    for line in lines(done.account):
        print(textwrap.fill(clean(line), WIDTH, subsequent_indent="      "))
    if loss is not None:
        print()
        print_table(Console(), *loss)
    print(f"wrote {escaped(str(out))}: {robot.name} for {target.title}")


def _loss(
    arguments: argparse.Namespace, robot: Robot, done: Exported
) -> tuple[Sequence[str], Sequence[Sequence[str]]]:
    """What the export costs, by channel: MuJoCo against our simulation, and that against the recording."""
    recording = read(arguments.measure, mapping_of(arguments), robot).recording
    check(robot, recording)
    model = FlexibleJointModel(robot)
    mujoco = MujocoRun(done.text, model)
    recording = with_torques(robot, on_regular_clock(recording))
    if torque_channel(recording, robot.joint_names) is None:
        raise RecordingError(
            f"{recording.name}: expected tau_m or tau_motor of every joint, which drive both simulations;"
            " record them, or leave --measure out"
        )
    ours = compared(model, recording, arguments.horizon, engine=arguments.engine)
    theirs = compared(model, recording, arguments.horizon, rollout=mujoco.rollout)
    heads = (
        f"{clean(recording.name)}, {ours.windows} windows of {ours.horizon:g} s",
        "MuJoCo against flexjoint",
        "flexjoint against recording",
    )
    found = differences(ours, theirs)
    rows = []
    for name, rms in found.items():
        channel, _, joint = name.partition(".")
        unit = unit_of(channel, joint in robot.prismatic)
        rows.append((clean(name), f"{number(rms)} {unit}", f"{number(ours.rms[name])} {unit}"))
    return heads, rows


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
