"""What a diagnosis says: its values, its summary in words, its JSON, and the robot that it extends."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from flexjoint.core.errors import unknown
from flexjoint.core.files import check_suffix, write_json
from flexjoint.core.text import as_html, plain
from flexjoint.diagnosis.result.summary import summary
from flexjoint.diagnosis.result.values import (
    Action,
    Agreement,
    Column,
    DataFinding,
    Estimation,
    Finding,
    Fitted,
    Gain,
    Learned,
    LearnedLaw,
    LeftOut,
    Likeness,
    Ranked,
    Remaining,
    Removed,
    Repeated,
    ResidualView,
    Result,
    Section,
    Shown,
    Step,
    Tie,
    Unexplained,
    Verdict,
    WithinTolerance,
    data_to_json,
    to_json,
)
from flexjoint.robot.robot import Robot, expect

LEAST = (
    0.5  # probability of a cause that enters the extended model: below, it is more likely wrong than right
)


@dataclass(frozen=True)
class Diagnosis(Result):
    """The result of `diagnose`: printed, it is the summary that the terminal shows."""

    def __str__(self) -> str:
        return plain(summary(self))

    def _repr_html_(self) -> str:
        return as_html(summary(self))

    def likely(self, least: float = LEAST) -> tuple[Finding, ...]:
        """The causes with at least this probability."""
        return tuple(finding for finding in self.findings if finding.probability >= least)

    def extend(self, robot: Robot, least: float = LEAST, numbers: bool = False) -> Robot:
        """The robot with the causes in its model that are at least as probable as `least`; 0 takes all. Laws
        that were learned (`flexjoint.learn`) come in where the causes are those beside which they were: the
        likely ones. Beside others they would explain the same error twice. With `numbers` the nominal numbers
        that are told to be off by less than their tolerance (`within_tolerance`) are changed, too: no
        finding, but a simulation is the better for them.

        Raises RobotError of what is no robot, UnknownNameError of a robot without a cause's joint.
        """
        robot = expect(robot, "extend")
        effects = [e for finding in self.likely(least) for e in (finding.members or (finding.planned,))]
        if self.learned is not None and self.likely(least) == self.likely(LEAST):
            effects += [law.planned for law in self.learned.laws]
        for item in effects:
            if item.joint is not None and item.joint not in robot.joint_names:
                raise unknown("joint", item.joint, robot.joint_names)
        extended = robot.extended(effects)
        for off in self.within_tolerance if numbers else ():
            extended = extended.extended([off.applied(extended.effects)])
        return extended

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the diagnosis as JSON (docs/reference/formats.md), whole or not at all."""
        out = Path(path)
        check_suffix(out, (".json",))
        write_json(out, to_json(self))


__all__ = [
    "LEAST",
    "Action",
    "Agreement",
    "Column",
    "DataFinding",
    "Diagnosis",
    "Estimation",
    "Finding",
    "Fitted",
    "Gain",
    "Learned",
    "LearnedLaw",
    "LeftOut",
    "Likeness",
    "Ranked",
    "Remaining",
    "Removed",
    "Repeated",
    "ResidualView",
    "Result",
    "Section",
    "Shown",
    "Step",
    "Tie",
    "Unexplained",
    "Verdict",
    "WithinTolerance",
    "data_to_json",
    "to_json",
]
