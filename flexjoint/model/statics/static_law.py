"""Where a robot under motor PD control comes to rest when its gravity torque command is not what the load is.

At rest the motor carries tau_t = g_cmd + K_P (theta_d - theta), and the spring tau_t = K (theta - q). With
delta = tau_t - g_cmd, the torque that the command leaves out (Kameduła et al. 2016, equations 1 to 4, at
rest):

    theta - theta_d = -delta / K_P      q - q_d = -delta (1/K_P + 1/K)      theta - q = tau_t / K

for theta_d = q_d + g_cmd / K.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import ModelError


@dataclass(frozen=True)
class StaticError:
    """At rest, each of the shape of the loads [rad]: theta - theta_d, q - q_d, and the deflection theta -
    q."""

    motor: np.ndarray
    link: np.ndarray
    deflection: np.ndarray


def static_error(
    load: np.ndarray | float,
    command: np.ndarray | float,
    kp: np.ndarray | float,
    stiffness: np.ndarray | float,
) -> StaticError:
    """Errors at rest of linear springs without dry friction and within the torque limits, exactly.

    Args:
        load: torque that the spring carries at the rest reached, (..., n) [N m]: gravity there, less contact.
        command: gravity torque commanded, g_cmd, and assumed in theta_d = q_d + g_cmd/K; 0 for theta_d = q_d.
        kp, stiffness: K_P and K [N m/rad], > 0; K may be infinite.

    Raises:
        ModelError: a gain or stiffness that is not > 0.
    """
    gain, K = np.asarray(kp, dtype=float), np.asarray(stiffness, dtype=float)
    for name, value in (("kp", gain), ("stiffness", K)):
        if not np.all(value > 0.0):
            raise ModelError(f"{name}: expected numbers > 0 N m/rad, got {value.tolist()}")
    carried = np.asarray(load, dtype=float)
    delta = carried - np.asarray(command, dtype=float)
    return StaticError(-delta / gain, -delta * (1.0 / gain + 1.0 / K), carried / K)
