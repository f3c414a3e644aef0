"""The top of the page: the three statements, and the torque and simulation errors in figures."""

from __future__ import annotations

import math
from dataclasses import dataclass

from flexjoint.diagnosis.result import merit, sentences, torque
from flexjoint.diagnosis.result.wording import capital, cause, clean, percent, sentence
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
    """Of the balance that the main cause clears; without a cause, of the joint that the nominal model gets
    wrong most."""
    diagnosis, joints = material.diagnosis, material.joints
    main = next(iter(sentences.likely(diagnosis)), None)
    removed = None if main is None else main.removed
    of_cause = [r for r in diagnosis.remaining if removed is not None and r.joint == removed.joint]
    if main is not None and removed is not None and (removed.balance != "motor" or not of_cause):
        balance, where = torque.balance(removed.balance, joints), clean(removed.joint)
        name = cause(main.effect, main.joint)
        return (
            Tile(joints.torque(removed.joint, removed.without), f"{balance} at {where}, without {name}"),
            Tile(joints.torque(removed.joint, removed.left), f"{balance} there, with it", True),
        )
    worst = torque.most_wrong(of_cause or diagnosis.remaining)
    if worst is None:
        return ()
    after = "with the causes" if diagnosis.findings else "nominal numbers within tolerance"
    return (
        Tile(
            joints.torque(worst.joint, worst.before), f"torque error at {clean(worst.joint)}, nominal model"
        ),
        Tile(joints.torque(worst.joint, worst.after), f"torque error there, {after}", True),
    )


def _simulation(material: Material) -> tuple[Tile, ...]:
    """Of the signal in which the main cause shows; without a cause, of all together."""
    main = next(iter(sentences.likely(material.diagnosis)), None)
    moved = None if main is None else sentences.most_moved(main, material.gain)
    if moved is not None and moved.after < moved.before:
        before, after, floor = moved.before, moved.after, moved.floor
        signal = f"{material.joints.signal(moved.channel)} at {clean(moved.joint)}"
        label = f"error of {signal} in the simulation, of its standard deviation (NRMSE)"
    else:
        total = merit.overall(material.gain)
        if total is None:
            return ()
        before, after, floor = total.before, total.after, total.floor
        label = "error of the simulation, of the signals' standard deviation (NRMSE)"
    value = percent(before)
    if material.diagnosis.findings and not math.isnan(after):
        value += f" → {percent(after)}"
    tiles = [Tile(value, label)]
    if not math.isnan(floor):
        tiles.append(Tile(percent(floor), "of it that sensor noise alone leaves"))
    return tuple(tiles)
