"""Simulation of the stretches that laws did not see, with and without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.running.budget import OutOfTimeError, checkpoint
from flexjoint.diagnosis.comparison.compare import HORIZON, Comparison, compared
from flexjoint.diagnosis.followup.learning.evidence import Evidence
from flexjoint.diagnosis.followup.learning.judge import Verdict, gained
from flexjoint.diagnosis.result import Gain
from flexjoint.diagnosis.result.merit import root_mean_square
from flexjoint.diagnosis.verdict.unseen.noise_floor import noise_floor
from flexjoint.diagnosis.verdict.unseen.simulation import errors
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.table import Recording

Errors = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Simulated:
    """RMS and NRMSE by channel over all stretches, and, by channel, the sum of squared errors over its
    variance in each block of time (blocks,)."""

    errors: Errors
    squares: Mapping[str, np.ndarray]


def simulated(evidence: Evidence, kept: Sequence[Verdict]) -> Simulated:
    """All stretches, each simulated with the causes and the laws of the others.

    Raises FlexJointError where a recording cannot drive a simulation, or one diverges; OutOfTimeError between
    two stretches where the time allowed is over."""
    runs, squares = [], []
    for k, problem in enumerate(evidence.problems):
        recording = problem.readings.recording
        time = recording.time - recording.time[0]
        whole: dict[tuple[str, str], np.ndarray] = {}
        one: Comparison | None = None
        for part in [part for part in evidence.parts if part.recording == k]:
            checkpoint()
            laws = [law for verdict in kept if (law := dict(verdict.laws)[part]) is not None]
            model = FlexibleJointModel(evidence.robots[k].extended([*evidence.causes, *laws]))
            rows = part.holds(time)
            columns = {key: values[rows] for key, values in recording.columns.items()}
            one = compared(model, replace(recording, time=recording.time[rows], columns=columns))
            for key, values in one.simulated.items():
                whole.setdefault(key, np.full(recording.time.size, np.nan))[rows] = values
        assert one is not None
        every = np.ones(recording.time.size, dtype=bool)
        runs.append(errors(recording, replace(one, simulated=whole), every))
        block = (time / problem.settings.regression.time_block).astype(int)
        squares.append({".".join(key): _by_block(recording, key, x, block) for key, x in whole.items()})
    joined = {
        kind: {
            name: root_mean_square(run[kind][name] for run in runs if name in run[kind])
            for name in dict.fromkeys(name for run in runs for name in run[kind])
        }
        for kind in ("rms", "nrmse")
    }
    names = dict.fromkeys(name for own in squares for name in own)
    return Simulated(
        joined, {name: np.concatenate([own[name] for own in squares if name in own]) for name in names}
    )


def _by_block(
    recording: Recording, key: tuple[str, str], values: np.ndarray, block: np.ndarray
) -> np.ndarray:
    measured = recording.get(*key)
    spread = float(np.nanvar(measured))
    off = np.nan_to_num((values - measured) ** 2)
    return np.bincount(block, off / spread if spread > 0.0 else 0.0 * off)


def held(evidence: Evidence, found: Sequence[Verdict]) -> tuple[list[Verdict], Gain | None]:
    """The laws with which the simulation is better on stretches that they did not see, and how it is without
    them and with them; None without laws, or where nothing can be simulated.

    Raises OutOfTimeError where the time allowed is over."""
    if not found:
        return [], None
    try:
        before = simulated(evidence, [])
    except OutOfTimeError:
        raise
    except FlexJointError:  # it lacks what a simulation needs
        return list(found), None
    kept = list(found)
    while kept:
        try:
            after = simulated(evidence, kept)
            worst = _worst(evidence, before, after, kept)
        except OutOfTimeError:
            raise
        except FlexJointError:  # it diverges
            worst = kept[-1]
        if worst is None:
            model = evidence.robots[0].extended(evidence.causes)
            floor = noise_floor(model, evidence.problems[0].readings.recording)
            return kept, Gain(True, HORIZON, before.errors, after.errors, floor)
        kept.remove(worst)
    return [], None


def _worst(
    evidence: Evidence, before: Simulated, after: Simulated, kept: Sequence[Verdict]
) -> Verdict | None:
    """The law to drop: where the simulation of its joint is not surely better, or that of the robot worse."""
    limits = evidence.limits

    def grown(joint: str | None) -> float:
        names = [name for name in before.errors["nrmse"] if _of(name, joint)]
        first, last = (
            root_mean_square(of.errors["nrmse"][name] for name in names if name in of.errors["nrmse"])
            for of in (before, after)
        )
        return last / first if first > 0.0 else 1.0

    def sure(joint: str | None) -> float:
        first, last = (
            np.sum([x for name, x in of.squares.items() if _of(name, joint)], axis=0)
            for of in (before, after)
        )
        return gained(first, last).sure

    worst = max(reversed(kept), key=lambda one: grown(one.removed.joint))
    unsure = min(reversed(kept), key=lambda one: sure(one.removed.joint))
    if sure(unsure.removed.joint) < limits.sure_simulation:
        return unsure
    return worst if grown(worst.removed.joint) > limits.worse or grown(None) > limits.worse else None


def _of(name: str, joint: str | None) -> bool:
    """Whether a channel counts: those of a joint; of the whole robot all but deflections."""
    return not name.startswith("phi.") if joint is None else name.split(".", 1)[1] == joint
