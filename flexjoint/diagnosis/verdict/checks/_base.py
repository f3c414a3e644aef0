"""What a check is: it looks at a set of causes, and objects to those that cannot be reported as they are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.cases import Case
from flexjoint.effects import Planned

Looked = TypeVar("Looked", bound=Case)


@dataclass(frozen=True)
class Objection:
    """A cause that is not to be reported as it is.

    `evidence` is what the check compares with its limit, `why` completes "X is not reported: ...". With
    `simpler`, the best simpler alternative takes its place if the data support one. `instead` is the
    selection to go on with, where the check has made it already.
    """

    effect: Planned
    evidence: float
    why: str
    simpler: bool = False
    instead: Selection | None = None


class Check(ABC, Generic[Looked]):
    """One rule by which a cause is dropped or replaced: its name, stage and reason, and its limit."""

    name: ClassVar[str]
    stage: ClassVar[str]
    reason: ClassVar[str]  # one sentence
    once: ClassVar[bool] = False  # whether it is done after its first objection
    noted: ClassVar[bool] = True  # whether what it does becomes a note of the report

    @abstractmethod
    def limit(self, settings: Settings) -> float:
        """What an objection's evidence is compared with."""

    @abstractmethod
    def objections(self, case: Looked) -> tuple[Objection, ...]:
        """Causes of the set that must go, none where all may stay; several go together."""
