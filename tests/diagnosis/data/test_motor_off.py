"""A log in which one motor was off all the time: its torque is a column without any reading."""

from dataclasses import replace

import numpy as np
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.data.torques.sampled import sampled
from flexjoint.diagnosis.settings import USUAL


def test_torques_without_any_reading_are_told_from_no_motion() -> None:
    whole = as_recording(Case("crane", "rich", 3).with_causes())
    columns = {
        key: np.full_like(x, np.nan) if key == ("tau_m", "shoulder") else x
        for key, x in whole.columns.items()
    }
    assert sampled(nominal("crane"), whole, USUAL.data) is not None
    assert sampled(nominal("crane"), replace(whole, columns=columns), USUAL.data) is None
