"""What may drop or replace a cause, one rule a file, in the order in which they are asked.

`verdict/review.py` asks them; what one of them says of a set is asked again of the set that it leaves."""

from typing import Any

from flexjoint.diagnosis.verdict.cases import Case, SimulatedCase, StatedCase
from flexjoint.diagnosis.verdict.checks._base import Check, Objection
from flexjoint.diagnosis.verdict.checks.absent import AbsentOnTheSimulation
from flexjoint.diagnosis.verdict.checks.cancelling import CancelsWithNumbers
from flexjoint.diagnosis.verdict.checks.contradicted import ContradictedByABalance
from flexjoint.diagnosis.verdict.checks.finer import FinerThanKnown
from flexjoint.diagnosis.verdict.checks.improbable import Improbable
from flexjoint.diagnosis.verdict.checks.known_name import KnownName
from flexjoint.diagnosis.verdict.checks.nested import BesideItsSpecialCase
from flexjoint.diagnosis.verdict.checks.shrunk import ShrunkLaw
from flexjoint.diagnosis.verdict.checks.standing import FrictionAtRest
from flexjoint.diagnosis.verdict.checks.uncertain import UncertainSize
from flexjoint.diagnosis.verdict.checks.worse_simulation import WorseSimulation

BALANCES: tuple[Check[Case], ...] = (ShrunkLaw(), ContradictedByABalance(), UncertainSize())
NAMES: tuple[Check[Case], ...] = (KnownName(),)
SIMULATION: tuple[Check[SimulatedCase], ...] = (WorseSimulation(),)
FINDINGS: tuple[Check[StatedCase], ...] = (
    FrictionAtRest(),
    BesideItsSpecialCase(),
    Improbable(),
    CancelsWithNumbers(),
    AbsentOnTheSimulation(),
    FinerThanKnown(),
)
EVERY: tuple[Check[Any], ...] = (*BALANCES, *NAMES, *SIMULATION, *FINDINGS)

__all__ = ["BALANCES", "EVERY", "FINDINGS", "NAMES", "SIMULATION", "Check", "Objection"]
