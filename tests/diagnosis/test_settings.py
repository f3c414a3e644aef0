"""The numbers that decide: each says why, bad ones are refused, and another set decides otherwise."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal
from support.thorough import thorough

from flexjoint.core.errors import ModelError
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import to_json
from flexjoint.diagnosis.settings import USUAL, SearchSettings, Settings

EVIDENCE = ("theory", "study", "machine", "judgement")


def test_every_number_has_a_unit_a_reason_and_evidence() -> None:
    for name, stage in USUAL.stages():
        for one in fields(stage):  # type: ignore[arg-type]
            said = dict(one.metadata)
            assert set(said) == {"unit", "reason", "evidence"}, (name, one.name)
            assert all(said.values()), (name, one.name)
            kind, _, what = said["evidence"].partition(":")
            assert kind in EVIDENCE and (kind == "judgement" or what.strip()), (name, one.name)


@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf"), "16", True, (1.0, 2.0)])
def test_a_number_that_is_none_is_refused(bad: Any) -> None:
    with pytest.raises(ModelError, match=r"SearchSettings\.price: expected .* like 16\.0"):
        SearchSettings(price=bad)


def test_a_count_must_be_whole() -> None:
    with pytest.raises(ModelError, match="most_effects: expected a whole number like 12"):
        SearchSettings(most_effects=2.5)  # type: ignore[arg-type]


@thorough
def test_another_price_decides_otherwise() -> None:
    """An offset that the usual price lets in, and one of a million times as much does not."""
    cause = Planted("torque_offset", "swing", {"offset": 1.0})
    recording = as_recording(Case("lever", "rich", 5).with_causes(cause))
    usual = diagnose(nominal("lever"), [recording], workers=1, refine=False)
    assert [(f.effect, f.joint) for f in usual.findings] == [("torque_offset", "swing")]
    steps = [(s.action, s.effect, s.joint) for s in usual.trace]
    assert ("added", "torque_offset", "swing") in steps and steps[-1] == ("kept", "torque_offset", "swing")
    assert to_json(usual)["trace"][-1]["check"] == "verdict"
    dear = Settings(search=replace(USUAL.search, price=1e6 * USUAL.search.price))
    assert not diagnose(nominal("lever"), [recording], workers=1, settings=dear).findings
