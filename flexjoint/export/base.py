"""What a target of an export is: its file, and how well it carries each effect of the catalogue.

A target maps effects by name. One that it does not map is left out of the file and named as not expressible:
a new effect is never carried over by accident, nor lost without a word. The robot's own numbers are mapped
alike, and LEFT_OUT says once what holds for most targets.
"""

from __future__ import annotations

import enum
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from flexjoint.effects import Planned, Site, find
from flexjoint.export.subject import Subject
from flexjoint.robot.robot import Robot


class Level(enum.StrEnum):
    """How well a target carries something."""

    EXACT = "exact"  # the difference of the two simulations shrinks with their steps
    NEAR = "near"
    NONE = "not expressible"


@dataclass(frozen=True)
class Way:
    """How a target carries an effect, or a number of the robot: how well, and by what or why not."""

    level: Level
    how: str


def exact(how: str) -> Way:
    return Way(Level.EXACT, how)


def near(how: str) -> Way:
    return Way(Level.NEAR, how)


def absent(why: str) -> Way:
    return Way(Level.NONE, why)


UNMAPPED = absent("this export has no mapping for it")
LATER = "a file holds what is always there, and this sets in later"
ALONE = "its motor turns several joints, and in the file this one alone"


@dataclass(frozen=True)
class Row:
    """One line of the account of an export: what of the robot, on which joint (None: the whole robot)."""

    what: str
    joint: str | None
    way: Way


NUMBERS = {  # what a robot has beside effects, and when it does
    "spring": lambda robot: any(not joint.rigid for joint in robot.joints),
    "motor_inertia": lambda robot: any(joint.drive.B > 0.0 for joint in robot.joints),
    "motor_damping": lambda robot: any(joint.drive.D_m > 0.0 for joint in robot.joints),
    "torque_limit": lambda robot: any(joint.torque_limit < float("inf") for joint in robot.joints),
    "controller": lambda robot: any(joint.kp > 0.0 or joint.kd > 0.0 for joint in robot.joints),
    "sensing_delay": lambda robot: robot.file.sensing_delay > 0.0,
    "gravity": lambda robot: True,
    "contacts": lambda robot: bool(robot.contacts),
    "couplings": lambda robot: bool(robot.couplings),
}
LEFT_OUT = {  # of NUMBERS, what a file does not hold unless its target says so
    "spring": absent("joints are rigid there"),
    "contacts": absent("no collision shapes are written"),
    "couplings": absent(
        "each motor turns one joint there: inertia and friction that motors share act on one each"
    ),
}


def coupled(robot: Robot) -> set[str]:
    """The joints whose motors turn with others, too."""
    return {robot.joint_names[i] for coupling in robot.couplings for i in coupling.joints}


def _on_a_motor(planned: Planned) -> bool:
    return planned.effect.site in (Site.COMMAND, Site.MOTOR)


def lines(account: Sequence[Row]) -> Iterator[str]:
    """The account as text, by level; what is carried alike on several joints is one line."""
    for level in Level:
        alike: dict[tuple[str, str], list[str]] = {}
        for row in account:
            if row.way.level is level:
                alike.setdefault((row.what, row.way.how), []).extend([row.joint] if row.joint else [])
        if alike:
            yield f"{level}:"
        for (what, how), joints in alike.items():
            where = f" on {', '.join(joints)}" if joints else ""
            yield f"  {what}{where}: {how}"


class Target(ABC):
    """A simulator's file."""

    name: ClassVar[str]  # as --to takes it
    title: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    numbers: ClassVar[Mapping[str, Way]]  # by the keys of NUMBERS; LEFT_OUT has what is not here
    effects: ClassVar[Mapping[str, Way]]  # by the names of the catalogue

    def of_number(self, name: str) -> Way:
        """How well it carries a number of the robot, by its key in NUMBERS."""
        return self.numbers.get(name, LEFT_OUT.get(name, UNMAPPED))

    def of_robots(self, robot: Robot, name: str) -> Way:
        """How well it carries a number of this robot: as `of_number`, or less."""
        return self.of_number(name)

    def of_effect(self, name: str) -> Way:
        """How well it carries an effect of the catalogue, at best."""
        if find(name).for_rigid:  # its joint is exported with the spring that it makes
            return self.of_number("spring")
        return self.effects.get(name, UNMAPPED)

    def judge(self, robot: Robot, planned: Planned) -> Way:
        """How well it carries this effect of this robot: as `of_effect`, or less."""
        if planned.since is not None:
            return absent(LATER)
        way = self.of_effect(planned.effect.name)
        lost = way.level is Level.EXACT and self.of_robots(robot, "couplings").level is Level.NONE
        return near(ALONE) if lost and _on_a_motor(planned) and planned.joint in coupled(robot) else way

    def account(self, robot: Robot) -> tuple[Row, ...]:
        """How well it carries what this robot has: its numbers, then its effects in their order."""
        own = [Row(what, None, self.of_robots(robot, what)) for what, has in NUMBERS.items() if has(robot)]
        return (*own, *(Row(e.effect.name, e.joint, self.judge(robot, e)) for e in robot.effects))

    @abstractmethod
    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        """The file's text, with the account in its comments. Raises RobotError for what it cannot hold."""
