"""Options that commands share: the robot (--robot, --sections, --preset, --grounded) and the engine."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from flexjoint.core.errors import RobotError

if TYPE_CHECKING:
    from flexjoint.robot.robot import Robot

ENGINES = ("auto", "compiled", "pin")  # those of flexjoint.simulation.options, which takes long to import


def add_robot(parser: argparse.ArgumentParser) -> None:
    """The options that choose a robot."""
    parser.add_argument(
        "--robot", required=True, metavar="R.yaml", help="robot file, or the name of a shipped robot"
    )
    parser.add_argument(
        "--sections",
        metavar="NAME[,NAME...]",
        help="what of the robot is there, e.g. torso,arms (default: all of it)",
    )
    parser.add_argument("--preset", metavar="NAME", help="a set of numbers of the robot file, e.g. soft")
    parser.add_argument("--grounded", action="store_true", help="fix a floating base")


def add_engine(parser: argparse.ArgumentParser) -> None:
    """The option that chooses what runs a simulation."""
    parser.add_argument(
        "--engine",
        choices=ENGINES,
        default=ENGINES[0],
        help="what simulates: as C, or by the pin loop in Python (docs/performance.md); default auto",
    )


def load_chosen(arguments: argparse.Namespace, actuated: bool = True) -> Robot:
    """The robot that the options choose; a section that is left out because what it hangs on is not there is
    named on standard error. Raises RobotError where nothing is actuated and something has to be."""
    from flexjoint.robot.description import is_one
    from flexjoint.robot.robot import load

    if actuated and is_one(arguments.robot):
        name = Path(arguments.robot).name
        raise RobotError(
            f"{name} is a description and says nothing of springs and motors; write a robot file for it"
            f" (docs/formats.md), or use it in Python: load_robot({name!r}, stiffness=...)"
        )
    sections = None
    if arguments.sections is not None:
        sections = [name.strip() for name in arguments.sections.split(",") if name.strip()]
    chosen = load(arguments.robot, sections, arguments.preset, arguments.grounded)
    if chosen.disabled:
        print(
            f"flexjoint: {chosen.name} without {', '.join(chosen.disabled)}: what they hang on is not there",
            file=sys.stderr,
        )
    if actuated and not chosen.joints:
        raise RobotError(
            f"{chosen.name} with {', '.join(chosen.sections)} alone has no actuated joint; add sections"
        )
    return chosen
