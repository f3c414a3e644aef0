"""A candidate whose trace runs away, as a spring that its load turns over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from planting import ROBOTS, plant
from planting.machine.sensing import SensorSet
from support.diagnose_cases import as_recording

from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search import scan
from flexjoint.diagnosis.search.candidates import Trace, enumerate_candidates, traces
from flexjoint.robot.robot import load


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [1e130, np.inf, np.nan])
def test_is_left_out_and_the_others_are_scanned(monkeypatch: pytest.MonkeyPatch, size: float) -> None:
    path = ROBOTS / "lever.yaml"
    recorded = plant(path, [], "rich", 4.0, 5, SensorSet(channels=("theta", "tau_motor")), rate=250.0)
    current = fit(Problem(balances_of(load(path), as_recording(recorded))), [])
    candidates = enumerate_candidates(current.problem)
    usual = {s.candidate.key for s in scan.Scanner(candidates).scan(current)}
    gone = next(iter(usual))

    def running_away(*given: Any) -> Iterator[Trace]:
        for trace in traces(*given):
            if given[1].key == gone:
                bands = (replace(b, spectra=np.full_like(b.spectra, size)) for b in trace.bands)
                yield replace(trace, bands=tuple(bands))
            else:
                yield trace

    monkeypatch.setattr(scan, "traces", running_away)
    assert {s.candidate.key for s in scan.Scanner(candidates).scan(current)} == usual - {gone}
