"""The verdict in plain sentences: what the simulation gets wrong and why, and how much of it is removed."""

from __future__ import annotations

import math
from collections.abc import Mapping

from flexjoint.diagnosis import Diagnosis, Finding, Gain
from flexjoint.effect import Kind
from flexjoint.report import merit
from flexjoint.report.wording import capital, cause, clean, listed, parameters, percent, sentence, signal_name

TIGHT = 0.95  # correlation of two errors, from which it is said
MOST_PAIRS = 3  # of them that are named

VERDICTS: Mapping[str, str] = {
    "causes": "Causes named",
    "healthy": "Healthy",
    "unexplained": "Unexplained error",
    "refused": "No verdict",
}


def verdict(diagnosis: Diagnosis, gain: Gain | None) -> tuple[str, str]:
    """Two sentences: what is wrong and why; what remains of it on data that the fit did not see."""
    if diagnosis.verdict == "refused":
        return _refused(diagnosis)
    if diagnosis.verdict == "healthy":
        return _healthy(diagnosis, gain)
    if diagnosis.verdict == "unexplained":
        return _unexplained(diagnosis, gain)
    return _causes(diagnosis, gain)


def ties(diagnosis: Diagnosis) -> tuple[str, ...]:
    """One sentence for each finding that the data cannot tell from other causes."""
    said = []
    for finding in diagnosis.findings:
        if not finding.indistinguishable:
            continue
        others = listed((cause(tie.effect, tie.joint) for tie in finding.indistinguishable), "or")
        why = "; ".join(dict.fromkeys(clean(tie.why).rstrip(". ") for tie in finding.indistinguishable))
        name = cause(finding.effect, finding.joint)
        said.append(
            sentence(f"This recording cannot tell {name} from {others}" + (f": {why}" if why else ""))
        )
    return tuple(said)


def numbers(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What to know of the causes' numbers: which hang together, which are at a bound."""
    estimation = diagnosis.estimation
    if estimation is None:
        return ()
    said = [
        sentence(
            f"The errors of {_parameter(one)} and {_parameter(other)} are correlated by {size:.2f}: this"
            " recording knows one of them only together with the other"
        )
        for one, other, size in estimation.tight(TIGHT)[:MOST_PAIRS]
    ]
    if estimation.at_bounds:
        names = listed(f"{_parameter(name)} ({bound})" for name, bound in estimation.at_bounds)
        said.append(sentence(f"At a bound of what the catalogue allows: {names}"))
    return tuple(said)


def found_by(diagnosis: Diagnosis) -> str:
    """How the causes' numbers were found; empty without causes."""
    estimation = diagnosis.estimation
    if estimation is None:
        return ""
    if estimation.method == "output_error":
        return (
            f"Numbers are those with which the simulation follows the readings best, restarted every"
            f" {estimation.seconds:g} s."
        )
    why = f": {clean(estimation.why)}" if estimation.why else ""
    return sentence(f"Numbers are those of the torque balances{why}")


def _parameter(name: str) -> str:
    """effect.joint.parameter as words; a joint's name may hold dots."""
    effect, rest = name.split(".", 1)
    joint, parameter = rest.rsplit(".", 1)
    return f"{clean(parameter)} of {cause(effect, None if joint == 'robot' else joint)}"


def because(finding: Finding) -> str:
    """A cause as the reason of an error."""
    name = cause(finding.effect, finding.joint)
    numbers = parameters(finding)
    shown = f" ({numbers})" if numbers else ""
    if finding.planned.nominal or finding.kind == Kind.PARAMETER:
        return f"the model's {name} is off{shown}"
    if finding.kind == Kind.MECHANICAL:
        return f"the model lacks {name}{shown}"
    return f"the model takes no account of {name}{shown}"


def _causes(diagnosis: Diagnosis, gain: Gain | None) -> tuple[str, str]:
    if not diagnosis.findings:
        return sentence(capital(diagnosis.reason)), _error_stays(gain)
    first, *others = diagnosis.findings
    where = _worst(gain)
    opening = f"The simulation is furthest off in {where}" if where else "The simulation is wrong"
    text = f"{opening}, mainly because {because(first)}" if others else f"{opening}, because {because(first)}"
    if others:
        names = [cause(f.effect, f.joint) + _numbers(f) for f in others[:2]]
        if len(others) > 2:
            names.append(f"{len(others) - 2} more")
        text += f"; {listed(names)} add{'s' if len(others) == 1 else ''} to it"
    return sentence(text), _removed(diagnosis, gain)


def _numbers(finding: Finding) -> str:
    text = parameters(finding)
    return f" ({text})" if text else ""


def _removed(diagnosis: Diagnosis, gain: Gain | None) -> str:
    named = "this cause" if len(diagnosis.findings) == 1 else f"these {len(diagnosis.findings)} causes"
    total = merit.overall(gain)
    if gain is None or total is None or not math.isfinite(total.after):
        explained = percent(diagnosis.explained)
        return f"Adding {named} to the model removes {explained} of the error above the noise."
    data = "On data that the fit did not see" if gain.held_out else "On the data of the fit itself"
    floor = "" if math.isnan(total.floor) else f"; sensor noise alone leaves {percent(total.floor)}"
    return (
        f"{data}, adding {named} to the model removes {percent(total.removed)} of the error: it falls from"
        f" {percent(total.before)} to {percent(total.after)} of the signals' standard deviation{floor}."
    )


def _healthy(diagnosis: Diagnosis, gain: Gain | None) -> tuple[str, str]:
    first = "The simulation agrees with the recording within the noise and the model's own tolerance."
    total = merit.overall(gain)
    if gain is None or total is None:
        return first, sentence(capital(diagnosis.reason))
    floor = "" if math.isnan(total.floor) else f", where sensor noise alone leaves {percent(total.floor)}"
    return first, (
        f"Restarted from the measured state every {gain.horizon:g} s, it departs by {percent(total.before)}"
        f" of the signals' standard deviation{floor}."
    )


def _unexplained(diagnosis: Diagnosis, gain: Gain | None) -> tuple[str, str]:
    if diagnosis.unexplained:
        worst = max(diagnosis.unexplained, key=lambda u: u.share)
        first = (
            f"The simulation is wrong at {clean(worst.joint)}, and no effect of the catalogue accounts for"
            f" it: {percent(worst.share)} of the {clean(worst.balance)} balance's error is left and depends"
            f" most on {signal_name(worst.against)}."
        )
    else:
        first = "The simulation is wrong, and no effect of the catalogue accounts for it."
    if not diagnosis.findings:
        return first, _error_stays(gain)
    part = listed(f"{cause(f.effect, f.joint)} ({percent(f.gain)})" for f in diagnosis.findings)
    return first, sentence(
        f"A part is explained by {part}, as shares of the error on data that the fit did not see"
    )


def _error_stays(gain: Gain | None) -> str:
    total = merit.overall(gain)
    if gain is None or total is None:
        return "Nothing that was tried removes it."
    return (
        f"Restarted from the measured state every {gain.horizon:g} s, the simulation departs by"
        f" {percent(total.before)} of the signals' standard deviation, and nothing that was tried removes it."
    )


def _refused(diagnosis: Diagnosis) -> tuple[str, str]:
    first = sentence(f"This recording cannot carry a verdict: {diagnosis.reason}")
    return first, "Nothing is claimed about the simulation, neither that it is right nor that it is wrong."


def _worst(gain: Gain | None) -> str:
    rows = [row for row in merit.channel_errors(gain) if row.channel != "phi" and math.isfinite(row.before)]
    if not rows:
        return ""
    worst = max(rows, key=lambda row: row.before)
    size = f"{percent(worst.before)} of its standard deviation"
    return f"the {signal_name(worst.channel)} of {clean(worst.joint)} ({size})"
