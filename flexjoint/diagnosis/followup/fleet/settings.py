"""The numbers that decide who needs somebody; those of checks and diagnoses are in
flexjoint/diagnosis/settings.py."""

from __future__ import annotations

from dataclasses import dataclass

from flexjoint.diagnosis.settings import Stage, number


@dataclass(frozen=True)
class FleetSettings(Stage):
    """Fleet: who needs somebody, since when, and how sure."""

    false_alarms: float = number(
        0.05,
        "share",
        "of the robots that are shown, that nobody needs to look at",
        "theory: Benjamini and Hochberg 1995",
    )
    searches: int = number(
        3, "recordings", "that are searched in full after an alarm: the first two and the latest", "judgement"
    )
    confirmed: int = number(
        2, "recordings", "that must alarm, and name a cause alike, before its name is shown", "judgement"
    )
    fewest: int = number(5, "recordings", "in which a number can be said to have changed", "judgement")
    penalty: float = number(
        3.0,
        "log of the recordings times variance",
        "of a change point (`ruptures`, Pelt)",
        "theory: Killick, Fearnhead and Eckley 2012; Yao 1988 has two, of known variance",
    )
    warm: float = number(1.0, "deg C", "range of the temperatures from which they are taken out", "judgement")
    least_change: float = number(
        0.03, "share of a number", "by which it must change to matter, as in a check", "judgement"
    )
    alike: float = number(
        0.8,
        "share of the robots of one type",
        "with one cause, for the nominal model to be wrong",
        "judgement",
    )
    fewest_alike: int = number(3, "robots", "of one type that can be each other's reference", "judgement")
    odd: float = number(
        5.0,
        "robust standard deviations",
        "of the other robots of its type, from which one is odd",
        "judgement",
    )
    restarts: int = number(2, "times", "that a recording is tried whose worker died", "judgement")
