"""The laws of docs/reference/formats.md and of the effects beyond it, typed once more."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace as Inputs
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation


def _payload(i: Inputs) -> np.ndarray:
    r, m = np.array(i.p.position), i.p.mass
    inertia = m * (r @ r * np.eye(3) - np.outer(r, r))
    added = (m, *(m * r), *(inertia[a, b] for a, b in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))))
    return np.array(i.inertial) + added


def _tilt(i: Inputs) -> np.ndarray:
    turn = Rotation.from_euler("XY", (i.p.roll, i.p.pitch)).as_matrix()  # Rx Ry
    return turn.T @ np.array(i.gravity)


def _drive(i: Inputs, K: float = 1.0, D: float = 1.0, B: float = 1.0, more: float = 0.0) -> tuple[Any, ...]:
    return K * i.drive.K, D * i.drive.D, B * i.drive.B, i.drive.D_m + more


def _bent(i: Inputs, K: float) -> tuple[Any, ...]:
    return K, i.drive.D + K * i.p.relaxation, i.drive.B, i.drive.D_m


def _dead_zone(x: float, gap: float) -> float:
    return 0.0 if abs(x) <= gap / 2 else (x - gap / 2 if x > 0 else x + gap / 2)


def _dahl(speed: float, z: float, p: Any) -> float:
    return speed * p.level / p.scale * (1 - z / p.level * np.sign(speed))


def _learned(x: float, p: Any, coefficients: Any) -> float:
    """A spline of twelve uniform cubic B-splines, by SciPy; beyond its range it keeps its value."""
    step = p.span / 9
    knots = p.start + step * np.arange(-3, 13)
    return float(BSpline(knots, np.array(coefficients), 3)(np.clip(x, p.start, p.start + p.span)))


def _surface(x: float, y: float, p: Any) -> float:
    """A product of six splines of each of two signals."""
    rows = np.reshape(p.torques, (6, 6))
    along = [_six(y, p.other_start, p.other_span, row) for row in rows]
    return _six(x, p.start, p.span, along)


def _six(x: float, start: float, span: float, coefficients: Any) -> float:
    knots = start + span / 3 * np.arange(-3, 7)
    return float(BSpline(knots, np.array(coefficients), 3)(np.clip(x, start, start + span)))


SHAPE = "start of the signal, span of the signal"


def _beyond(q: float, stop: float) -> float:
    return q - stop if (stop >= 0 and q > stop) or (stop < 0 and q < stop) else 0.0


# effect: its parameters with units, and what each piece that it has gives. An effect has no other pieces.
LAWS: dict[str, tuple[str, dict[str, Callable[[Inputs], Any]]]] = {
    "torque_gain": ("gain 1", {"map": lambda i: i.x + i.p.gain * i.x}),
    "torque_offset": ("offset N m", {"map": lambda i: i.x + i.p.offset}),
    "torque_delay": ("delay s", {"delay": lambda i: i.p.delay}),
    "torque_saturation": ("limit N m", {"map": lambda i: np.clip(i.x, -i.p.limit, i.p.limit)}),
    "cogging": (
        "amplitude N m, cycles 1, phase rad",
        {"map": lambda i: i.x + i.p.amplitude * np.sin(i.p.cycles * i.s.theta + i.p.phase)},
    ),
    "motor_inertia": ("scale 1", {"edit_drive": lambda i: _drive(i, B=1 + i.p.scale)}),
    "rotor_inertia": (
        "inertia kg m^2",
        {"edit_drive": lambda i: (i.drive.K, i.drive.D, i.drive.B + i.p.inertia, i.drive.D_m)},
    ),
    "motor_viscous_friction": (
        "coefficient N m s/rad",
        {"edit_drive": lambda i: _drive(i, more=i.p.coefficient)},
    ),
    "learned_torque": (
        f"torques N m, {SHAPE}",
        {"torque": lambda i: _learned(i.s.dtheta, i.p, i.p.torques)},
    ),
    "learned_surface": (
        f"torques N m, {SHAPE}, other_start of the other signal, other_span of the other signal",
        {"torque": lambda i: _surface(i.s.dtheta, i.s.theta, i.p)},
    ),
    "learned_link_torque": (
        f"torques N m, {SHAPE}",
        {"torque": lambda i: _learned(i.s.q, i.p, i.p.torques)},
    ),
    "learned_deflection": (
        f"angles rad, {SHAPE}",
        {"map": lambda i: i.x + _learned(i.s.theta, i.p, i.p.angles), "slope": lambda i: 1.0},
    ),
    "motor_coulomb_friction": ("level N m", {"level": lambda i: i.p.level}),
    "asymmetric_friction": (
        "level_positive N m, level_negative N m",
        {"level": lambda i: i.p.level_positive if i.s.dtheta > 0 else i.p.level_negative},
    ),
    "stribeck_friction": (
        "level N m, static_extra N m, velocity rad/s",
        {
            "level": lambda i: (
                i.p.level + i.p.static_extra * np.exp(-min((i.s.dtheta / i.p.velocity) ** 2, 600))
            )
        },
    ),
    "load_friction": ("coefficient 1", {"level": lambda i: i.p.coefficient * abs(i.s.tau_t)}),
    "friction_drift": (
        "level N m, time_constant s",
        {"level": lambda i: i.p.level * np.exp(-i.s.t / i.p.time_constant)},
    ),
    "joint_compliance": (
        "compliance rad/(N m), relaxation s",
        {"edit_drive": lambda i: _bent(i, 1 / (1 / i.drive.K + i.p.compliance))},
    ),
    "spring_stiffness": ("scale 1", {"edit_drive": lambda i: _drive(i, K=1 + i.p.scale)}),
    "spring_damping": ("scale 1", {"edit_drive": lambda i: _drive(i, D=1 + i.p.scale)}),
    "hardening_spring": (
        "cubic N m/rad^3",
        {"torque": lambda i: i.p.cubic * i.s.phi**3, "slope": lambda i: 3 * i.p.cubic * i.s.phi**2},
    ),
    "backlash": (
        "gap rad",
        {
            "map": lambda i: _dead_zone(i.x, i.p.gap),
            "slope": lambda i: float(_dead_zone(i.s.phi, i.p.gap) != 0),
        },
    ),
    "spring_hysteresis": (
        "level N m, scale rad",
        {"torque": lambda i: i.z, "rate": lambda i: _dahl(i.s.dphi, i.z, i.p)},
    ),
    "transmission_error": (
        "amplitude rad, cycles 1, phase rad",
        {"map": lambda i: i.x + i.p.amplitude * np.sin(i.p.cycles * i.s.theta + i.p.phase)},
    ),
    "spring_preload": ("torque N m", {"torque": lambda i: i.p.torque}),
    "payload": ("mass kg, position m", {"edit_inertial": _payload}),
    "base_tilt": ("roll rad, pitch rad", {"edit_gravity": _tilt}),
    "link_coulomb_friction": ("level N m", {"level": lambda i: i.p.level}),
    "link_viscous_friction": ("coefficient N m s/rad", {"torque": lambda i: -i.p.coefficient * i.s.dq}),
    "cable_spring": (
        "stiffness N m/rad, rest rad",
        {"torque": lambda i: i.p.stiffness * i.p.rest - i.p.stiffness * i.s.q},
    ),
    "end_stop": (
        "position rad, stiffness N m/rad",
        {"torque": lambda i: -i.p.stiffness * _beyond(i.s.q, i.p.position)},
    ),
    "link_encoder_offset": ("offset rad", {"map": lambda i: i.x + i.p.offset}),
    "motor_encoder_offset": ("offset rad", {"map": lambda i: i.x + i.p.offset}),
    "encoder_eccentricity": (
        "amplitude rad, phase rad",
        {"map": lambda i: i.x + i.p.amplitude * np.sin(i.x + i.p.phase)},
    ),
    "torque_sensor_offset": ("offset N m", {"map": lambda i: i.x + i.p.offset}),
    "torque_sensor_gain": ("gain 1", {"map": lambda i: i.x + i.p.gain * i.x}),
    "sensor_delay": ("delay s", {"delay": lambda i: i.p.delay}),
    # beyond the table
    "breakaway_friction": (
        "level N m, distance rad",
        {
            "level": lambda i: i.p.level * i.z,
            "rate": lambda i: -i.z * abs(i.s.dtheta) / i.p.distance,
        },
    ),
    "coupled_friction": (
        "level N m, coefficient N m s/rad",
        {"torque": lambda i: -i.s.dtheta * i.p.coefficient, "level": lambda i: i.p.level},
    ),
    "current_lag": (
        "time_constant s",
        {
            "torque": lambda i: -i.s.tau_m + i.z,
            "rate": lambda i: i.s.tau_m / i.p.time_constant - i.z / i.p.time_constant,
        },
    ),
    "dahl_friction": (
        "level N m, scale rad",
        {"torque": lambda i: -i.z, "rate": lambda i: _dahl(i.s.dtheta, i.z, i.p)},
    ),
    "differential_friction": (
        "level_sum N m, coefficient_sum N m s/rad, level_difference N m, coefficient_difference N m s/rad",
        {"level": lambda i: i.p.level_sum + i.p.level_difference},
    ),
    "drive_efficiency": (
        "loss_driving 1, loss_backdriving 1",
        {
            "level": lambda i: (
                abs(i.s.tau_t) * (i.p.loss_driving if i.s.tau_t * i.s.dtheta > 0 else i.p.loss_backdriving)
            )
        },
    ),
    "encoder_ripple": (
        "amplitude rad, cycles 1, phase rad",
        {"map": lambda i: i.x + i.p.amplitude * np.sin(i.p.cycles * i.x + i.p.phase)},
    ),
    "joint_coupling": ("share 1", {"map": lambda i: i.p.share * i.s.tau_m_before + i.x}),
    "periodic_disturbance": (
        "amplitude N m, frequency Hz, phase rad",
        {"torque": lambda i: i.p.amplitude * np.cos(np.pi * (2 * i.p.frequency * i.s.t - 0.5) + i.p.phase)},
    ),
    "quadratic_drag": (
        "coefficient N m s^2/rad^2",
        {"torque": lambda i: -i.p.coefficient * np.sign(i.s.dq) * i.s.dq**2},
    ),
    "rough_spot": (
        "level N m, position rad, width rad",
        {"level": lambda i: i.p.level * np.exp(-min(((i.s.theta - i.p.position) / i.p.width) ** 2, 600))},
    ),
    "spring_creep": (
        "stiffness N m/rad, time_constant s",
        {"torque": lambda i: i.p.stiffness * i.z, "rate": lambda i: i.s.dphi - i.z / i.p.time_constant},
    ),
    "magnetic_saturation": (
        "saturation 1/(N m)",
        {"map": lambda i: i.x / np.hypot(1.0, i.p.saturation * i.x)},
    ),
    "torque_speed_limit": (
        "stall N m, drop N m s/rad",
        {
            "map": lambda i: (
                np.clip(i.x + i.p.drop * i.s.dtheta, -i.p.stall, i.p.stall) - i.p.drop * i.s.dtheta
            )
        },
    ),
}
