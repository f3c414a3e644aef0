"""The top of the page: the three statements, and the torque and simulation errors in figures."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexjoint.diagnosis.result import merit, sentences, torque
from flexjoint.diagnosis.result.wording import capital, clean, percent, sentence
from flexjoint.report.material import Material


@dataclass(frozen=True)
class Tile:
    value: str
    label: str
    accent: bool = False


@dataclass(frozen=True)
class VerdictSection:
    verdict: str
    word: str
    statements: tuple[sentences.Statement, ...]
    reason: str
    tiles: tuple[Tile, ...]


def build(material: Material) -> VerdictSection:
    diagnosis = material.diagnosis
    refused = diagnosis.verdict == "refused"
    shown = diagnosis.verdict == "healthy" or sentences.needs_reason(diagnosis)
    return VerdictSection(
        diagnosis.verdict,
        sentences.VERDICTS[diagnosis.verdict],
        sentences.statements(diagnosis, material.gain, material.joints),
        sentence(capital(diagnosis.reason)) if shown else "",
        () if refused else (*_torque(material), *_simulation(material)),
    )


def _torque(material: Material) -> tuple[Tile, ...]:
    """Of the joint whose torque the nominal model gets wrong most."""
    worst, joints = torque.most_wrong(material.diagnosis.remaining), material.joints
    if worst is None:
        return ()
    after = "with the causes" if material.diagnosis.findings else "nominal numbers within tolerance"
    return (
        Tile(
            joints.torque(worst.joint, worst.before), f"torque error at {clean(worst.joint)}, nominal model"
        ),
        Tile(joints.torque(worst.joint, worst.after), f"torque error there, {after}", True),
    )


def _simulation(material: Material) -> tuple[Tile, ...]:
    total = merit.overall(material.gain)
    if total is None:
        return ()
    label = "error of the simulation, of the signals' standard deviation (NRMSE)"
    value = percent(total.before)
    if material.diagnosis.findings and not math.isnan(total.after):
        value += f" → {percent(total.after)}"
    tiles = [Tile(value, label)]
    if not math.isnan(total.floor):
        tiles.append(Tile(percent(total.floor), "of it that sensor noise alone leaves"))
    return tuple(tiles)
