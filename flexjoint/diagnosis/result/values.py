"""What a diagnosis holds: frozen values, and their JSON form (docs/reference/formats.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from flexjoint.effects import Planned

Verdict = Literal["causes", "healthy", "unexplained", "refused"]


@dataclass(frozen=True)
class Fitted:
    """A fitted number with its standard error, both in `unit`."""

    value: float | tuple[float, ...]
    std: float | tuple[float, ...]
    unit: str
    at_bound: bool = False


@dataclass(frozen=True)
class Tie:
    """Another cause that would explain the same, and what it does that leaves the data undecided (`why`, from
    the verb on)."""

    effect: str
    joint: str | None
    why: str


@dataclass(frozen=True)
class Removed:
    """What a cause removes on data that the fit did not see, in the balance that it clears most [N m, RMS]:
    the error of the extended model without it, all other numbers kept, and with it."""

    joint: str
    balance: str  # motor | link | spring
    without: float
    left: float
    structured: float  # of what is left: what a smooth law of one signal would remove as well
    against: str  # that signal
    # share of the cause's own torque that the error without it holds, by least squares, with its standard
    # error: 1 for the right law with the right numbers (Mincer and Zarnowitz 1969, "The evaluation of
    # economic forecasts"), one half where the error is as large with the cause as without; None: not asked,
    # or the cause hardly acts on that data
    held: float | None = None
    held_std: float | None = None


@dataclass(frozen=True)
class Remaining:
    """The torque error of one joint [N m, RMS], on data that the fit did not see: measured motor torque minus
    what the model needs for the measured motion. `after` has the causes at work and the nominal numbers where
    their tolerances let them be."""

    joint: str
    torque: float  # of the joint itself
    before: float
    after: float
    noise: float  # what the sensors' noise alone would leave
    structured: float  # of `after`: what a smooth law of one signal would remove
    against: str  # that signal

    @property
    def beyond_noise(self) -> float:
        """[N m, RMS] of `after`, what noise does not make."""
        return math.sqrt(max(0.0, self.after**2 - self.noise**2))


@dataclass(frozen=True)
class Finding:
    """A named cause. `planned` is the effect as the extended model holds it; where the nominal model lists
    the same effect, `parameters` give the change and `planned` the total."""

    effect: str
    joint: str | None
    probability: float
    parameters: Mapping[str, Fitted | str]
    since: float | None  # [s] on the recording's clock, the start of it where it ceases later
    gain: float  # share of the held-out error that it removes
    kind: str
    planned: Planned
    indistinguishable: tuple[Tie, ...] = ()
    members: tuple[Planned, ...] = ()  # of a cause that joints share: the effect on each of them
    hidden_by_refit: bool = False  # a refit of the nominal numbers would absorb most of it
    note: str = ""
    left: float = 1.0  # largest variance left in the balances that it touches, in that of the noise
    reliability: float = 1.0  # how often names that leave so much were right; part of `probability`
    removed: Removed | None = None
    during: tuple[tuple[float, float | None], ...] = ()  # [s] of one that ceases: from, to (None: goes on)
    instead_of: Finding | None = None  # the change of the nominal entry in whose place it is


@dataclass(frozen=True)
class Unexplained:
    """Error that no cause of the catalogue accounts for."""

    joint: str
    balance: str  # motor | link | spring
    share: float  # of this balance's error
    against: str  # the signal it depends on most
    # a torque from outside that acts on the joint's link for some time [s, of the recording; N m]
    begin: float | None = None
    end: float | None = None
    torque: float | None = None


@dataclass(frozen=True)
class WithinTolerance:
    """A deviation that the nominal model's own tolerance covers: by how much a number changes."""

    effect: str
    joint: str | None
    parameter: str  # of the effect
    value: float

    def applied(self, effects: Sequence[Planned]) -> Planned:
        """The effect with its number changed, as it is among some effects or absent there."""
        here = next((e for e in effects if e.key == (self.effect, self.joint)), None)
        if here is None:
            return Planned.of(self.effect, self.joint, {self.parameter: self.value})
        return here.with_values({self.parameter: here.values[self.parameter] + self.value})


@dataclass(frozen=True)
class Ranked:
    """A candidate as scored alone: the share of the nominal error that it removes on held-out blocks."""

    effect: str
    joint: str | None
    removes: float
    values: Mapping[str, Any]


@dataclass(frozen=True)
class ResidualView:
    """One balance of one joint [N m], before and after the extension, with what it may depend on (N,)."""

    joint: str
    balance: str
    time: np.ndarray
    before: np.ndarray
    after: np.ndarray
    noise: float  # predicted standard deviation
    signals: Mapping[str, np.ndarray]  # q, dtheta, tau_t, ... each (N,)


@dataclass(frozen=True)
class Gain:
    """Simulation against recording on data that the fit did not see: RMS and NRMSE per channel."""

    held_out: bool
    horizon: float
    before: Mapping[str, Mapping[str, float]]  # {"rms": {...}, "nrmse": {...}}
    after: Mapping[str, Mapping[str, float]]
    noise_floor: Mapping[str, Mapping[str, float]]  # {"rms": of readings, "simulated": by them}


@dataclass(frozen=True)
class Estimation:
    """How the numbers of the findings were found, and how they hang together.

    `method` is output_error (refined on the simulation itself) or balances, `why` says why not refined.
    `parameters` are named effect.joint.parameter, [k] for the entries of a position; `correlation` (p, p) is
    that of their errors.
    """

    method: Literal["output_error", "balances"]
    why: str
    parameters: tuple[str, ...]
    correlation: np.ndarray
    at_bounds: tuple[tuple[str, str], ...] = ()  # (parameter, lower | upper)
    seconds: float = 0.0  # length of the windows that were simulated
    level: float = 1.0  # squared residual per degree of freedom, in those of the sensors' noise, at least 1
    follows: bool = False  # whether the simulation follows the readings to the sensors' noise

    def tight(self, above: float) -> tuple[tuple[str, str, float], ...]:
        """Pairs of parameters whose errors are correlated by more than a size, the tightest first."""
        pairs = [
            (self.parameters[i], self.parameters[j], float(self.correlation[i, j]))
            for i in range(len(self.parameters))
            for j in range(i)
        ]
        return tuple(sorted((p for p in pairs if abs(p[2]) > above), key=lambda p: -abs(p[2])))


Action = Literal["added", "dropped", "replaced", "exchanged", "merged", "kept"]


@dataclass(frozen=True)
class Step:
    """A change of the set of causes, or that one of them was kept in the end."""

    stage: str  # search | recordings | balances | simulation | robust search | findings | verdict
    action: Action
    effect: str
    joint: str | None
    by: tuple[str, str | None] | None  # effect and joint that took its place
    check: str  # what asked for it
    # energy (chi-square) that a step of the search gains at the noise level after it; of a check, the number
    # that it compares with its limit; of a cause that is kept, its probability
    evidence: float
    text: str


@dataclass(frozen=True)
class Column:
    """How a column of a recording is made right: scale times the column `source`, plus an offset."""

    name: str  # channel.joint
    source: str
    scale: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        """theta.elbow = -1 * theta.elbow + 0.5"""
        times = f"{self.scale:.6g} * " if self.scale != 1.0 else ""
        plus = f" {'-' if self.offset < 0.0 else '+'} {abs(self.offset):.6g}" if self.offset != 0.0 else ""
        return f"{self.name} = {times}{self.source}{plus}"


@dataclass(frozen=True)
class DataFinding:
    """An error of the data, and not of the machine: a sign, a zero, a unit or a name that is wrong.

    `factor` is how much smaller (RMS) the torque balance of a joint is once it is repaired, and `left` what
    is left of that torque then, as a share; None where no torque was needed to see it. The repair is of
    `columns`, or of the robot file, whose line `robot_file` gives."""

    error: str  # turned_torque | turned_position | turned_joint | turned_velocity | zero | unit | gear | ...
    joint: str | None
    text: str  # a sentence without its end
    columns: tuple[Column, ...] = ()
    robot_file: str = ""
    factor: float | None = None
    left: float | None = None
    recording: str = ""
    command: str = ""  # that writes the repaired recording


@dataclass(frozen=True)
class Repeated:
    """A number of a cause over several recordings, each fitted by itself: values and standard errors in the
    order of the recordings, in `unit`; a standard error is infinite where a recording does not show it.

    `mean` and `std` are weighted by the errors. `chi_square` is the spread about the mean in them, of so many
    degrees of `freedom`, `chance` how often chance spreads as far, and `odd` are the recordings that stand
    out from the others."""

    effect: str
    joint: str | None
    parameter: str
    unit: str
    values: tuple[float, ...]
    stds: tuple[float, ...]
    mean: float
    std: float
    chi_square: float
    freedom: int
    chance: float
    disagree: bool  # beyond its errors, with as many chances counted as there are numbers
    odd: tuple[int, ...] = ()


@dataclass(frozen=True)
class Shown:
    """Which recordings show a cause, by themselves: `there` in those; `absent` in those that would show it if
    it were there as in the others; the rest cannot tell."""

    effect: str
    joint: str | None
    there: tuple[int, ...]
    absent: tuple[int, ...]


@dataclass(frozen=True)
class LeftOut:
    """Simulation against a recording with the causes' numbers fitted to all others; None where it cannot be
    simulated."""

    recording: int
    gain: Gain | None


@dataclass(frozen=True)
class Agreement:
    """Several recordings of one robot beside each other; numbers in other values index `recordings`."""

    recordings: tuple[str, ...]
    numbers: tuple[Repeated, ...]
    causes: tuple[Shown, ...]
    left_out: tuple[LeftOut, ...]


@dataclass(frozen=True)
class Likeness:
    """How much of a learned law an effect of the catalogue would explain: the correlation of what both do in
    the recording's torque balances, in [0, 1]."""

    effect: str
    correlation: float


@dataclass(frozen=True)
class Section:
    """A law of two signals where the other signal is `at`: `value` (M,) with standard errors `std` (M,) at
    the places of the law's own curve."""

    at: float
    value: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class LearnedLaw:
    """A smooth law of one signal, or two, through what no cause explains; it is no cause. `planned` is the
    effect as the extended model holds it, with the standard errors of its coefficients.

    The curve is `value` (M,) with standard errors `std` (M,) in `unit` at `at` (M,) of the signal in
    `signal_unit`. `removed` is what it removes on data that its fit did not see, `share` the same as a share
    of the squared error, noise included. A law of two signals follows the `other`, too, in `other_unit`: its
    curve is that at the middle of the other's range, and `sections` are more of them."""

    effect: str
    joint: str
    signal: str
    planned: Planned
    at: tuple[float, ...]
    signal_unit: str
    value: tuple[float, ...]
    std: tuple[float, ...]
    unit: str
    freedom: float  # effective degrees of freedom
    removed: Removed
    share: float
    alike: tuple[Likeness, ...]  # the closest first
    advice: str  # what to look at; a sentence without its end
    other: str = ""
    other_unit: str = ""
    sections: tuple[Section, ...] = ()


@dataclass(frozen=True)
class Learned:
    """What was learned beyond the causes. `simulation` compares, on data that no law's fit saw, the model
    with the likely causes (before) and with the laws, too (after); None without laws, or where the recording
    cannot drive a simulation."""

    laws: tuple[LearnedLaw, ...] = ()
    simulation: Gain | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Result:
    """The values of a `Diagnosis`, which adds what one does with them."""

    verdict: Verdict
    reason: str  # one sentence: why this verdict
    findings: tuple[Finding, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    remaining: tuple[Remaining, ...] = ()
    not_excited: tuple[tuple[str, str | None], ...] = ()
    within_tolerance: tuple[WithinTolerance, ...] = ()
    comparison: Gain | None = None
    next_experiment: str = ""
    ranking: tuple[Ranked, ...] = ()
    residuals: tuple[ResidualView, ...] = ()
    explained: float = 0.0  # share of the excess error energy that the findings remove
    energy: tuple[float, float] = (1.0, 1.0)  # whitened residual energy per sample before, after; 1 = noise
    notes: tuple[str, ...] = ()
    estimation: Estimation | None = None  # None without findings
    trace: tuple[Step, ...] = ()  # how the set of causes came about, step by step
    robot: str = ""  # its name
    prismatic: frozenset[str] = frozenset()  # joints that slide: their numbers are in m and N
    rigid: bool = False  # whether no joint has a spring
    data: tuple[DataFinding, ...] = ()  # errors of the data, which come before any cause
    agreement: Agreement | None = None  # of several recordings
    learned: Learned | None = None  # None where no law was asked for


def to_json(diagnosis: Result, model: str | None = None) -> dict[str, Any]:
    """The fixed JSON form, schema 1; `model` is the extended YAML's name."""
    comparison = diagnosis.comparison
    return {
        "schema": 1,
        "verdict": diagnosis.verdict,
        "reason": diagnosis.reason,
        "data": [data_to_json(d) for d in diagnosis.data],
        "findings": [_finding(f) for f in diagnosis.findings],
        "unexplained": [
            {
                "joint": u.joint,
                "balance": u.balance,
                "share": u.share,
                "against": u.against,
                "push": None if u.begin is None else {"begin": u.begin, "end": u.end, "torque": u.torque},
            }
            for u in diagnosis.unexplained
        ],
        "remaining": [asdict(r) for r in diagnosis.remaining],
        "level": {"before": diagnosis.energy[0], "after": diagnosis.energy[1]},
        "not_excited": [{"effect": effect, "joint": joint} for effect, joint in diagnosis.not_excited],
        "within_tolerance": [
            {"effect": w.effect, "joint": w.joint, "parameter": w.parameter, "value": w.value}
            for w in diagnosis.within_tolerance
        ],
        "comparison": None if comparison is None else _gain(comparison),
        "recordings": None if diagnosis.agreement is None else _agreement(diagnosis.agreement),
        "learned": None if diagnosis.learned is None else _learned(diagnosis.learned),
        "next_experiment": diagnosis.next_experiment,
        "model": model,
        "notes": list(diagnosis.notes),
        "estimation": None if diagnosis.estimation is None else _estimation(diagnosis.estimation),
        "trace": [_step(step) for step in diagnosis.trace],
    }


def _gain(gain: Gain) -> dict[str, Any]:
    return {
        "held_out": gain.held_out,
        "horizon": gain.horizon,
        "before": gain.before,
        "after": gain.after,
        "noise_floor": gain.noise_floor,
    }


def _agreement(agreement: Agreement) -> dict[str, Any]:
    return {
        "names": list(agreement.recordings),
        "numbers": [asdict(number) for number in agreement.numbers],
        "causes": [asdict(shown) for shown in agreement.causes],
        "left_out": [
            {"recording": one.recording, "comparison": None if one.gain is None else _gain(one.gain)}
            for one in agreement.left_out
        ],
    }


def _learned(learned: Learned) -> dict[str, Any]:
    return {
        "laws": [
            {
                "effect": law.effect,
                "joint": law.joint,
                "signal": law.signal,
                "parameters": {
                    name: _plain(value) if isinstance(value, tuple | float) else value
                    for name, value in law.planned.values.items()
                },
                "curve": {
                    "at": list(law.at),
                    "signal_unit": law.signal_unit,
                    "value": list(law.value),
                    "std": list(law.std),
                    "unit": law.unit,
                },
                "freedom": law.freedom,
                "removed": asdict(law.removed),
                "share": law.share,
                "alike": [asdict(one) for one in law.alike],
                "advice": law.advice,
                "other": law.other or None,
                "other_unit": law.other_unit or None,
                "sections": [asdict(one) for one in law.sections],
            }
            for law in learned.laws
        ],
        "simulation": None if learned.simulation is None else _gain(learned.simulation),
        "notes": list(learned.notes),
    }


def data_to_json(finding: DataFinding) -> dict[str, Any]:
    return {
        "kind": "data",
        "error": finding.error,
        "joint": finding.joint,
        "text": finding.text,
        "factor": finding.factor,
        "left": finding.left,
        "recording": finding.recording,
        "repair": {
            "columns": [
                {"column": c.name, "from": c.source, "scale": c.scale, "offset": c.offset}
                for c in finding.columns
            ],
            "robot_file": finding.robot_file,
            "command": finding.command,
        },
    }


def _step(step: Step) -> dict[str, Any]:
    return {
        "stage": step.stage,
        "action": step.action,
        "effect": step.effect,
        "joint": step.joint,
        "by": None if step.by is None else {"effect": step.by[0], "joint": step.by[1]},
        "check": step.check,
        "evidence": step.evidence,
        "text": step.text,
    }


def _estimation(estimation: Estimation) -> dict[str, Any]:
    return {
        "method": estimation.method,
        "why": estimation.why,
        "window": estimation.seconds,
        "level": estimation.level,
        "parameters": list(estimation.parameters),
        "correlation": np.asarray(estimation.correlation).round(4).tolist(),
        "at_bounds": [{"parameter": name, "bound": bound} for name, bound in estimation.at_bounds],
    }


def _parameters(finding: Finding) -> dict[str, Any]:
    parameters: dict[str, Any] = {}
    for name, fitted in finding.parameters.items():
        if isinstance(fitted, str):
            parameters[name] = fitted
        else:
            parameters[name] = {"value": _plain(fitted.value), "std": _plain(fitted.std), "unit": fitted.unit}
    return parameters


def _finding(finding: Finding) -> dict[str, Any]:
    other = finding.instead_of
    return {
        "effect": finding.effect,
        "joint": finding.joint,
        "probability": finding.probability,
        "parameters": _parameters(finding),
        "instead_of": None
        if other is None
        else {"effect": other.effect, "joint": other.joint, "parameters": _parameters(other)},
        "since": finding.since,
        "during": [list(span) for span in finding.during] or None,
        "gain": finding.gain,
        "kind": finding.kind,
        "hidden_by_refit": finding.hidden_by_refit,
        "note": finding.note,
        "left": finding.left,
        "removed": None if finding.removed is None else asdict(finding.removed),
        "indistinguishable": [
            {"effect": t.effect, "joint": t.joint, "why": t.why} for t in finding.indistinguishable
        ],
    }


def _plain(value: float | tuple[float, ...]) -> float | list[float]:
    return [float(v) for v in value] if isinstance(value, tuple) else float(value)
