"""The verdict in plain sentences, in three statements: is it there, is it all, is it this law?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flexjoint.diagnosis.result import merit, torque
from flexjoint.diagnosis.result.values import DataFinding, Finding, Gain, Remaining, Result
from flexjoint.diagnosis.result.wording import (
    Joints,
    capital,
    cause,
    clean,
    deviation,
    effect_name,
    listed,
    number,
    parameters,
    percent,
    ratio,
    sentence,
    unit_of,
    with_unit,
)
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Kind, catalogue

AS_NOISE = 1.1  # times noise: it is predicted no better
MOST_PAIRS = 3  # of them that are named
DATA = "Are the data right?"
REPAIR = (
    "What to do: repair the data and diagnose again; --ignore-data-checks (check_data=False) diagnoses them"
    " as they are."
)
MAIN = 3  # causes that the first statement names; the table has all

VERDICTS: Mapping[str, str] = {
    "causes": "Causes named",
    "healthy": "Healthy",
    "unexplained": "Unexplained error",
    "refused": "No verdict",
}


@dataclass(frozen=True)
class Statement:
    """One of the things that a diagnosis says; the question is empty where there is but one."""

    question: str
    lines: tuple[str, ...]


def statements(diagnosis: Result, gain: Gain | None, joints: Joints) -> tuple[Statement, ...]:
    """What is wrong with the data, where anything is; then what the diagnosis says."""
    if not diagnosis.data:
        return _of_machine(diagnosis, gain, joints)
    data = Statement(DATA, data_lines(diagnosis.data))
    if diagnosis.verdict == "refused":
        return (data, Statement("What next?", (*_refused(diagnosis)[1:2], REPAIR)))
    return (data, *_of_machine(diagnosis, gain, joints))


def data_lines(findings: Sequence[DataFinding]) -> tuple[str, ...]:
    """Errors of the data, each with its repair, and the command that repairs the recordings."""
    said = []
    for finding in findings:
        repair = "; ".join(str(column) for column in finding.columns) or finding.robot_file
        first = finding.text.split(maxsplit=1)[0]
        named = "." in first or "_" in first  # a column or a joint keeps its name
        said += [sentence(finding.text if named else capital(finding.text)), f"  Repair: {clean(repair)}"]
    commands = dict.fromkeys(finding.command for finding in findings if finding.command)
    return (*said, *(f"All of it: {clean(command)}" for command in commands))


def _of_machine(diagnosis: Result, gain: Gain | None, joints: Joints) -> tuple[Statement, ...]:
    """What was found and what it gains; what is left; whether it is this law, and what would decide it."""
    if diagnosis.verdict == "refused":
        return (Statement("", _refused(diagnosis)),)
    if diagnosis.verdict == "healthy":
        return (Statement("", (*_healthy(diagnosis, gain), *_next(diagnosis))),)
    if diagnosis.findings:
        said = (
            Statement("Is it there?", _found(diagnosis, gain, joints)),
            Statement("Is it all?", _left(diagnosis, joints)),
            Statement("Is it this law?", _law(diagnosis)),
        )
    else:
        said = (
            Statement("Is it there?", pushes(diagnosis, joints) or (_nothing_named(diagnosis),)),
            Statement("What is left?", (*_left(diagnosis, joints), *_error_stays(diagnosis, gain))),
            Statement("What next?", _next(diagnosis)),
        )
    return tuple(statement for statement in said if statement.lines)


def needs_reason(diagnosis: Result) -> bool:
    """Whether the diagnosis' own reason says more than the statements do."""
    return diagnosis.verdict in ("causes", "unexplained") and not diagnosis.remaining


def likely(diagnosis: Result) -> tuple[Finding, ...]:
    """The causes that are more likely there than not, the one that removes most torque error first."""
    found = [f for f in diagnosis.findings if f.probability >= USUAL.verdict.likely]
    return torque.by_size(found)


def possible(diagnosis: Result) -> tuple[Finding, ...]:
    """The causes that are more likely absent, and not in the extended model; the one that removes most
    torque error first."""
    limits = USUAL.verdict
    found = [f for f in diagnosis.findings if limits.disbelieved < f.probability < limits.likely]
    return torque.by_size(found)


def disbelieved(diagnosis: Result) -> str:
    """The causes that were looked at and are not believed, in one sentence; empty without any."""
    named = [
        f"{cause(f.effect, f.joint)} ({percent(f.probability)})"
        for f in diagnosis.findings
        if f.probability <= USUAL.verdict.disbelieved
    ]
    return sentence(f"Not believed: {', '.join(named)}") if named else ""


def ties(diagnosis: Result) -> tuple[str, ...]:
    """One sentence for each finding that the data cannot distinguish from other causes."""
    said = []
    for finding in diagnosis.findings:
        if not finding.indistinguishable:
            continue
        names = [cause(tie.effect, tie.joint) for tie in finding.indistinguishable]
        whys = [clean(tie.why).rstrip(". ") for tie in finding.indistinguishable]
        subjects = names if len(names) > 1 else ["it"]
        why = "; ".join(
            f"{subject} {reason}" for subject, reason in zip(subjects, whys, strict=True) if reason
        )
        name = cause(finding.effect, finding.joint)
        beginning = f"This recording cannot distinguish {name} from {listed(names, 'or')}"
        said.append(sentence(f"{beginning}: {why}" if why else beginning))
    return tuple(said)


def numbers(diagnosis: Result) -> tuple[str, ...]:
    """What to know of the causes' numbers: which are correlated, but for those of a law with the claim in
    whose place it is, and which are at a bound."""
    estimation = diagnosis.estimation
    if estimation is None:
        return ()
    tight = estimation.tight(USUAL.verdict.correlated)
    apart = [pair for pair in tight if not _in_one_place(diagnosis, *pair[:2])]
    said = [
        sentence(
            f"The errors of {_parameter(one)} and {_parameter(other)} are correlated by {size:.2f}: this"
            " recording determines them only together"
        )
        for one, other, size in apart[:MOST_PAIRS]
    ]
    if estimation.at_bounds:
        names = listed(f"{_parameter(name)} ({bound})" for name, bound in estimation.at_bounds)
        said.append(sentence(f"At a bound of what the catalogue allows: {names}"))
    return tuple(said)


def found_by(diagnosis: Result) -> str:
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


def _in_one_place(diagnosis: Result, *numbers: str) -> bool:
    """Whether two numbers are those of a law and of the claim in whose place it is."""
    whose = {name.rpartition(".")[0] for name in numbers}
    pairs = ((f, f.instead_of) for f in diagnosis.findings if f.instead_of is not None)
    return any({f"{f.effect}.{f.joint}" for f in pair} == whose for pair in pairs)


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


# ------------------------------------------------------------------ is it there?
def _found(diagnosis: Result, gain: Gain | None, joints: Joints) -> tuple[str, ...]:
    named, unsure = likely(diagnosis), possible(diagnosis)
    lines = []
    if named:
        first, *others = named
        texts = [because(first) + _odds(first, joints)]
        texts += [cause(f.effect, f.joint) + _numbers(f) + _odds(f, joints) for f in others[: MAIN - 1]]
        if len(named) > MAIN:
            texts.append(f"and {_more(named[MAIN:])}")
        lines = [sentence(capital("; ".join(texts))), moved(first, gain, joints)]
    else:
        lines.append("No cause is more likely there than not.")
    if unsure:
        texts = [cause(f.effect, f.joint) + _numbers(f) + _odds(f, joints) for f in unsure[:MAIN]]
        if len(unsure) > MAIN:
            texts.append(f"and {_more(unsure[MAIN:])}")
        lines.append(sentence(f"Possible: {'; '.join(texts)}"))
    return tuple(line for line in lines if line)


def _more(findings: Sequence[Finding]) -> str:
    """How many causes there are beside those that are told, and which."""
    joints: dict[str, list[str | None]] = {}
    for finding in findings:
        joints.setdefault(finding.effect, []).append(finding.joint)
    kinds = (
        cause(effect, at[0]) if len(at) == 1 else f"{effect_name(effect)} at {len(at)} joints"
        for effect, at in joints.items()
    )
    return f"{len(findings)} more: {listed(kinds)}"


def _numbers(finding: Finding) -> str:
    text = parameters(finding)
    return f" ({text})" if text else ""


def _odds(finding: Finding, joints: Joints) -> str:
    removal = torque.removal(finding, joints)
    return f", probability {percent(finding.probability)}" + (f": {removal}" if removal else "")


def moved(finding: Finding, gain: Gain | None, joints: Joints) -> str:
    """How far the simulation's error falls in the signal of the cause's own joint that gains most; of a load
    and of a cause of the whole robot, in the signal of any joint. Empty without a comparison."""
    most = most_moved(finding, gain)
    if gain is None or most is None:
        return ""
    data = "data that the fit did not see" if gain.held_out else "the data of the fit itself"
    if most.after >= most.before:
        where = "of the robot" if _carried(finding) else f"of {clean(finding.joint or 'the robot')}"
        return (
            f"In the simulation of {data}, the error of no measured signal {where} becomes smaller with it."
        )
    parts = [f"{percent(most.before)} → {percent(most.after)} of its standard deviation"]
    if math.isfinite(most.rms_before) and math.isfinite(most.rms_after):
        unit = unit_of(most.channel, most.joint in joints.prismatic)
        parts.insert(0, with_unit(f"{number(most.rms_before)} → {number(most.rms_after)}", unit))
    if math.isfinite(most.floor):
        parts.append(f"sensor noise alone {percent(most.floor)}")
    return (
        f"In the simulation of {data}, the error of {joints.signal(most.channel)} at {clean(most.joint)}"
        f" falls: {'; '.join(parts)}."
    )


def most_moved(finding: Finding, gain: Gain | None) -> merit.ChannelError | None:
    """The signal in which the simulation's error falls most, of the joints that the cause moves."""
    at = {finding.joint} if finding.joint is not None else {e.joint for e in finding.members}
    if _carried(finding):
        at = set()
    known = [e for e in merit.channel_errors(gain) if math.isfinite(e.before) and math.isfinite(e.after)]
    own = [e for e in known if e.joint in at or None in at or not at]
    return max(own, key=lambda e: e.before - e.after, default=None)


def _carried(finding: Finding) -> bool:
    """Whether the cause is a load or gravity, which the joints before it carry."""
    effect = finding.planned.effect
    return effect.overrides("edit_inertial") or effect.overrides("edit_gravity")


def _nothing_named(diagnosis: Result) -> str:
    worst = torque.most_left(diagnosis.remaining)
    where = "" if worst is None else f" at {clean(worst.joint)}"
    if worst is None and diagnosis.unexplained:
        where = f" at {clean(max(diagnosis.unexplained, key=lambda u: u.share).joint)}"
    if worst is None or not _mostly_tolerances(worst):
        return f"The simulation is wrong{where}, and no effect of the catalogue accounts for it."
    off = _within_tolerance(diagnosis, worst.joint)
    numbers = f" ({listed(off)})" if off else ""
    gone = percent(1.0 - worst.after / worst.before)
    return (
        f"Nominal numbers within their tolerances account for {gone} of the torque error{where}{numbers}. For"
        " what is left no effect of the catalogue accounts."
    )


def _within_tolerance(diagnosis: Result, joint: str, ordinary: bool = False) -> list[str]:
    """Numbers of a joint that are off by less than their tolerance; of `ordinary` friction alone."""
    known = catalogue()
    return [
        f"{effect_name(w.effect)} {deviation(w.effect, w.value, w.joint in diagnosis.prismatic)}"
        for w in diagnosis.within_tolerance
        if w.joint == joint and (not ordinary or (w.effect in known and known[w.effect].ordinary))
    ]


def _by_which_law(diagnosis: Result, left: Remaining) -> str:
    """The law by which what is left of a joint follows a signal. What is left is counted beside the friction
    that the model claims, and that may be off."""
    friction = _within_tolerance(diagnosis, left.joint, ordinary=True)
    if friction and left.against in ("dq", "dtheta"):
        return f"as friction does that is off by no more than its tolerance ({listed(friction)})"
    return f"by a law that {'no named cause has' if diagnosis.findings else 'no effect of the catalogue has'}"


def _mostly_tolerances(joint: Remaining) -> bool:
    """Whether numbers within their tolerances remove most of a joint's torque error."""
    return joint.after < 0.5 * joint.before


# ------------------------------------------------------------------ is it all?
def _left(diagnosis: Result, joints: Joints) -> tuple[str, ...]:
    remaining = diagnosis.remaining
    first, most = torque.most_wrong(remaining), torque.most_left(remaining)
    if first is None or most is None:
        return uncovered(diagnosis, joints) or (
            "No joint's torque was compared on unseen data: what is left is not known.",
        )
    if not diagnosis.findings:
        first = most
    lines = [_of_joint(first, joints, "are left at")]
    if torque.of_torque(most) > torque.of_torque(first):
        lines.append(_of_joint(most, joints, "are left at", "Most, for its torque: "))
    shape = torque.shaped(remaining)
    if shape is not None:
        lines.append(
            f"Of what is left at {clean(shape.joint)}, {joints.torque(shape.joint, shape.structured)} follow"
            f" {joints.signal(shape.against)}, {_by_which_law(diagnosis, shape)}."
        )
    elif diagnosis.verdict == "unexplained" and not pushes(diagnosis, joints):
        lines.append(f"What is left at {clean(most.joint)} follows no single signal.")
    if diagnosis.verdict == "unexplained" and most.after <= USUAL.verdict.above_noise * most.noise:
        lines += _above_noise(diagnosis.energy[1])
    if possible(diagnosis):
        lines.append("This is with the possible causes, too, which are not in the extended model.")
    if diagnosis.verdict == "unexplained" and likely(diagnosis):
        lines.append("So the causes named are not all of it.")
    return (*lines, *uncovered(diagnosis, joints))


def _above_noise(energy: float) -> tuple[str, ...]:
    """How far all balances together exceed the noise, as no joint's torque does so by itself: noise of high
    frequency makes most of a torque's."""
    if not (math.isfinite(energy) and energy > 1.0):
        return ()
    times = number(math.sqrt(energy), 2)
    return (
        "In that torque it hides in the sensors' noise. All balances together, each frequency weighed by"
        f" its own noise, are left at {times} times the noise.",
    )


def _of_joint(left: Remaining, joints: Joints, verb: str, opening: str = "") -> str:
    share = percent(ratio(left.after, left.before))
    # an error of a spring moves torque from the motor to the link: their sum was right before
    wrong = left.before > USUAL.verdict.above_noise * left.noise
    of = f" of {joints.torque(left.joint, left.before)}" if wrong else ""
    text = f"{opening}{joints.torque(left.joint, left.after)}{of} {verb} {clean(left.joint)}"
    text += f" ({share})" if wrong else ""
    parts = []
    if left.torque > 0.0:
        parts.append(f"{percent(left.after / left.torque)} of its torque")
    if left.noise > 0.0:
        times = left.after / left.noise
        parts.append(
            "no more than sensor noise" if times < AS_NOISE else f"{number(times, 2)} times sensor noise"
        )
    return sentence(f"{text}: {listed(parts)}" if parts else text)


def uncovered(diagnosis: Result, joints: Joints) -> tuple[str, ...]:
    """What is left of balances that no joint's torque error holds: the springs', and joints without motor
    torques."""
    counted = {left.joint for left in diagnosis.remaining}
    pushed = pushes(diagnosis, joints) if diagnosis.findings else ()
    return pushed + tuple(
        f"{percent(u.share)} of the {clean(u.balance)} balance's squared error at {clean(u.joint)} is left;"
        f" it depends most on {joints.signal(u.against)}."
        for u in diagnosis.unexplained
        if u.begin is None and (u.balance == "spring" or u.joint not in counted)
    )


def pushes(diagnosis: Result, joints: Joints) -> tuple[str, ...]:
    """What acted from outside, and when."""
    return tuple(
        f"An outside force acts on the link of {clean(u.joint)} from {u.begin:.1f} to {u.end:.1f} s, with"
        f" about {joints.torque(u.joint, u.torque)} at this joint: no signal of the robot goes with it."
        for u in diagnosis.unexplained
        if u.begin is not None and u.end is not None and u.torque is not None
    )


# ------------------------------------------------------------------ is it this law?
def _law(diagnosis: Result) -> tuple[str, ...]:
    tied = ties(diagnosis)
    if not tied and likely(diagnosis):
        tied = ("No other effect of the catalogue explains this recording as well.",)
    return (*tied, *_next(diagnosis))


def _next(diagnosis: Result) -> tuple[str, ...]:
    text = diagnosis.next_experiment.strip()
    if not text:
        return ()
    if text[1:2].islower():  # an ordinary word
        text = text[0].lower() + text[1:]
    return (sentence(f"Next experiment: {text}"),)


# ------------------------------------------------------------------ healthy, nothing named, refused
def _healthy(diagnosis: Result, gain: Gain | None) -> tuple[str, ...]:
    first = "The simulation agrees with the recording within the noise and the model's own tolerance."
    total = merit.overall(gain)
    if gain is None or total is None:
        return first, sentence(capital(diagnosis.reason))
    return first, f"{_departs(gain, total)}."


def _error_stays(diagnosis: Result, gain: Gain | None) -> tuple[str, ...]:
    total = merit.overall(gain)
    if gain is None or total is None:
        return ()
    worst = torque.most_left(diagnosis.remaining)
    if worst is not None and _mostly_tolerances(worst):
        return (f"{_departs(gain, total)}, with the nominal numbers as they are.",)
    return (f"{_departs(gain, total)}, and nothing that was tried removes it.",)


def _departs(gain: Gain, total: merit.Overall) -> str:
    floor = "" if math.isnan(total.floor) else f" (sensor noise alone: {percent(total.floor)})"
    return (
        f"Restarted from the measured state every {gain.horizon:g} s, the simulation differs by"
        f" {percent(total.before)} of the signals' standard deviation{floor}"
    )


def _refused(diagnosis: Result) -> tuple[str, ...]:
    first = sentence(f"This recording cannot carry a verdict: {diagnosis.reason}")
    second = "Nothing is claimed about the simulation, neither that it is right nor that it is wrong."
    todo = sentence(capital(diagnosis.next_experiment))
    return (first, second, f"What to do: {todo}") if todo else (first, second)
