"""Names and numbers as a person reads them; shared by the page and the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from flexjoint.core.units import of_joint
from flexjoint.diagnosis.result.values import Finding, Fitted
from flexjoint.effects import Kind, catalogue
from flexjoint.recording.table import UNITS
from flexjoint.robot.robot import Robot

MOST_SPANS = 4  # of time that are listed one by one
SIGNALS: Mapping[str, tuple[str, str]] = {
    "t": ("time", "s"),
    "q": ("link position q", "rad"),
    "dq": ("link velocity dq", "rad/s"),
    "ddq": ("link acceleration ddq", "rad/s²"),
    "theta": ("motor position theta", "rad"),
    "dtheta": ("motor velocity dtheta", "rad/s"),
    "ddtheta": ("motor acceleration ddtheta", "rad/s²"),
    "phi": ("deflection theta - q", "rad"),
    "dphi": ("deflection rate", "rad/s"),
    "tau_t": ("spring torque tau_t", "N m"),
    "tau_m": ("motor torque command tau_m", "N m"),
    "tau_m_before": ("torque command of the joint before", "N m"),
    "tau_m_after": ("torque command of the joint after", "N m"),
    "tau_motor": ("measured motor torque tau_motor", "N m"),
}
# Without springs the torque of a joint's load is not that of a spring, and there is no deflection.
RIGID: Mapping[str, str] = {"tau_t": "load torque tau_t", "phi": "load", "dphi": "load rate"}
NOTHING = "–"
_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck", "lugre": "LuGre", "dahl": "Dahl"}


@dataclass(frozen=True)
class Joints:
    """What words and units depend on: the joints that slide, and whether all of the robot's are rigid."""

    prismatic: frozenset[str] = frozenset()
    rigid: bool = False

    @classmethod
    def of(cls, robot: Robot) -> Joints:
        return cls(robot.prismatic, all(joint.rigid for joint in robot.joints))

    def unit(self, joint: str) -> str:
        """Of a torque error: N m, or N where the joint slides."""
        return unit_of("tau_t", joint in self.prismatic)

    def torque(self, joint: str, value: float) -> str:
        return with_unit(number(value), self.unit(joint))

    def fall(self, joint: str, before: float, after: float) -> str:
        """53 → 2.2 N."""
        return with_unit(f"{number(before)} → {number(after)}", self.unit(joint))

    def signal(self, name: str) -> str:
        return signal_name(name, self.rigid)


def clean(text: object) -> str:
    """Text of a file or a user without control and direction characters, which could garble a display."""
    return "".join(c if c.isprintable() else "\ufffd" for c in str(text))


def effect_name(name: str) -> str:
    """motor_coulomb_friction -> motor Coulomb friction."""
    return clean(" ".join(_PROPER.get(word, word) for word in name.split("_")))


def cause(effect: str, joint: str | None) -> str:
    """An effect and where it is: "backlash at elbow"; of the whole robot, its name alone."""
    return f"{effect_name(effect)} at {clean(joint)}" if joint is not None else effect_name(effect)


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def sentence(text: str) -> str:
    """Text that ends as a sentence does."""
    text = clean(text.strip())
    return text if not text or text[-1] in ".!?" else text + "."


def listed(items: Iterable[str], last: str = "and") -> str:
    """a, b and c."""
    *names, end = list(items) or [""]
    return f"{', '.join(names)} {last} {end}" if names else end


def unit_of(signal: str, prismatic: bool = False) -> str:
    """The unit of a channel or a derived signal of a joint; empty when unknown."""
    return of_joint(SIGNALS[signal][1] if signal in SIGNALS else UNITS.get(signal, ""), prismatic)


def signal_name(signal: str, rigid: bool = False) -> str:
    """A channel or derived signal in words; one of another joint, as "q.elbow", with that joint."""
    if rigid and signal in RIGID:
        return RIGID[signal]
    if signal in SIGNALS:
        return SIGNALS[signal][0]
    name, _, joint = signal.partition(".")
    if joint and name in SIGNALS:
        return f"{signal_name(name, rigid)} of {clean(joint)}"
    return clean(signal)


def with_unit(text: str, unit: str) -> str:
    """A number and its unit; a dimensionless number stands alone."""
    return text if unit in ("", "1", "-") else f"{text} {clean(unit)}"


def number(value: float | None, digits: int = 3) -> str:
    """A number to so many significant digits, without a power of ten below a million; a dash where there is
    none."""
    if value is None or not math.isfinite(value):
        return NOTHING
    return f"{float(f'{value:.{digits}g}'):g}" if abs(value) < 1e6 else f"{value:.{digits - 1}e}"


def percent(share: float | None) -> str:
    """0.871 -> 87 %, 0.0312 -> 3.1 %; never rounded up to certainty nor down to nothing."""
    if share is None or not math.isfinite(share):
        return NOTHING
    if 0 < abs(share) < 0.001:
        return "< 0.1 %"
    if 0.995 <= share < 1:
        return "> 99 %"
    return f"{100 * share:.1f} %" if 0 < abs(share) < 0.0995 else f"{round(100 * share)} %"


def less(before: float, after: float) -> str:
    """How far an error falls: 96 % less; or by how much it grew."""
    share = ratio(after, before)
    if not math.isfinite(share):
        return ""
    return f"{percent(1.0 - share)} less" if share <= 1.0 else f"{percent(share - 1.0)} more"


def ratio(one: float, other: float) -> float:
    """NaN where the other is not above zero."""
    return one / other if other > 0.0 else math.nan


def with_error(value: float, std: float) -> str:
    """A number and its standard error, both to the digits that the error supports: 0.0112 ± 0.0002."""
    if not (math.isfinite(value) and math.isfinite(std)) or std <= 0:
        return number(value, 4)
    largest = max(abs(value), std)
    power = 0 if 1e-4 <= largest < 1e6 else math.floor(math.log10(largest))
    value, std = value / 10.0**power, std / 10.0**power
    if std < 1e-6 * abs(value):  # a perfect fit: digits beyond six say nothing
        text = f"{value:.6g} ± {std:.1g}"
    else:
        place = -math.floor(math.log10(std))
        decimals = place + 1 if std * 10.0**place < 1.95 else place
        shown = max(decimals, 0)
        text = f"{round(value, decimals) + 0.0:.{shown}f} ± {round(std, decimals):.{shown}f}"
    return text if power == 0 else f"({text})e{power:+03d}"


def fitted(parameter: Fitted | str) -> str:
    """A fitted parameter in full: value, standard error, unit, and whether it sits on a bound."""
    if isinstance(parameter, str):
        return clean(parameter)
    values = parameter.value if isinstance(parameter.value, tuple) else (parameter.value,)
    errors = parameter.std if isinstance(parameter.std, tuple) else (parameter.std,) * len(values)
    pairs = [with_error(value, std) for value, std in zip(values, errors, strict=True)]
    text = with_unit(f"[{', '.join(pairs)}]" if len(pairs) > 1 else pairs[0], parameter.unit)
    return f"{text} (at its bound)" if parameter.at_bound else text


def parameters(finding: Finding) -> str:
    """All parameters of a finding in one line, and in the place of what it is."""
    text = ", ".join(f"{clean(name)} {fitted(value)}" for name, value in finding.parameters.items())
    return text if finding.instead_of is None else f"{text}, {finding.note}"


def values(effect: str, given: Mapping[str, Any], prismatic: bool = False) -> str:
    """Plain parameter values of an effect in one line, with the units that the catalogue states."""
    known = catalogue().get(effect)
    units = {p.name: p.unit_at(prismatic) for p in known.params} if known else {}
    parts = []
    for name, value in given.items():
        if value is None:
            continue
        if isinstance(value, (list, tuple)):
            shown = "[" + ", ".join(number(float(v)) for v in value) + "]"
        else:
            shown = clean(value) if isinstance(value, str) else number(float(value))
        parts.append(f"{clean(name)} {with_unit(shown, units.get(name, ''))}")
    return ", ".join(parts)


def deviation(effect: str, value: float, prismatic: bool = False) -> str:
    """By how much an effect's number is off: a scale reads as a percentage, anything else in the unit of its
    amplitude."""
    known = catalogue().get(effect)
    if known is not None and known.kind == Kind.PARAMETER:
        return f"{100 * value:+.2g} %"
    text = f"{'+' if value > 0.0 else ''}{number(value)}"
    return with_unit(text, known.params[0].unit_at(prismatic) if known and known.params else "")


def when(finding: Finding) -> str:
    """When a cause acts: always, since a time, or in some spans."""
    if not finding.during:
        return (
            "since the start of the recording"
            if finding.since is None
            else f"since t = {finding.since:.4g} s"
        )
    spans = [f"since {a:.4g} s" if b is None else f"{a:.4g} to {b:.4g} s" for a, b in finding.during]
    if len(spans) <= MOST_SPANS:
        return f"at t = {listed(spans)}"
    return f"{len(spans)} times, first at t = {spans[0]}, last at t = {spans[-1]}"
