"""The torque error of every joint, before and after, on data that the fit did not see."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.result import torque
from flexjoint.report.material import Material

ROWS = 60


@dataclass(frozen=True)
class TorquesSection:
    table: torque.Table
    named: bool  # else `after` is the nominal model within its tolerances
    reading: str


def build(material: Material) -> TorquesSection | None:
    diagnosis = material.diagnosis
    table = torque.table(diagnosis, material.joints, ROWS)
    if table is None:
        return None
    return TorquesSection(table, bool(diagnosis.findings), torque.reading(diagnosis))
