"""`flexjoint simulate`: a robot along a reference, as a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from flexjoint.cli.options import load_chosen
from flexjoint.cli.outputs import check_place
from flexjoint.core.messages import escaped
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.checks import check_joints
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.schemes import DEFAULT
from flexjoint.simulation.simulate import simulate


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    check_place(arguments.out, (".csv", ".parquet"), [arguments.reference, Path(arguments.robot)])
    robot = load_chosen(arguments)
    reference = recording.read(arguments.reference)
    check_joints(robot, reference)
    how = RunOptions(scheme=arguments.scheme or DEFAULT, width=arguments.width, engine=arguments.engine)
    result = simulate(FlexibleJointModel(robot), reference, how).measured
    result.write(arguments.out)
    print(f"wrote {escaped(str(arguments.out))}: {result.duration:.4g} s of {', '.join(result.joints)}")
