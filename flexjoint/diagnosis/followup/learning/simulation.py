"""Simulation of the stretches that laws did not see, with and without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.comparison.compare import HORIZON, Comparison, compared
from flexjoint.diagnosis.followup.learning.evidence import Evidence
from flexjoint.diagnosis.followup.learning.judge import Verdict
from flexjoint.diagnosis.result import Gain
from flexjoint.diagnosis.result.merit import root_mean_square
from flexjoint.diagnosis.verdict.held_out import errors, noise_floor
from flexjoint.model.dynamics import FlexibleJointModel

Errors = Mapping[str, Mapping[str, float]]


def simulated(evidence: Evidence, kept: Sequence[Verdict]) -> Errors:
    """RMS and NRMSE by channel over all stretches, each simulated with the causes and the laws of the others.

    Raises FlexJointError where a recording cannot drive a simulation, or one diverges."""
    runs = []
    for k, problem in enumerate(evidence.problems):
        recording = problem.readings.recording
        whole: dict[tuple[str, str], np.ndarray] = {}
        one: Comparison | None = None
        for part in [part for part in evidence.parts if part.recording == k]:
            laws = [law for verdict in kept if (law := dict(verdict.laws)[part]) is not None]
            model = FlexibleJointModel(evidence.robots[k].extended([*evidence.causes, *laws]))
            rows = part.holds(recording.time - recording.time[0])
            columns = {key: values[rows] for key, values in recording.columns.items()}
            one = compared(model, replace(recording, time=recording.time[rows], columns=columns))
            for key, values in one.simulated.items():
                whole.setdefault(key, np.full(recording.time.size, np.nan))[rows] = values
        assert one is not None
        every = np.ones(recording.time.size, dtype=bool)
        runs.append(errors(recording, replace(one, simulated=whole), every))
    return {
        kind: {
            name: root_mean_square(run[kind][name] for run in runs if name in run[kind])
            for name in dict.fromkeys(name for run in runs for name in run[kind])
        }
        for kind in ("rms", "nrmse")
    }


def held(evidence: Evidence, found: Sequence[Verdict]) -> tuple[list[Verdict], Gain | None]:
    """The laws with which the simulation is not worse on stretches that they did not see, and how it is
    without them and with them; None without laws, or where nothing can be simulated."""
    if not found:
        return [], None
    try:
        before = simulated(evidence, [])
    except FlexJointError:  # it lacks what a simulation needs
        return list(found), None
    kept = list(found)
    while kept:
        try:
            after = simulated(evidence, kept)
            worst = _worst(evidence, before, after, kept)
        except FlexJointError:  # it diverges
            worst = kept[-1]
        if worst is None:
            floor = noise_floor(evidence.robots[0], evidence.problems[0].readings.recording)
            return kept, Gain(True, HORIZON, before, after, {"rms": floor})
        kept.remove(worst)
    return [], None


def _worst(evidence: Evidence, before: Errors, after: Errors, kept: Sequence[Verdict]) -> Verdict | None:
    """The law to drop where the simulation of its joint, or of the robot, is worse."""
    limit = evidence.limits.worse

    def grown(joint: str | None) -> float:
        names = [
            name
            for name in before["nrmse"]
            if joint is None or name.split(".", 1)[1] == joint
            if joint is not None or not name.startswith("phi.")
        ]
        first, last = (
            root_mean_square(of["nrmse"][name] for name in names if name in of["nrmse"])
            for of in (before, after)
        )
        return last / first if first > 0.0 else 1.0

    worst = max(reversed(kept), key=lambda one: grown(one.removed.joint))
    return worst if grown(worst.removed.joint) > limit or grown(None) > limit else None
