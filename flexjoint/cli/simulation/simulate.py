"""`flexjoint simulate`: a robot along a reference, as a recording."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from flexjoint.cli.options import budget_from, load_chosen
from flexjoint.cli.outputs import check_place
from flexjoint.core.messages import escaped
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording import table as recording
from flexjoint.recording.checks import check_joints
from flexjoint.recording.table import Recording
from flexjoint.report.progress import Progress
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.runs.pieces import simulated_in_pieces
from flexjoint.simulation.schemes import DEFAULT


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError on unusable input, before anything is written."""
    budget = budget_from(arguments)
    check_place(arguments.out, (".csv", ".parquet"), [arguments.reference, Path(arguments.robot)])
    robot = load_chosen(arguments)
    reference = recording.read(arguments.reference)
    check_joints(robot, reference)
    how = RunOptions(scheme=arguments.scheme or DEFAULT, width=arguments.width, engine=arguments.engine)
    done, end = 0.0, float(reference.time[0])
    with Progress() as bar:

        def pieces() -> Iterator[Recording]:
            nonlocal done, end
            for piece in simulated_in_pieces(
                FlexibleJointModel(robot), reference, how, progress=bar, budget=budget
            ):
                done, end = piece.done, float(piece.measured.time[-1])
                yield piece.measured

        recording.write_pieces(pieces(), arguments.out)
    seconds = end - float(reference.time[0])
    short = f" of {reference.duration:.4g} s, for the time allowed was over" if done < 1.0 else " s"
    print(f"wrote {escaped(str(arguments.out))}: {seconds:.4g}{short} of {', '.join(robot.joint_names)}")
