"""The verdict: two plain sentences, the ties in words, and three figures."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexjoint.report import merit, sentences
from flexjoint.report.material import Material
from flexjoint.report.wording import capital, percent, sentence


@dataclass(frozen=True)
class Tile:
    value: str
    label: str
    accent: bool = False


@dataclass(frozen=True)
class VerdictSection:
    verdict: str
    word: str
    sentences: tuple[str, str]
    ties: tuple[str, ...]
    reason: str
    next_experiment: str
    tiles: tuple[Tile, ...]


def build(material: Material) -> VerdictSection:
    diagnosis = material.diagnosis
    return VerdictSection(
        diagnosis.verdict,
        sentences.VERDICTS[diagnosis.verdict],
        sentences.verdict(diagnosis, material.gain),
        sentences.ties(diagnosis),
        "" if diagnosis.verdict == "refused" else sentence(capital(diagnosis.reason)),
        sentence(capital(diagnosis.next_experiment)),
        _tiles(material),
    )


def _tiles(material: Material) -> tuple[Tile, ...]:
    total = merit.overall(material.gain)
    if total is None or material.diagnosis.verdict == "refused":
        return ()
    if math.isnan(total.after) or not material.diagnosis.findings:
        tiles = [Tile(percent(total.before), "error of the simulation (NRMSE)")]
    else:
        tiles = [
            Tile(percent(total.before), "error of the nominal model (NRMSE)"),
            Tile(percent(total.after), "error with the named causes", True),
        ]
    if not math.isnan(total.floor):
        tiles.append(Tile(percent(total.floor), "that sensor noise alone leaves"))
    return tuple(tiles)
