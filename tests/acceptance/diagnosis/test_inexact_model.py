"""A nominal model that is 2 % off hides no cause: what its tolerances take on is known, and no more."""

from __future__ import annotations

import pytest
from study.cases import make
from study.run import diagnosed
from study.score import outcome
from support.thorough import sample

HARD = {
    33: "a delay whose torque is a quarter of the torque tolerance, and all that there is beside noise",
    90: "friction at steps, whose kinks a finer law follows that the simulation speaks against",
    105: "friction of two levels, which a Coulomb level and an offset would make together",
    125: "friction below the torque tolerance, which clears what is wrong and leaves a hundredth of it",
    135: "fading friction, beside whose error nothing else counts before it is known",
    210: "a small ripple that sets in late, and clears what is wrong",
    259: "link friction below the torque tolerance, which clears what is wrong",
    270: "link friction too small to help a simulation that suffers from a spring 2 % off",
}

NOISE = {
    25: "a torque's delay, which on one joint is a delay of all its sensors, but for noise at its ends",
    55: "cogging, beside which a delay would seem to remove the sensors' noise",
    235: "a payload, beside which the record's ends would tell of an eccentricity",
}


@pytest.mark.parametrize(
    "number", sample([*HARD, *NOISE], one_in=24, thorough_in=2), ids=lambda n: {**HARD, **NOISE}[n]
)
def test_a_small_cause_is_named_beside_an_inexact_model(number: int) -> None:
    record = diagnosed(make("single", number))
    assert outcome(record) in ("exact", "tied"), (record["verdict"], record["findings"])
