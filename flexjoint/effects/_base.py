"""What a physical effect is: one small class in one file under `flexjoint/effects/`.

The simulator, the symbolic model, the identification, the report and the docs page all derive from
that one definition. An effect declares what its physics has and no more: it overrides only the
methods that apply. Laws are pure and elementwise; they take floats, NumPy arrays or CasADi expressions
alike (through `flexjoint.core.ops`) and never see M(q).

Signal flow of one joint, per tick:

    command tau_m -> COMMAND -> motor (MOTOR) -> phi = theta - q -> DEFLECTION -> SPRING -> link (LINK)
    states -> SENSOR -> readings -> (next tick) controller

BODY effects change the rigid body itself (inertial parameters, gravity), or how a rigid joint carries it.
"""

from __future__ import annotations

import enum
import re
from collections import namedtuple
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar

from flexjoint.core.errors import unknown
from flexjoint.core.ops import Value
from flexjoint.core.parameter import Parameter


class Site(enum.Enum):
    """Where in the signal flow an effect acts."""

    COMMAND = "command"
    MOTOR = "motor"
    DEFLECTION = "deflection"
    SPRING = "spring"
    LINK = "link"
    BODY = "body"
    SENSOR = "sensor"


class Kind(enum.StrEnum):
    """What sort of cause an effect is, as reported to the user."""

    MECHANICAL = "mechanical"
    PARAMETER = "parameter"
    TIMING = "timing"
    SENSOR = "sensor"


@dataclass(frozen=True)
class Word:
    """A parameter that is a word (which channel a sensor effect concerns); None means all of them."""

    name: str
    choices: tuple[str | None, ...]
    value: str | None


@dataclass(frozen=True)
class Source:
    """Who states a typical size, and where that can be read."""

    name: str
    address: str


@dataclass(frozen=True)
class Typical:
    """A size that an effect has on a real machine or part: units that its maker uses, and SI."""

    size: str
    source: Source


@dataclass(slots=True)
class Signals:
    """What a law may see, of one joint: at one instant, or over a whole recording (arrays alike).

    Link-referred, SI. `phi` is the deflection theta - q; for SPRING laws it is what the deflection
    effects leave of it (inside a backlash it is 0). `tau_t` is the whole transmission torque, damping
    included. `t` is the time from the start of the recording [s]. `tau_m_before` and `tau_m_after` are the
    commands of the joints before and after this one in the robot's order, 0 where there is none.
    """

    t: Value = 0.0
    q: Value = 0.0
    dq: Value = 0.0
    theta: Value = 0.0
    dtheta: Value = 0.0
    phi: Value = 0.0
    dphi: Value = 0.0
    tau_t: Value = 0.0
    tau_m: Value = 0.0
    tau_m_before: Value = 0.0
    tau_m_after: Value = 0.0


@dataclass(frozen=True)
class Drive:
    """The numbers of one joint's actuator: tau_t = K phi + D dphi, B ddtheta + D_m dtheta + tau_t = tau."""

    K: Value
    D: Value
    B: Value
    D_m: Value

    def scaled(self, **factors: Value) -> Drive:
        """The same drive with some numbers multiplied."""
        return replace(self, **{name: getattr(self, name) * factor for name, factor in factors.items()})


SENSOR_CHANNELS = ("q", "dq", "theta", "dtheta", "tau_t")
_CAMEL = re.compile(r"(?<!^)(?=[A-Z])")


class Effect:
    """Base of all effects; a subclass overrides only what its physics has."""

    site: ClassVar[Site]
    kind: ClassVar[Kind] = Kind.MECHANICAL
    params: ClassVar[tuple[Parameter, ...]] = ()
    words: ClassVar[tuple[Word, ...]] = ()
    law: ClassVar[str] = ""  # LaTeX
    against: ClassVar[str] = "t"  # the signal its residual is plotted against
    reference: ClassVar[str] = ""
    typical: ClassVar[tuple[Typical, ...]] = ()  # empty where no source was found that states one
    states: ClassVar[tuple[float, ...]] = ()  # initial values of the internal states
    whole_robot: ClassVar[bool] = False  # acts on the robot, not on a joint (`joint` is null)
    max_delay: ClassVar[float] = 0.0
    contains: ClassVar[tuple[str, ...]] = ()  # simpler effects that are special cases of this one
    alike: ClassVar[tuple[str, ...]] = ()  # numbers that, being equal, leave the effect that it contains
    known_as: ClassVar[tuple[str, ...]] = ()  # effects as which it is named where they fit as well
    on_rigid: ClassVar[str] = ""  # the effect of the motor that it is one with where there is no spring
    repeats: ClassVar[str] = ""  # number of cycles of a law that is periodic in `against`, or its channel
    common: ClassVar[bool] = False  # several joints often have it by one value: one clock, one scale
    ordinary: ClassVar[bool] = False  # every drive has it: looked for first on a joint that leaves much
    needs_spring: ClassVar[bool] = False  # means nothing on a joint of infinite stiffness
    for_rigid: ClassVar[bool] = False  # gives a rigid joint a spring: needs one of infinite stiffness
    jumps: ClassVar[bool] = False  # its channel's reading jumps where it sets in
    comes_and_goes: ClassVar[bool] = False  # may cease during a recording and act again
    is_cause: ClassVar[bool] = True  # whether a diagnosis may name it; a learned law has no name

    # --- what an effect can do -------------------------------------------------------------------
    def map(self, s: Signals, p: Any, x: Value) -> Value:
        """COMMAND, DEFLECTION, SENSOR: the signal after the effect, from the signal x before it."""
        return x

    def slope(self, s: Signals, p: Any) -> Value:
        """DEFLECTION: d map / d phi (what is left of the damping too). SPRING: d torque / d phi."""
        return 1.0 if self.site is Site.DEFLECTION else 0.0

    def torque(self, s: Signals, p: Any, z: Value) -> Value:
        """SPRING: torque added to tau_t. MOTOR, LINK: torque acting on that body. COMMAND: torque added to
        the commanded one, by an internal state; s.tau_m is the command as it reaches this effect."""
        return 0.0

    def level(self, s: Signals, p: Any, z: Value) -> Value:
        """MOTOR, LINK: bound of a dry friction, >= 0, at the internal state z (0 without one). Schemes treat
        it as a set (it sticks)."""
        return 0.0

    def shares(self, p: Any) -> tuple[Value, Value]:
        """MOTOR: the shaft on which it acts turns by so much for a turn of this joint's motor, and of the one
        of the joint before. Its law sees that shaft, and its torque acts on both motors by the same shares
        (virtual work)."""
        return 1.0, 0.0

    def shafts(self, p: Any) -> tuple[tuple[Effect, Mapping[str, Any]], ...]:
        """MOTOR: the effects of which it is made, each on a shaft of its own (`shares`), with their values;
        empty for one that is not made of others."""
        return ()

    def rate(self, s: Signals, p: Any, z: Value) -> Value:
        """Time derivative of the internal state z, affine in z."""
        return 0.0

    def steady_state(self, s: Signals, p: Any) -> Value:
        """The internal state where a motion begins whose signals were constant for long. A state that
        overrides this runs before the effect sets in, too."""
        return self.states[0] if self.states else 0.0

    def delay(self, p: Any) -> Value:
        """COMMAND, SENSOR: dead time [s]."""
        return 0.0

    def channels(self, p: Any) -> tuple[str, ...]:
        """SENSOR: the channels that it concerns."""
        return ()

    def edit_drive(self, drive: Drive, p: Any) -> Drive:
        """The joint's actuator numbers as this effect changes them."""
        return drive

    def edit_inertial(self, inertial: Any, p: Any) -> Any:
        """BODY: the link's ten dynamic parameters (m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the joint
        frame's origin; pin's order) as this effect changes them: a list of ten values."""
        return inertial

    def edit_gravity(self, gravity: Any, p: Any) -> Any:
        """BODY: the gravity vector in the base frame as this effect changes it: a list of three values."""
        return gravity

    def starts(self, s: Signals) -> tuple[dict[str, float], ...]:
        """Where a fit should start, given measured signals (arrays): values of the shape and of the
        non-linear parameters. One empty dict: a law linear in all its parameters needs no start."""
        return ({},)

    def possible(self, drive: Drive) -> bool:
        """Whether a joint with these nominal numbers may have it as a cause: a scale of a number that is 0
        changes nothing."""
        return True

    def largest(self, s: Signals) -> Mapping[str, float]:
        """What parameters, by name, can be at most on a joint with these measured signals (arrays), where
        that is less than their own bound."""
        return {}

    # --- derived ---------------------------------------------------------------------------------
    @property
    def name(self) -> str:
        """As files and `effect` take it: motor_coulomb_friction of MotorCoulombFriction."""
        return _name(type(self))  # type: ignore[arg-type]

    def overrides(self, method: str) -> bool:
        """Whether this effect has the named piece of physics."""
        return getattr(type(self), method) is not getattr(Effect, method)

    @property
    def reaches_before(self) -> bool:
        """Whether it acts on the joint before its own as well."""
        return self.overrides("shares") or self.overrides("shafts")

    @property
    def nulls(self) -> tuple[Parameter, ...]:
        """The parameters whose null value makes the effect absent."""
        return tuple(p for p in self.params if p.null is not None)

    def parameters(self, values: Mapping[str, Any]) -> Any:
        """A record of all parameters and words; those not given take their default.

        Raises ModelError for an unknown name, a wrong shape or a value outside the bounds.
        """
        record = _record(type(self))  # type: ignore[arg-type]
        for given in values:
            if given not in record._fields:
                raise unknown(f"parameter of {self.name}", given, record._fields)
        out: dict[str, Any] = {}
        for param in self.params:
            value = values.get(param.name, param.value if param.size == 1 else (param.value,) * param.size)
            out[param.name] = value
        for word in self.words:
            value = values.get(word.name, word.value)
            if value not in word.choices:
                raise unknown(f"{word.name} of {self.name}", value, word.choices)
            out[word.name] = value
        return record(**out)


@cache
def _name(kind: Any) -> str:
    return _CAMEL.sub("_", kind.__name__).lower()


@cache
def _record(kind: Any) -> Any:
    return namedtuple(
        kind.__name__ + "Parameters", [p.name for p in kind.params] + [w.name for w in kind.words]
    )
