"""Effects with kinks (dry friction, play, limits) made fit for a linearisation, as the caller chooses.

A law's kinks are found in its own CasADi expression, and its describing function is the first harmonic of its
own
values: nothing about an effect is written a second time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.ops import Value
from flexjoint.effects import Drive, Effect, Planned, Signals, Site

Nonsmooth = Literal["null", "slope", "describing"]
CHOICES: Mapping[str, str] = {
    "null": "leave them out",
    "slope": "take the local slope of their laws at the point",
    "describing": "take their first harmonic at the amplitudes given",
}
SIGNALS = tuple(field.name for field in fields(Signals) if field.name != "t")
POINTS = 20_000  # of a cycle: the first harmonic of a square wave is then right to 1e-8
_KINKS = frozenset(
    getattr(ca, f"OP_{name}")
    for name in (
        "FABS",
        "FMIN",
        "FMAX",
        "IF_ELSE_ZERO",
        "SIGN",
        "LT",
        "LE",
        "EQ",
        "NE",
        "FLOOR",
        "CEIL",
        "COPYSIGN",
    )
)


def has_kinks(planned: Planned) -> bool:
    """Whether a law of the effect is not differentiable everywhere: dry friction, or an absolute value, limit
    or case in its expression."""
    if planned.effect.overrides("level"):
        return True
    s, z = Signals(**{name: ca.SX.sym(name) for name in (*SIGNALS, "t")}), ca.SX.sym("z")
    effect, p = planned.effect, planned.p
    laws = [effect.map(s, p, s.phi), effect.torque(s, p, z), effect.rate(s, p, z)]
    function = ca.Function(
        "laws", [*(getattr(s, name) for name in (*SIGNALS, "t")), z], [ca.SX(x) for x in laws]
    )
    return any(function.instruction_id(k) in _KINKS for k in range(function.n_instructions()))


def kinked(effects: Iterable[Planned]) -> tuple[Planned, ...]:
    """Those of the effects that have kinks."""
    return tuple(planned for planned in effects if has_kinks(planned))


def describing(planned: Planned, at: Signals, amplitude: Mapping[str, float]) -> Planned:
    """The effect with each law replaced by its first harmonic about the signals `at`, one signal swinging at
    a time.

    A dry friction becomes a damper of its joint's velocity. An internal state keeps its place: it becomes the
    first order lag with the same first harmonic, for a swing of the position and velocity amplitudes given.

    Args:
        amplitude: by signal name (q, dq, theta, dtheta, phi, dphi, tau_t, tau_m), > 0, in its unit.

    Raises:
        ModelError: an amplitude is missing (the message names it), or a sensor's law has kinks.

    Source: Gelb and Vander Velde 1968, chapter 2 (sinusoidal-input describing function).
    """
    effect, p = planned.effect, planned.p
    if effect.site is Site.SENSOR:
        raise ModelError(f"{planned}: no describing function of a sensor; choose nonsmooth='slope' or 'null'")
    if effect.overrides("shafts"):
        made_of: tuple[tuple[Effect, Mapping[str, Any]], ...]
        made_of = tuple((describing(one, at, amplitude).effect, {}) for one in planned.parts)
        return replace(planned, effect=_Shafts(planned, made_of), values={})
    if effect.states and not effect.overrides("level"):
        quasi: _Quasi = _Lag(planned, _same_harmonic(planned, amplitude))
        return replace(planned, effect=quasi, values={})
    own = {Site.COMMAND: "tau_m", Site.DEFLECTION: "phi"}.get(effect.site, "")
    velocity = "dtheta" if effect.site is Site.MOTOR else "dq"

    def law(s: Signals) -> Value:
        if own:
            return effect.map(s, p, getattr(s, own))
        return effect.torque(s, p, 0.0)

    def friction(s: Signals) -> Value:
        # what a rest has built up is worn off by what swings
        return -effect.level(s, p, 0.0) * np.sign(getattr(s, velocity))

    gains = {name: _harmonic(law, at, name, _of(amplitude, name, planned)) for name in _signals_of(law)}
    if effect.overrides("level"):
        swing = _of(amplitude, velocity, planned)
        gains[velocity] = gains.get(velocity, 0.0) + _harmonic(friction, at, velocity, swing)
    line = _Line(own, float(law(at)), gains, {name: float(getattr(at, name)) for name in gains})
    return replace(planned, effect=_Map(planned, line) if own else _Torque(planned, line), values={})


@dataclass(frozen=True)
class _Line:
    """offset + sum of gains times what the signals differ from `about`; `own` is the signal that a map
    passes."""

    own: str
    offset: float
    gains: Mapping[str, float]
    about: Mapping[str, float]

    def value(self, s: Signals, x: Value = 0.0) -> Value:
        out = self.offset
        for name, gain in self.gains.items():
            out = out + gain * ((x if name == self.own else getattr(s, name)) - self.about[name])
        return out


class _Quasi(Effect):
    """Stands in an effect's place: its site, its name (the order in the flow), its drive."""

    def __init__(self, planned: Planned) -> None:
        self._effect, self._p = planned.effect, planned.p
        self.site = planned.effect.site  # type: ignore[misc]
        self.states = planned.effect.states  # type: ignore[misc]
        self.needs_spring = planned.effect.needs_spring  # type: ignore[misc]

    @property
    def name(self) -> str:
        return self._effect.name

    @property
    def reaches_before(self) -> bool:
        return self._effect.reaches_before

    def shares(self, p: Any) -> tuple[Value, Value]:
        return self._effect.shares(self._p)

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        return self._effect.edit_drive(drive, self._p)


class _Map(_Quasi):
    def __init__(self, planned: Planned, line: _Line) -> None:
        super().__init__(planned)
        self._line = line

    def map(self, s: Signals, p: Any, x: Value) -> Value:
        return self._line.value(s, x)

    def slope(self, s: Signals, p: Any) -> Value:
        return self._line.gains.get("phi", 1.0)


class _Torque(_Quasi):
    def __init__(self, planned: Planned, line: _Line) -> None:
        super().__init__(planned)
        self._line = line

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return self._line.value(s)


class _Shafts(_Quasi):
    def __init__(self, planned: Planned, made_of: tuple[tuple[Effect, Mapping[str, Any]], ...]) -> None:
        super().__init__(planned)
        self._made_of = made_of

    def shafts(self, p: Any) -> tuple[tuple[Effect, Mapping[str, Any]], ...]:
        return self._made_of


class _Lag(_Quasi):
    """dz/dt = gain v - rate z, beside the effect's own torque."""

    def __init__(self, planned: Planned, lag: tuple[str, float, float]) -> None:
        super().__init__(planned)
        self._velocity, self._gain, self._rate = lag

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        return self._effect.torque(s, self._p, z)

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        return self._gain * getattr(s, self._velocity) - self._rate * z


def _signals_of(law: Callable[[Signals], Value]) -> list[str]:
    """The signals on which a law depends."""
    symbols = {name: ca.SX.sym(name) for name in (*SIGNALS, "t")}
    value = ca.SX(law(Signals(**symbols)))
    return [name for name, symbol in symbols.items() if name != "t" and ca.depends_on(value, symbol)]


def _of(amplitude: Mapping[str, float], name: str, planned: Planned) -> float:
    for given in amplitude:
        if given not in SIGNALS:
            raise unknown("signal of an amplitude", given, SIGNALS)
    if not amplitude.get(name, 0.0) > 0.0:
        raise ModelError(
            f"{planned} needs the amplitude of {name}, > 0: how far it swings in the motion that you design"
            f" for; got"
            f" {dict(amplitude)}"
        )
    return float(amplitude[name])


def _harmonic(law: Callable[[Signals], Value], at: Signals, name: str, amplitude: float) -> float:
    """First harmonic, over the amplitude, of the law's value while the named signal swings."""
    psi = 2.0 * math.pi * (np.arange(POINTS) + 0.5) / POINTS
    swing = replace(at, **{name: getattr(at, name) + amplitude * np.sin(psi)})
    return float(2.0 * np.mean(law(swing) * np.sin(psi)) / amplitude)


def _same_harmonic(planned: Planned, amplitude: Mapping[str, float]) -> tuple[str, float, float]:
    """The velocity that drives an internal state, and gain a and rate b of dz/dt = a v - b z whose z has the
    first harmonic that the law's own z has, once periodic."""
    effect, p = planned.effect, planned.p
    driven = _signals_of(lambda s: effect.rate(s, p, 0.0))
    if len(driven) != 1 or not driven[0].startswith("d"):
        raise ModelError(
            f"{planned}: no describing function of a state driven by {', '.join(driven) or 'nothing'}"
        )
    velocity = driven[0]
    position = {"dphi": "phi", "dtheta": "theta", "dq": "q"}[velocity]
    speed, swing = _of(amplitude, velocity, planned), _of(amplitude, position, planned)
    omega = speed / swing
    h = 2.0 * math.pi / (POINTS * omega)
    psi = 2.0 * math.pi * (np.arange(POINTS) + 0.5) / POINTS
    s = Signals(**{velocity: speed * np.cos(psi)})
    push = np.broadcast_to(effect.rate(s, p, 0.0), psi.shape)
    decay = push - effect.rate(s, p, 1.0)  # the rate is linear in z, as the flow's own integration has it
    keep = np.exp(-h * decay)
    add = push * np.where(h * decay > 1e-9, -np.expm1(-h * decay) / np.maximum(decay, 1e-300), h)
    # a cycle is an affine map of the state at its start: its fixed point is the periodic solution
    _, end = _cycle(keep, add, 0.0)
    tape, _ = _cycle(keep, add, end / -math.expm1(float(np.sum(-h * decay))))
    in_phase, ahead = 2.0 * np.mean(tape * np.sin(psi)) / swing, 2.0 * np.mean(tape * np.cos(psi)) / swing
    rate = omega * ahead / in_phase  # z / position = j omega a / (j omega + b) at this omega
    return velocity, in_phase + ahead * ahead / in_phase, rate


def _cycle(keep: np.ndarray, add: np.ndarray, z: float) -> tuple[np.ndarray, float]:
    """The state amid the steps z -> keep z + add of a cycle, and at its end."""
    tape = np.empty(len(keep))
    for k, (share, more) in enumerate(zip(keep.tolist(), add.tolist(), strict=True)):
        after = share * z + more
        tape[k], z = 0.5 * (z + after), after
    return tape, z
