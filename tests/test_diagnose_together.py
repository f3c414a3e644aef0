"""Several recordings of one machine are explained by one set of causes and numbers."""

from __future__ import annotations

import pytest
from diagnose_cases import Case, as_recording, nominal, summary
from planting import Planted

from flexjoint.diagnose import diagnose
from flexjoint.diagnosis import Fitted
from flexjoint.errors import RecordingError
from flexjoint.recording import Recording

SOFT = Planted("spring_stiffness", "elbow", {"scale": -0.12})
SOFTER = Planted("spring_stiffness", "elbow", {"scale": -0.3})


def planted(seed: int, *causes: Planted) -> Recording:
    case = Case("crane", "rich", seed)
    return as_recording(case.with_causes(*causes), f"{case.name}-{seed}")


def scale(finding: object) -> Fitted:
    value = finding.parameters["scale"]  # type: ignore[attr-defined]
    assert isinstance(value, Fitted)
    return value


def test_two_recordings_know_a_cause_better_than_one() -> None:
    robot, one, two = nominal("crane"), planted(31, SOFT), planted(32, SOFT)
    alone, both = diagnose(robot, [one], refine=False), diagnose(robot, [one, two])
    assert [(f.effect, f.joint) for f in both.findings] == [("spring_stiffness", "elbow")], summary(both)
    assert both.verdict == "causes", summary(both)
    a, b = scale(alone.findings[0]), scale(both.findings[0])
    assert b.std < a.std
    assert abs(b.value + 0.12) < 3.0 * b.std + 0.002  # and what the filter does at most
    assert any("all 2 recordings" in note for note in both.notes)


def test_recordings_that_disagree_say_so() -> None:
    both = diagnose(nominal("crane"), [planted(31, SOFT), planted(32, SOFTER)])
    assert [(f.effect, f.joint) for f in both.findings] == [("spring_stiffness", "elbow")], summary(both)
    assert any(note.startswith("the recordings disagree on scale") for note in both.notes), both.notes
    # the number lies between, and is not known better than the recordings agree
    assert -0.3 < scale(both.findings[0]).value < -0.12
    assert scale(both.findings[0]).std > 0.03


def test_healthy_recordings_stay_healthy_together() -> None:
    both = diagnose(nominal("crane"), [planted(33), planted(34)])
    assert both.verdict == "healthy" and not both.findings, summary(both)


def test_a_recording_that_cannot_be_used_is_named() -> None:
    good = planted(33)
    with pytest.raises(RecordingError, match=r"33\[0:0.6\] cannot be diagnosed together.*usable data"):
        diagnose(nominal("crane"), [good, good.between(0.0, 0.6)])
