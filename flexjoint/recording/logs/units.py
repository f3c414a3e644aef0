"""Units that logs come in, as factors to those of a recording."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType

TURN = 2.0 * math.pi
DEGREE = math.pi / 180.0
TIME_UNITS: Mapping[str, int] = MappingProxyType(
    {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
)  # in a second

UNITS_OF: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "angle": {"rad": 1.0, "deg": DEGREE, "rev": TURN, "mrad": 1e-3, "m": 1.0, "mm": 1e-3},
        "velocity": {
            "rad/s": 1.0,
            "deg/s": DEGREE,
            "rev/s": TURN,
            "rpm": TURN / 60.0,
            "m/s": 1.0,
            "mm/s": 1e-3,
        },
        "torque": {
            "N m": 1.0,
            "Nm": 1.0,
            "mN m": 1e-3,
            "mNm": 1e-3,
            "kN m": 1e3,
            "N": 1.0,
            "A": 1.0,
            "mA": 1e-3,
        },
        "current": {"A": 1.0, "mA": 1e-3},
        "temperature": {"deg C": 1.0},
    }
)
CURRENTS = ("A", "mA")  # as the unit of a torque: times torque constant and gear ratio
LENGTHS = ("m", "mm", "m/s", "mm/s", "N")
OF_ANGLE = MappingProxyType({"rad": "rad/s", "deg": "deg/s", "rev": "rev/s"})  # and the velocity's beside it

_DIMENSIONS = {
    "q": "angle",
    "theta": "angle",
    "q_ref": "angle",
    "theta_ref": "angle",
    "dq": "velocity",
    "dtheta": "velocity",
    "dtheta_ref": "velocity",
    "tau_t": "torque",
    "tau_m": "torque",
    "tau_motor": "torque",
    "tau_ff": "torque",
    "current": "current",
    "temperature": "temperature",
}
_ENDINGS = {
    "angle": {"deg": "deg", "degrees": "deg", "rad": "rad", "radians": "rad", "rev": "rev"},
    "velocity": {
        "deg_per_s": "deg/s",
        "deg_s": "deg/s",
        "degps": "deg/s",
        "rad_per_s": "rad/s",
        "rad_s": "rad/s",
        "radps": "rad/s",
        "rpm": "rpm",
    },
    "torque": {"nm": "N m", "mnm": "mN m", "a": "A", "amps": "A", "ma": "mA"},
    "current": {"a": "A", "amps": "A", "ma": "mA"},
}


def dimension(channel: str) -> str:
    """angle, velocity, torque, current or temperature."""
    return _DIMENSIONS[channel]


def factor(channel: str, unit: str) -> float:
    """What samples of a channel are multiplied by, to be in the unit of a recording."""
    return UNITS_OF[dimension(channel)][unit]


def of_name(channel: str, name: str) -> str | None:
    """The unit that a signal's name ends with: `pos_deg`, `velocity [deg/s]`, `motor_current_A`."""
    kind = dimension(channel)
    bracket = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$", name)
    if bracket and bracket.group(1).replace("·", " ") in UNITS_OF[kind]:
        return bracket.group(1).replace("·", " ")
    for ending, unit in _ENDINGS.get(kind, {}).items():
        if re.search(rf"[_.\- /]{ending}$", name, re.IGNORECASE):
            return unit
    return None
