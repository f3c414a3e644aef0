"""The laws of OUTSIDE: what real machines do beside what a catalogue lists.

u is the torque that the drive gives, w = dtheta, phi = theta - q, tau_t the torque in the transmission. Every
law is linear in its first parameter, but for `dead_command` and `position_filter`.

- drive, a torque on the motor: torque_droop -loss u (u/reference)^2, a motor that saturates; load_cogging
  share u S(cycles theta), a ripple that grows with the current; cogging_series amplitude S(cycles theta);
  heated_drive -loss (1 - exp(-t/time_constant)) u; dead_command, which takes the first `width` of u away.
  drive_resonance is a second-order filter of the command, of natural frequency 2 pi/period (drive.py).
  S(a) = sin(a + phase) + 0.6 sin(2 a) + 0.4 sin(6 a): three harmonics.
- friction: path_friction level (1 + sin(cycles theta + phase)) and wandering_friction
  level (1 + sin(2 pi t/period + phase)) are dry; thinning_drag -torque (w/velocity)/(1 + |w|/velocity);
  one_way_drag -coefficient max(w, 0); root_drag -coefficient w/sqrt(|w| + velocity).
- gear: gear_ripple -share tau_t S(cycles theta) and loaded_drag -coefficient |tau_t| w on the motor;
  mesh_error amplitude S(cycles theta) in the deflection; one_sided_spring share K max(phi, 0) and
  soft_centre -stiffness phi/(1 + (phi/width)^2) in the spring.
- structure: wobbling_mass, a free body about the joint's axis, on a spring of the given frequency and damping
  ratio; bent_hose -stiffness (q - rest)^3; kinked_hose -torque tanh((q - angle)/width); neighbour_pull
  torque sin(2 (q_side - angle)), by the neighbour's angle alone; neighbour_drag, -coefficient (dq + dq_side)
  on both joints, as in a wrist whose axes share a gear.
- sensing (sensing.py): encoder_series, a reading off by three harmonics of its own angle; position_filter, a
  first-order lag of a position and its velocity; torque_wander, torque_bow share tau |tau|/reference and
  torque_steps of a torque's reading.
- fault, which is large where it is there: drive_dropouts, a drive that loses a share of u for moments;
  pushes, torques on the link for moments, of alternating sign; drag_at_speed, in a band of speeds only,
  -torque sgn(w) exp(-((|w| - velocity)/width)^2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..catalogue import Planted

Symbol = ca.SX


@dataclass(frozen=True)
class At:
    """What a law may see of its joint; `side_q` and `side_dq` are of the neighbour that it names."""

    q: Symbol
    dq: Symbol
    theta: Symbol
    dtheta: Symbol
    u: Symbol
    t: Symbol
    tau_t: Symbol
    stiffness: float
    side_q: Symbol | None = None
    side_dq: Symbol | None = None


def series(angle: Symbol, phase: float, sin: Callable = ca.sin) -> Symbol:
    """Three harmonics, the first of amplitude 1; `sin` is that of symbols or of arrays."""
    return sin(angle + phase) + 0.6 * sin(2 * angle) + 0.4 * sin(6 * angle)


def _moments(p: Planted, t: Symbol, alternating: bool) -> Symbol:
    """Sum of smooth pulses of half-width `length` [s] about `times` [s]."""
    total = 0.0
    for k, at in enumerate(p.several("times")):
        sign = -1.0 if alternating and k % 2 else 1.0
        total += sign * ca.exp(-(((t - at) / p.value("length")) ** 4))
    return total


def _ripple(p: Planted, s: At) -> Symbol:
    return series(p.value("cycles") * s.theta, p.value("phase"))


def _dead(p: Planted, s: At) -> Symbol:
    return -ca.fmin(ca.fmax(s.u, -p.value("width")), p.value("width"))


def _thinning(p: Planted, s: At) -> Symbol:
    speed = s.dtheta / p.value("velocity")
    return -p.value("torque") * speed / (1 + ca.fabs(speed))


def _at_speed(p: Planted, s: At) -> Symbol:
    away = (ca.fabs(s.dtheta) - p.value("velocity")) / p.value("width")
    return -p.value("torque") * ca.sign(s.dtheta) * ca.exp(-(away**2))


def _soft(p: Planted, s: At) -> Symbol:
    phi = s.theta - s.q
    return -p.value("stiffness") * phi / (1 + (phi / p.value("width")) ** 2)


Torque = Callable[[Planted, At], Symbol]

MOTOR: dict[str, Torque] = {
    "torque_droop": lambda p, s: -p.value("loss") * s.u * (s.u / p.value("reference")) ** 2,
    "load_cogging": lambda p, s: p.value("share") * s.u * _ripple(p, s),
    "cogging_series": lambda p, s: p.value("amplitude") * _ripple(p, s),
    "heated_drive": lambda p, s: (
        -p.value("loss") * (1 - ca.exp(-ca.fmax(s.t, 0) / p.value("time_constant"))) * s.u
    ),
    "dead_command": _dead,
    "thinning_drag": _thinning,
    "one_way_drag": lambda p, s: -p.value("coefficient") * ca.fmax(s.dtheta, 0),
    "root_drag": lambda p, s: (
        -p.value("coefficient") * s.dtheta / ca.sqrt(ca.fabs(s.dtheta) + p.value("velocity"))
    ),
    "gear_ripple": lambda p, s: -p.value("share") * s.tau_t * _ripple(p, s),
    "loaded_drag": lambda p, s: -p.value("coefficient") * ca.fabs(s.tau_t) * s.dtheta,
    "drive_dropouts": lambda p, s: -p.value("share") * s.u * _moments(p, s.t, alternating=False),
    "drag_at_speed": _at_speed,
}
"""Torques on the motor [N m]."""

DRY: dict[str, Torque] = {
    "path_friction": lambda p, s: (
        p.value("level") * (1 + ca.sin(p.value("cycles") * s.theta + p.value("phase")))
    ),
    "wandering_friction": lambda p, s: (
        p.value("level") * (1 + ca.sin(2 * np.pi * s.t / p.value("period") + p.value("phase")))
    ),
}
"""Levels of dry friction [N m]."""

SPRING: dict[str, Torque] = {
    "one_sided_spring": lambda p, s: p.value("share") * s.stiffness * ca.fmax(s.theta - s.q, 0),
    "soft_centre": _soft,
}
"""Torques in the transmission [N m]."""

DEFLECTION: dict[str, Torque] = {"mesh_error": lambda p, s: p.value("amplitude") * _ripple(p, s)}
"""Angles added to theta - q [rad]."""

LINK: dict[str, Torque] = {
    "bent_hose": lambda p, s: -p.value("stiffness") * (s.q - p.value("rest")) ** 3,
    "kinked_hose": lambda p, s: -p.value("torque") * ca.tanh((s.q - p.value("angle")) / p.value("width")),
    "neighbour_pull": lambda p, s: p.value("torque") * ca.sin(2 * (s.side_q - p.value("angle"))),
    "neighbour_drag": lambda p, s: -p.value("coefficient") * (s.dq + s.side_dq),
    "pushes": lambda p, s: p.value("torque") * _moments(p, s.t, alternating=True),
}
"""Torques on the link [N m]."""

ON_BOTH = ("neighbour_drag",)
"""Laws of LINK whose torque acts on the neighbour too."""

WOBBLING = "wobbling_mass"
WOBBLING_STATES = 2  # angle [rad] and speed [rad/s] of the mass against the link


def wobbling(p: Planted, angle: Symbol, speed: Symbol, link_acceleration: Symbol) -> tuple[Symbol, Symbol]:
    """Torque on the link [N m], and the mass's acceleration against the link [rad/s^2]."""
    inertia, omega = p.value("inertia"), 2 * np.pi * p.value("frequency")
    pull = inertia * (omega**2 * angle + 2 * p.value("damping") * omega * speed)
    return pull, -pull / inertia - link_acceleration
