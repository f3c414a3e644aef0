"""Several recordings of one machine are explained by one set of causes and numbers."""

from __future__ import annotations

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal, summary
from support.thorough import exhaustive, thorough

from flexjoint.core.errors import RecordingError
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Fitted
from flexjoint.recording.table import Recording

SOFT = Planted("spring_stiffness", "elbow", {"scale": -0.12})


def planted(seed: int, *causes: Planted) -> Recording:
    case = Case("crane", "rich", seed)
    return as_recording(case.with_causes(*causes), f"{case.name}-{seed}")


def scale(finding: object) -> Fitted:
    value = finding.parameters["scale"]  # type: ignore[attr-defined]
    assert isinstance(value, Fitted)
    return value


@thorough
def test_two_recordings_know_a_cause_better_than_one() -> None:
    robot, one, two = nominal("crane"), planted(31, SOFT), planted(32, SOFT)
    alone, both = diagnose(robot, [one], refine=False), diagnose(robot, [one, two])
    assert [(f.effect, f.joint) for f in both.findings] == [("spring_stiffness", "elbow")], summary(both)
    assert both.verdict == "causes", summary(both)
    a, b = scale(alone.findings[0]), scale(both.findings[0])
    assert b.std < a.std
    assert abs(b.value + 0.12) < 3.0 * b.std + 0.002  # and what the filter does at most
    assert any("all 2 recordings" in note for note in both.notes)


@thorough
@pytest.mark.parametrize(
    ("name", "number", "values"),
    [
        ("motor_encoder_offset", "offset", (0.01, 0.02)),
        pytest.param("spring_stiffness", "scale", (-0.12, -0.3), marks=exhaustive),
    ],
)
def test_recordings_that_disagree_say_so(name: str, number: str, values: tuple[float, float]) -> None:
    """The first one's number is reported, which explains it, and is known no better than they agree."""
    one, two = (planted(31 + k, Planted(name, "elbow", {number: x})) for k, x in enumerate(values))
    both = diagnose(nominal("crane"), [one, two])
    assert [(f.effect, f.joint) for f in both.findings] == [(name, "elbow")], summary(both)
    assert both.verdict == "causes", summary(both)
    assert any(note.startswith(f"the recordings disagree on {number}") for note in both.notes), both.notes
    assert any("numbers of the first" in note for note in both.notes)
    found = both.findings[0].parameters[number]
    assert isinstance(found, Fitted)
    assert found.value == pytest.approx(values[0], rel=0.01)
    assert found.std > 0.2 * abs(values[1] - values[0])


def test_healthy_recordings_stay_healthy_together() -> None:
    both = diagnose(nominal("crane"), [planted(33), planted(34)])
    assert both.verdict == "healthy" and not both.findings, summary(both)


def test_a_recording_that_cannot_be_used_is_named() -> None:
    good = planted(33)
    with pytest.raises(RecordingError, match=r"33\[0:0.6\] cannot be diagnosed together.*usable data"):
        diagnose(nominal("crane"), [good, good.between(0.0, 0.6)])
