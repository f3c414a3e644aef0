"""The signal flow of one actuated joint, written once for floats, arrays over time and CasADi alike.

    command tau_m -> COMMAND -> motor (MOTOR) -> phi = theta - q -> DEFLECTION -> SPRING -> link (LINK)
    states -> SENSOR -> readings

Schemes, the continuous dynamics, the symbolic model and the sensor readings all evaluate effects here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flexjoint.core import ops
from flexjoint.core.ops import Value
from flexjoint.effects import Drive, Effect, Signals, Site
from flexjoint.model.springs import VariableSpring
from flexjoint.robot.robot import Joint

STEP = 1e-4  # relative step of the difference quotients below, whose laws are linear or smooth on that scale
SMALL = 1e-6  # stands for a decay of 0 in (1 - exp(-x)) / x, whose error there is below 1e-6
SMALL_MEAN = 1e-4  # the same in a mean's (1 - (1 - exp(-x)) / x) / x, which loses more digits
TURNING = (Site.COMMAND, Site.MOTOR)  # whose laws see the motor
INVERSION_ROUNDS = 8  # of Newton's method in `corrected`; it squares an error of 1e-2 in each


@dataclass(frozen=True)
class Part:
    """One effect at work on a joint: its parameters, the place of its internal state in z (-1: none), and its
    own in `signal_order`."""

    effect: Effect
    p: Any
    slot: int = -1
    place: int = 0


class JointFlow:
    """The effects of one joint, given in `signal_order`, with its drive numbers as they change them.

    Of effects that are `asleep` only the internal state runs.
    """

    def __init__(
        self,
        joint: Joint,
        parts: Sequence[Part],
        spring: VariableSpring | None = None,
        asleep: Sequence[Part] = (),
    ) -> None:
        self.joint = joint
        self.spring = spring  # commanded, in place of the drive's K and D
        self.drive: Drive = joint.drive
        for part in parts:
            self.drive = part.effect.edit_drive(self.drive, part.p)
        self._command = [x for x in parts if _does(x, Site.COMMAND, "map", "torque")]
        self._deflection = [x for x in parts if _does(x, Site.DEFLECTION, "map", "slope")]
        self._spring = [x for x in parts if _does(x, Site.SPRING, "torque")]
        self._motor = [x for x in parts if _does(x, Site.MOTOR, "torque")]
        self._rubbing = [x for x in parts if _does(x, Site.MOTOR, "level")]
        self._link = [x for x in parts if _does(x, Site.LINK, "torque")]
        self._link_rubbing = [x for x in parts if _does(x, Site.LINK, "level")]
        self._sensors = [x for x in parts if x.effect.site is Site.SENSOR]
        self._late = [x for x in parts if _does(x, Site.COMMAND, "delay")]
        self.stateful = [x for x in (*parts, *asleep) if x.slot >= 0]
        self.nonlinear_spring = bool(self._deflection or self._spring or spring)
        self.motor_rubs = bool(self._rubbing)
        self.link_rubs = bool(self._link_rubbing)
        acting = self._command or self._motor or self._link or self.stateful or self.nonlinear_spring
        self.busy = bool(acting) or self.motor_rubs or self.link_rubs  # beyond a linear spring and a motor

    # --- command ---------------------------------------------------------------------------------
    def command(self, s: Signals, tau: Value, z: Any, ahead: float = 0.0) -> Value:
        """The motor's torque from the commanded one, delays aside: its mean over the next `ahead` seconds, by
        which an internal state gives the right impulse however fast it is."""
        return self._through(self._command, s, tau, lambda part: _mean_state(part, s, z, ahead))

    def steady_command(self, s: Signals, tau: Value) -> Value:
        """The same for a command that has been constant for long."""
        return self._steady(self._command, s, tau)

    def steady_state(self, s: Signals, tau: Value) -> list[tuple[int, Value]]:
        """Place and value of each internal state that follows a command, after that was constant for long."""
        found = []
        for k, part in enumerate(self._command):
            if part.slot >= 0:
                reaching = replace(s, tau_m=self._steady(self._command[:k], s, tau))
                found.append((part.slot, part.effect.steady_state(reaching, part.p)))
        return found

    def _steady(self, parts: Sequence[Part], s: Signals, tau: Value) -> Value:
        return self._through(parts, s, tau, lambda part: part.effect.steady_state(s, part.p))

    def _through(
        self, parts: Sequence[Part], s: Signals, tau: Value, state: Callable[[Part], Value]
    ) -> Value:
        commanded = s.tau_m
        for part in parts:
            if part.slot < 0:
                tau = part.effect.map(s, part.p, tau)
            else:
                s.tau_m = tau
                tau = tau + part.effect.torque(s, part.p, state(part))
        s.tau_m = commanded
        return tau

    def command_delay(self) -> Value:
        """Dead time of the command [s]."""
        return sum((part.effect.delay(part.p) for part in self._late), 0.0)

    @property
    def max_command_delay(self) -> float:
        return sum(part.effect.max_delay for part in self._late)

    # --- transmission ----------------------------------------------------------------------------
    def spring_at(self, t: Value) -> tuple[Value, Value]:
        """K and D of the transmission at a time."""
        if self.spring is None:
            return self.drive.K, self.drive.D
        damping = self.drive.D if self.spring.damping is None else self.spring.damping(t)
        return self.spring.stiffness(t), damping

    def _deflect(self, s: Signals) -> Value:
        """Leave in s.phi and s.dphi what the deflection effects pass on; d phi' / d phi."""
        slope: Value = 1.0
        for part in self._deflection:
            slope = slope * part.effect.slope(s, part.p)
            s.phi = part.effect.map(s, part.p, s.phi)
        s.dphi = slope * s.dphi
        return slope

    def transmission(self, s: Signals, z: Any, ahead: float = 0.0) -> Value:
        """tau_t = K phi' + D dphi' and the spring effects' torques (formats: inside a play both vanish);
        internal states as they will be `ahead` seconds on."""
        phi, dphi = s.phi, s.dphi
        self._deflect(s)
        stiffness, damping = self.spring_at(s.t)
        tau = stiffness * s.phi + damping * s.dphi
        for part in self._spring:
            tau = tau + part.effect.torque(s, part.p, _state(part, s, z, ahead))
        s.phi, s.dphi = phi, dphi
        return tau

    def linear_spring(self, s: Signals, z: Any, ahead: float) -> tuple[Value, Value, Value]:
        """`transmission` with its derivatives by phi and dphi: what the linearly implicit scheme needs."""
        phi, dphi = s.phi, s.dphi
        slope = self._deflect(s)
        stiffness, damping = self.spring_at(s.t)
        tau = stiffness * s.phi + damping * s.dphi
        for part in self._spring:
            stiffness = stiffness + part.effect.slope(s, part.p)
            if part.slot < 0:
                tau = tau + part.effect.torque(s, part.p, 0.0)
            else:
                torque, by_velocity = _by_velocity(part, s, z, ahead, "dphi")
                tau, damping = tau + torque, damping + ops.maximum(by_velocity, 0.0)
        s.phi, s.dphi = phi, dphi
        return tau, slope * stiffness, slope * damping

    # --- bodies ----------------------------------------------------------------------------------
    def motor(self, s: Signals, z: Any, ahead: float) -> tuple[Value, Value]:
        """Torque of the motor effects and how much of it resists the motor's velocity [N m s/rad]."""
        return _resisting(self._motor, s, z, ahead, "dtheta")

    def link(self, s: Signals, z: Any, ahead: float) -> tuple[Value, Value]:
        """Torque of the link effects and how much of it resists the link's velocity [N m s/rad]."""
        return _resisting(self._link, s, z, ahead, "dq")

    def torques(self, s: Signals, z: Any) -> tuple[Value, Value]:
        """Torques of the motor and of the link effects, dry friction aside."""
        motor, link = 0.0, 0.0
        for part in self._motor:
            motor = motor + part.effect.torque(s, part.p, _state(part, s, z, 0.0))
        for part in self._link:
            link = link + part.effect.torque(s, part.p, _state(part, s, z, 0.0))
        return motor, link

    def motor_level(self, s: Signals, z: Any) -> Value:
        """Bound of the motor's dry friction."""
        return _level(self._rubbing, s, z)

    def link_level(self, s: Signals, z: Any) -> Value:
        """Bound of the link's dry friction."""
        return _level(self._link_rubbing, s, z)

    def rates(self, s: Signals, z: Any, shaft: Signals | None = None) -> list[tuple[int, Value]]:
        """Place and time derivative of each internal state; `shaft` are the signals of the motor where these
        are not the joint's."""
        return self._of_states(s, z, shaft, lambda part, s: part.effect.rate(s, part.p, z[part.slot]))

    def advanced(
        self, s: Signals, z: Any, ahead: float, shaft: Signals | None = None
    ) -> list[tuple[int, Value]]:
        """Place and value, `ahead` seconds on, of each internal state; s holds the signals on the way."""
        return self._of_states(s, z, shaft, lambda part, s: _state(part, s, z, ahead))

    def _of_states(
        self, joint: Signals, z: Any, shaft: Signals | None, value: Callable[[Part, Signals], Value]
    ) -> list[tuple[int, Value]]:
        found = []
        for part in self.stateful:
            s = joint if shaft is None or part.effect.site not in TURNING else shaft
            phi, dphi, commanded = s.phi, s.dphi, s.tau_m
            if part.effect.site is Site.SPRING:
                self._deflect(s)
            elif part.effect.site is Site.COMMAND:
                before = [x for x in self._command if x.place < part.place]
                s.tau_m = self._through(before, s, commanded, lambda other: z[other.slot])
            found.append((part.slot, value(part, s)))
            s.phi, s.dphi, s.tau_m = phi, dphi, commanded
        return found

    # --- sensors ---------------------------------------------------------------------------------
    def read(self, channel: str, s: Signals, x: Value) -> Value:
        """A sensor's reading of the true x, delays aside."""
        for part in self._sensors:
            if channel in part.effect.channels(part.p):
                x = part.effect.map(s, part.p, x)
        return x

    def corrected(self, channel: str, s: Signals, reading: Value) -> Value:
        """The true value behind a reading, delays aside, by Newton's method; the reading itself where the
        sensor's slope is 0."""
        x = reading
        if self.reads_true(channel):
            return x
        for _ in range(INVERSION_ROUNDS):
            seen = self.read(channel, s, x)
            slope = (self.read(channel, s, x + STEP) - seen) / STEP
            x = x - (seen - reading) / ops.where(ops.absolute(slope) > STEP, slope, 1.0)
        return x

    def reads_true(self, channel: str) -> bool:
        """Whether no sensor effect concerns the channel."""
        return not any(channel in part.effect.channels(part.p) for part in self._sensors)

    def reading_delay(self, channel: str) -> Value:
        """Dead time of a reading [s]."""
        late = (part for part in self._sensors if channel in part.effect.channels(part.p))
        return sum((part.effect.delay(part.p) for part in late), 0.0)

    def max_reading_delay(self, channel: str) -> float:
        late = (part for part in self._sensors if channel in part.effect.channels(part.p))
        return sum(part.effect.max_delay for part in late)


def neighbours(values: Any, i: int) -> tuple[Value, Value]:
    """What the joints before and after joint i have of values of all joints; 0 where there is none."""
    count = values.shape[0] if hasattr(values, "shape") else len(values)  # of CasADi, len counts no rows
    return values[i - 1] if i > 0 else 0.0, values[i + 1] if i + 1 < count else 0.0


def _does(part: Part, site: Site, *methods: str) -> bool:
    return part.effect.site is site and any(part.effect.overrides(method) for method in methods)


def _level(parts: Sequence[Part], s: Signals, z: Any) -> Value:
    return sum((part.effect.level(s, part.p, _state(part, s, z, 0.0)) for part in parts), 0.0)


def _state(part: Part, s: Signals, z: Any, ahead: float) -> Value:
    """The internal state `ahead` seconds on: its rate, linear in itself, integrated exactly (exponential
    Euler), so it stays bounded for any rate constant."""
    if part.slot < 0:
        return 0.0
    now = z[part.slot]
    if not ops.is_symbolic(ahead) and ahead == 0.0:
        return now
    rate, decay = _rate_and_decay(part, s, now)
    x = ops.maximum(ahead * decay, SMALL)
    return now + ahead * rate * (1.0 - ops.exp(-x)) / x


def _mean_state(part: Part, s: Signals, z: Any, ahead: float) -> Value:
    """The internal state's mean over the next `ahead` seconds, exact as `_state` is."""
    now = z[part.slot]
    if not ops.is_symbolic(ahead) and ahead == 0.0:
        return now
    rate, decay = _rate_and_decay(part, s, now)
    x = ops.maximum(ahead * decay, SMALL_MEAN)
    return now + ahead * rate * (1.0 - (1.0 - ops.exp(-x)) / x) / x


def _rate_and_decay(part: Part, s: Signals, now: Value) -> tuple[Value, Value]:
    """The rate of an internal state, and minus its derivative by the state."""
    rate = part.effect.rate(s, part.p, now)
    step = STEP * (1.0 + ops.absolute(now))
    return rate, (rate - part.effect.rate(s, part.p, now + step)) / step


def _by_velocity(part: Part, s: Signals, z: Any, ahead: float, name: str) -> tuple[Value, Value]:
    """A part's torque and its derivative by the named velocity, internal state included."""
    velocity = getattr(s, name)
    step = STEP * ops.where(velocity < 0.0, velocity - 1.0, velocity + 1.0)  # away from the kink at rest
    torque = part.effect.torque(s, part.p, _state(part, s, z, ahead))
    setattr(s, name, velocity + step)
    further = part.effect.torque(s, part.p, _state(part, s, z, ahead))
    setattr(s, name, velocity)
    return torque, (further - torque) / step


def _resisting(parts: Sequence[Part], s: Signals, z: Any, ahead: float, name: str) -> tuple[Value, Value]:
    torque, resistance = 0.0, 0.0
    for part in parts:
        more, slope = _by_velocity(part, s, z, ahead, name)
        torque = torque + more
        resistance = resistance + ops.maximum(-slope, 0.0)
    return torque, resistance
