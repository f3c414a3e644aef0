"""Positions that no encoder measured, computed from the other encoder and the torque sensor."""

from __future__ import annotations

import numpy as np
import pytest
from planting import Planted
from support.diagnose_cases import Case, as_recording, nominal

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, SPRING, TwinBalances, balances_of
from flexjoint.effects import effect
from flexjoint.recording import table

OFFSET = 6.0  # N m
READS_MORE = Planted("torque_sensor_offset", "swing", {"offset": OFFSET})


def balances(*channels: str) -> TwinBalances:
    recorded = as_recording(Case("lever", "rich", 4).with_causes(READS_MORE))
    columns = {key: x for key, x in recorded.columns.items() if key[0] in channels}
    return balances_of(nominal("lever"), table.make(recorded.time, columns, "few sensors"))


@pytest.mark.parametrize("encoder", ["q", "theta"])
def test_each_balance_shows_what_the_torque_sensor_does(encoder: str) -> None:
    """The computed spring carries what the sensor recorded, its offset included, and agrees with it whatever
    effects make of the reading: they must show in the motor's and in the link's balance."""
    one = balances(encoder, "tau_t", "tau_m")
    offset = effect("torque_sensor_offset", "swing", offset=OFFSET)
    rows = {row.balance: r for r, row in enumerate(one.rows)}
    before, after = (np.mean(one.residual_torques(effects), axis=1) for effects in ([], [offset]))

    assert before[rows[MOTOR]] == pytest.approx(-OFFSET, rel=0.2)
    assert before[rows[LINK]] == pytest.approx(OFFSET, rel=0.2)
    assert np.allclose(after[[rows[MOTOR], rows[LINK]]], 0.0, atol=0.1 * OFFSET)
    assert after[rows[SPRING]] == 0.0


def test_with_both_encoders_each_balance_is_the_residual() -> None:
    one = balances("q", "theta", "tau_t", "tau_m")
    effects = [effect("torque_sensor_offset", "swing", offset=OFFSET)]
    assert np.array_equal(one.residual_torques(effects), one.time_series(one.residual(effects)))
