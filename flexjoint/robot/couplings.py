"""Motors that several joints share: differentials, belts, wrists whose drives run through one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import RobotError, unknown
from flexjoint.core.messages import shown
from flexjoint.robot.schema import CouplingEntry

WORST_CONDITION = 1e6  # of a matrix: beyond it a joint's torque would be the difference of large ones


@dataclass(frozen=True)
class Coupling:
    """How some motors turn with some joints: m = N theta, and torques at the joints are N' those of the
    motors.

    `joints` (k,) are places among the actuated joints, `matrix` N (k, k) by rows: row r belongs to the motor
    of the r-th of them, in that motor's position seen at its joint."""

    joints: tuple[int, ...]
    matrix: tuple[tuple[float, ...], ...]

    @property
    def inverse(self) -> np.ndarray:
        """(k, k) theta = inverse m; torques of the motors are inverse' those at the joints."""
        return np.linalg.inv(np.array(self.matrix))


def read(
    entries: Sequence[CouplingEntry],
    names: Sequence[str],
    rigid: Sequence[bool],
    absent: Sequence[str],
    where: str,
) -> tuple[Coupling, ...]:
    """The couplings between the actuated joints `names`, of which some are rigid; those of joints that are
    all `absent` (their section is left out) are left out, too.

    Raises RobotError with what was expected, what came and what to do.
    """
    out: list[Coupling] = []
    taken: set[str] = set()
    for entry in entries:
        listed = shown(", ".join(entry.joints))
        for name in entry.joints:
            if name not in names and name not in absent:
                raise RobotError(f"{where}: couplings: {unknown('joint', name, names)}")
            if name in taken or entry.joints.count(name) > 1:
                raise RobotError(
                    f"{where}: couplings: joint '{shown(name)}' is listed twice; put all joints that move"
                    " together into one coupling"
                )
        taken.update(entry.joints)
        missing = [name for name in entry.joints if name in absent]
        if missing:
            if len(missing) < len(entry.joints):
                raise RobotError(
                    f"{where}: couplings: {listed}: the section of '{shown(missing[0])}' is left out; leave"
                    " out all joints of a coupling or none"
                )
            continue
        places = tuple(names.index(name) for name in entry.joints)
        if len({rigid[i] for i in places}) > 1:
            raise RobotError(
                f"{where}: couplings: {listed}: expected joints that are all rigid or all flexible; give each"
                " a stiffness, or .inf to each"
            )
        out.append(Coupling(places, _checked(entry.matrix, len(places), listed, where)))
    return tuple(out)


def _checked(
    rows: Sequence[Sequence[float]], size: int, listed: str, where: str
) -> tuple[tuple[float, ...], ...]:
    """The rows of a matrix that has an inverse."""
    if size < 2 or len(rows) != size or any(len(row) != size for row in rows):
        raise RobotError(
            f"{where}: couplings: {listed}: expected two joints or more and a square matrix, a row for each"
            f" joint's motor and a column for each joint; got {size} joints and rows of"
            f" {[len(row) for row in rows][:8]}"
        )
    matrix = np.array(rows, dtype=float)
    if not (np.all(np.isfinite(matrix)) and 1.0 / max(np.linalg.cond(matrix), 1.0) > 1.0 / WORST_CONDITION):
        raise RobotError(
            f"{where}: couplings: {listed}: expected a matrix that has an inverse, so that the motors'"
            f" positions tell the joints'; got {shown(str(matrix.tolist()))}"
        )
    return tuple(tuple(float(x) for x in row) for row in matrix)
