"""The targets of an export, by name, and the table of what each carries."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from flexjoint.core.errors import unknown
from flexjoint.core.files import check_suffix, write_text
from flexjoint.effects import catalogue
from flexjoint.export.base import NUMBERS, Level, Row, Target, lines
from flexjoint.export.drake import Drake
from flexjoint.export.isaaclab import IsaacLab
from flexjoint.export.mjcf import Mjcf
from flexjoint.export.ros2_control import Ros2Control
from flexjoint.export.sdf import Sdf
from flexjoint.export.subject import Subject
from flexjoint.export.urdf import Urdf
from flexjoint.model.springs import sprung
from flexjoint.robot import robot as robots
from flexjoint.robot.robot import Robot

TARGETS: Mapping[str, Target] = {
    target.name: target for target in (Mjcf(), Urdf(), Sdf(), IsaacLab(), Drake(), Ros2Control())
}
BEGIN, END = "<!-- table: written by make docs -->\n", "<!-- end of the table -->\n"


@dataclass(frozen=True)
class Exported:
    """A robot as a target's file: its text, and how well each number and effect is carried."""

    target: Target
    text: str
    account: tuple[Row, ...]

    def __str__(self) -> str:
        return "\n".join(lines(self.account))

    @property
    def lost(self) -> tuple[Row, ...]:
        """What the file does not hold."""
        return tuple(row for row in self.account if row.way.level is Level.NONE)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or not at all."""
        out = Path(path)
        check_suffix(out, self.target.suffixes)
        write_text(out, self.text)


def find(name: str) -> Target:
    """The target of that name; UnknownNameError lists the valid ones."""
    if name not in TARGETS:
        raise unknown("target of an export", name, TARGETS)
    return TARGETS[name]


def exported(robot: Robot, target: str) -> Exported:
    """A robot, with the effects that it lists, as the file of a target.

    Raises UnknownNameError for an unknown target, RobotError for a robot that no such file holds.
    """
    robot, others = sprung(robots.expect(robot, "export_robot"), robot.effects)
    robot, found = replace(robot, effects=others), find(target)
    effects = [e for e in robot.effects if found.judge(robot, e).level is not Level.NONE]
    account = found.account(robot)
    return Exported(found, found.write(Subject(robot, tuple(effects)), account), account)


def export_robot(robot: Robot, target: str, out: str | os.PathLike[str]) -> Exported:
    """Write a robot, with the effects that it lists, for another simulator.

    Args:
        robot: what `load_robot` or `diagnosis.extend` gives.
        target: mjcf, urdf, sdf, isaaclab, drake or ros2_control (docs/reference/exporting.md).
        out: the file; its name ends as such a target's does.

    Returns what was written, with how well each number and effect of the robot is carried. Raises
    UnknownNameError for an unknown target, RobotError for a robot that no such file holds, FlexJointError
    where the file cannot be written.
    """
    check_suffix(Path(out), find(target).suffixes)
    done = exported(robot, target)
    done.write(out)
    return done


# --- the table of docs/reference/exporting.md --------------------------------------------------------------
def table() -> str:
    """Every number and effect, and how well each target carries it, as Markdown."""
    return "\n".join(_table()) + "\n"


def page(text: str) -> str:
    """A page with the table as it is now."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.split(END)[1]}"


def _table() -> Iterator[str]:
    names = list(TARGETS)
    yield f"| | {' | '.join(names)} |"
    yield "|---" * (len(names) + 1) + "|"
    for what in NUMBERS:
        levels = " | ".join(str(target.of_number(what).level) for target in TARGETS.values())
        yield f"| {what.replace('_', ' ')} | {levels} |"
    for effect in catalogue():
        levels = " | ".join(str(target.of_effect(effect).level) for target in TARGETS.values())
        yield f"| `{effect}` | {levels} |"
    for target in TARGETS.values():
        yield ""
        yield f"### {target.name}: {target.title}"
        yield ""
        yield "| | | by what, or why not |"
        yield "|---|---|---|"
        for what in NUMBERS:
            way = target.of_number(what)
            yield f"| {what.replace('_', ' ')} | {way.level} | {way.how} |"
        for effect in catalogue():
            way = target.of_effect(effect)
            yield f"| `{effect}` | {way.level} | {way.how} |"
