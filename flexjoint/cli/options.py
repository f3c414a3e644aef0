"""Options that commands share: the robot (--robot, --sections, --preset, --grounded), the engine, and what is
stated of a log (--mapping, --degrees, --gear, ...)."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from flexjoint.core.errors import RobotError
from flexjoint.core.running.budget import UNLIMITED, Budget, budget_of

if TYPE_CHECKING:
    from flexjoint.recording.logs.mapping import MappingFile
    from flexjoint.robot.robot import Robot

ENGINES = ("auto", "compiled", "pin")  # those of flexjoint.simulation.options, which takes long to import


def add_robot(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """The options that choose a robot."""
    parser.add_argument(
        "--robot", required=required, metavar="R.yaml", help="robot file, or the name of a shipped robot"
    )
    add_choice(parser)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """The options that choose what of a robot is there."""
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
        help="what simulates: as C, or by the pin loop in Python (docs/explained/performance.md);"
        " default auto",
    )


def add_budget(parser: argparse.ArgumentParser) -> None:
    """The option that bounds how long the work takes."""
    parser.add_argument(
        "--budget",
        metavar="TIME",
        help="time that it may take, such as 60s or 5min; it then says what it did not look at",
    )


def budget_from(arguments: argparse.Namespace) -> Budget:
    """The time that the command may take, from now on. Raises FlexJointError."""
    return UNLIMITED if arguments.budget is None else budget_of(arguments.budget)


def add_mapping(parser: argparse.ArgumentParser) -> None:
    """The option that maps another program's log to the channels of a recording."""
    parser.add_argument(
        "--mapping",
        type=Path,
        metavar="MAP.yaml",
        help="what the log's signals are, where its format does not say it (docs/reference/formats.md)",
    )


def add_log(parser: argparse.ArgumentParser) -> None:
    """The options that state what a log leaves open."""
    add_mapping(parser)
    angles = parser.add_mutually_exclusive_group()
    angles.add_argument("--degrees", action="store_true", help="angles are in degrees")
    angles.add_argument("--radians", action="store_true", help="angles are in radians")
    parser.add_argument(
        "--gear", type=_numbers, metavar="N[,N...]", help="rotor turns per turn of the joint, or one a joint"
    )
    parser.add_argument(
        "--torque-constant", type=_numbers, metavar="K[,K...]", help="of the rotor [N m/A], for currents"
    )
    parser.add_argument(
        "--joints", metavar="NAME,NAME...", help="joints in the order of the log's columns, if it names none"
    )
    parser.add_argument(
        "--encoder", choices=("motor", "link"), help="side of encoders that the log leaves open"
    )
    parser.add_argument("--episode", type=int, metavar="N", help="of a LeRobot dataset")


def mapping_of(arguments: argparse.Namespace) -> MappingFile | None:
    """The mapping file with what the options state; None where neither is given. Raises RecordingError."""
    from flexjoint.recording.logs.mapping import EMPTY, read, stated

    file = read(arguments.mapping) if arguments.mapping is not None else EMPTY
    if not hasattr(arguments, "degrees"):
        return file if arguments.mapping is not None else None
    names = arguments.joints.split(",") if arguments.joints is not None else None
    file = stated(
        file,
        angles="deg" if arguments.degrees else "rad" if arguments.radians else None,
        gear_ratio=arguments.gear,
        torque_constant=arguments.torque_constant,
        joints=tuple(name.strip() for name in names) if names is not None else None,
        encoder=arguments.encoder,
        episode=arguments.episode,
    )
    return file if file != EMPTY else None


def _numbers(text: str) -> float | tuple[float, ...]:
    """One number, or several between commas."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected numbers between commas, got {text!r}") from None
    return values[0] if len(values) == 1 else values


def load_chosen(arguments: argparse.Namespace, actuated: bool = True) -> Robot:
    """The robot that the options choose; a section that is left out because what it hangs on is not there is
    named on standard error. Raises RobotError where nothing is actuated and something has to be."""
    from flexjoint.robot import ready_made
    from flexjoint.robot.description import is_one
    from flexjoint.robot.robot import load

    if actuated and (is_one(arguments.robot) or ready_made.is_name(arguments.robot)):
        name = Path(arguments.robot).name
        raise RobotError(
            f"{name} is a description and says nothing of springs and motors; write a robot file for it with"
            f" `flexjoint init {arguments.robot}`, or use it in Python: load_robot({name!r}, stiffness=...)"
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
