"""Recordings with known causes, and their diagnoses: each made once per process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache

from planting import ENCODERS, FULL, MOTOR_ONLY, RAGGED, ROBOTS, Planted, Recorded, SensorSet, plant

from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.regression.uncertainty import standard_errors
from flexjoint.diagnosis.result import Diagnosis, Finding, Fitted
from flexjoint.recording import table as recording
from flexjoint.recording.table import Recording
from flexjoint.robot import robot
from flexjoint.robot.robot import Robot

SECONDS = 12.0
QUIET = {
    name: replace(sensors, noisy_feedback=False)  # the command is smooth between two recorded samples
    for name, sensors in {
        "full": FULL,
        "encoders": ENCODERS,
        "motor_only": MOTOR_ONLY,
        "ragged": RAGGED,
    }.items()
}
NOISY_FEEDBACK = {"noisy_feedback": FULL}
SENSORS: dict[str, SensorSet] = QUIET | NOISY_FEEDBACK


@dataclass(frozen=True)
class Case:
    """A machine and its motion. `seed` draws trajectory, noise and the deviations of an inexact machine."""

    robot: str
    excitation: str
    seed: int
    sensors: str = "full"
    inexact: float = 0.0

    def with_causes(self, *causes: Planted) -> Recorded:
        """Its recording. The arrays are shared by all who ask for it, and read-only."""
        shared = _planted(self, _Causes(causes))
        return replace(shared, columns=dict(shared.columns), true=dict(shared.true))

    @property
    def name(self) -> str:
        parts = [self.robot, self.excitation]
        parts += [self.sensors] if self.sensors != "full" else []
        parts += ["inexact"] if self.inexact else []
        return "-".join(parts)


class _Causes(tuple[Planted, ...]):
    """Causes as a key: equal when they are written alike."""

    def __hash__(self) -> int:
        return hash(repr(tuple(self)))


@lru_cache(maxsize=64)
def _planted(case: Case, causes: _Causes) -> Recorded:
    recorded = plant(
        ROBOTS / f"{case.robot}.yaml",
        list(causes),
        case.excitation,
        SECONDS,
        case.seed,
        SENSORS[case.sensors],
        inexact=case.inexact,
    )
    for values in (*recorded.columns.values(), *recorded.true.values()):
        values.flags.writeable = False
    return recorded


@cache
def nominal(name: str) -> Robot:
    """A robot of the planting as the package reads it."""
    return robot.load(ROBOTS / f"{name}.yaml")


def as_recording(recorded: Recorded, name: str = "planted") -> Recording:
    columns = {tuple(k.split(".", 1)): v for k, v in recorded.columns.items() if k != "time"}
    return recording.make(recorded.columns["time"], columns, name)


def found_in(case: Case, *causes: Planted, excluded: frozenset[str] = frozenset()) -> Diagnosis:
    recorded = as_recording(case.with_causes(*causes), case.name)
    return diagnose(nominal(case.robot), [recorded], excluded=excluded)


def summary(diagnosis: Diagnosis) -> str:
    """One line for a failing test: verdict, energies per sample and what was named."""
    before, after = diagnosis.energy
    named = "; ".join(_line(f) for f in diagnosis.findings) or "nothing"
    left = ", ".join(f"{u.joint}/{u.balance} {u.share:.2g}" for u in diagnosis.unexplained)
    numbers = f"energy {before:.3g} -> {after:.3g}, explained {diagnosis.explained:.4f}"
    return f"{diagnosis.verdict}, {numbers}: {named}" + (f"; unexplained {left}" if left else "")


def _line(finding: Finding) -> str:
    values = ", ".join(
        f"{k}={v}" if isinstance(v, str) else f"{k}={v.value} +- {v.std}"
        for k, v in finding.parameters.items()
    )
    ties = ", ".join(f"{t.effect}/{t.joint}" for t in finding.indistinguishable)
    since = "" if finding.since is None else f" since {finding.since:.2f}"
    return f"{finding.effect}/{finding.joint} p={finding.probability:.2f} ({values}){since} ~ [{ties}]"


def findings_of(best: Fit) -> tuple[Finding, ...]:
    """The effects of a fit as findings, with its standard errors and nothing said against them."""
    errors = standard_errors(best)
    out = []
    for planned, std in zip(best.effects, errors, strict=True):
        parameters = {
            p.name: Fitted(planned.values[p.name], std[p.name][0], p.unit) for p in planned.effect.params
        }
        out.append(
            Finding(planned.effect.name, planned.joint, 1.0, parameters, None, 1.0, "mechanical", planned)
        )
    return tuple(out)
