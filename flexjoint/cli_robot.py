"""The robot as the commands take it: --robot, --sections, --preset, --grounded; and the list of robots."""

from __future__ import annotations

import argparse
import sys
import textwrap
from typing import TYPE_CHECKING

from flexjoint.errors import RobotError

if TYPE_CHECKING:
    from flexjoint.robot import Robot

WIDTH = 110
MANY = 12  # joints; more are counted, not listed
ENGINES = ("auto", "compiled", "pin")  # those of flexjoint.engine, which takes long to import


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that choose a robot."""
    parser.add_argument(
        "--robot", required=True, metavar="R.yaml", help="robot YAML, or the name of a shipped robot"
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
    from flexjoint.robot import load

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


def show_robots() -> None:
    """Print the robots that come with flexjoint."""
    from flexjoint.robot import load, shipped_robots

    for name, path in shipped_robots().items():
        robot = load(path)
        recordings = sorted((path.parent / "recordings").glob("*.parquet"))
        base = ", floating base" if robot.floating else ""
        joints = (
            ", ".join(robot.joint_names)
            if len(robot.joints) <= MANY
            else f"{len(robot.joints)} joints{base}, {robot.mass:.4g} kg"
        )
        held = f"; recordings {', '.join(r.stem for r in recordings)}" if recordings else ""
        print(f"{name}: {joints}{held}")
        for head, names in (
            ("sections", _sections(robot)),
            ("presets", list(robot.file.presets)),
            ("poses", list(robot.poses) if robot.file.poses else []),
        ):
            if names:
                text = f"{head}: {', '.join(names)}"
                print(textwrap.fill(text, WIDTH, initial_indent="    ", subsequent_indent="        "))
        assumed = [key for key, text in robot.file.sources.items() if "ASSUMPTION" in str(text)]
        if assumed:
            print(f"    assumed (see sources in the file): {', '.join(assumed)}")
        print(f"    {path}")


def _sections(robot: Robot) -> list[str]:
    return [
        f"{name} ({', '.join(section.parts)})" if section.parts else name
        for name, section in robot.file.sections.items()
    ]
