"""Dirty machines: what real ones have beside the causes that one looks for.

A machine has numbers off by its nominal model's tolerance and a background of 4 to 8 small errors, half of
them of laws that no catalogue lists (outside.py), all of these of one family. Kinds of machines: `causes` has
one to three large effects of the catalogue besides, `unknown` one large law from outside it, `background`
nothing. Everything follows from kind and number: a healthy machine is moved, the effects are sized by their
shares of its torque (shares.py), the machine is moved with all of them, and each is sized once more.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from zlib import crc32

import numpy as np

from ..drawn import in_logarithm
from ..machine.chain import Array
from ..machine.sensing import CURRENT, FROM_CURRENT, FULL, TOLD, SensorSet
from ..robots import read_robot, robot_file
from ..simulate import Recorded
from .case import Dirty
from .choice import adjusted, chosen_for, pick

KINDS = ("causes", "background", "unknown")

SMALL = ("lever", "turret", "crane", "scara", "gimbal")
ROBOTS = {"small": 0.35, "drawn": 0.38, "long": 0.2, "reach": 0.07}  # long: five to seven joints, drawn
JOINTS_OF_LONG = (5, 8)
SPRINGS = {"flexible": 0.45, "rigid": 0.4, "mixed": 0.15}
PERCENT = (2, 5, 10)  # to which nominal numbers are known
EXCITATIONS = {"rich": 0.55, "slow": 0.2, "steps": 0.25}
RATES = {1000.0: 0.1, 500.0: 0.2, 250.0: 0.25, 200.0: 0.15, 125.0: 0.1, 100.0: 0.15, 50.0: 0.05}  # Hz
LARGE_RATE = 250.0  # Hz at most with five joints or more, for the diagnosis's time
SECONDS, LARGE_SECONDS = (8.0, 16.0), (8.0, 10.0)
NOISY_FEEDBACK = 0.3  # share of controllers that read their sensors' noise

SENSORS: dict[str, tuple[float, SensorSet]] = {
    "all": (0.35, FULL),
    "all, current": (0.2, FROM_CURRENT),
    "motor, current": (0.3, SensorSet(channels=("theta", CURRENT))),
    "motor, command": (0.15, SensorSet(channels=("theta", "dtheta", "tau_m", *TOLD))),
}
"""Shares and channels; rigid joints have no other positions than their motors' in any of them."""
POSITION_NOISE, VELOCITY_NOISE = (3e-6, 1e-4), (1e-3, 2e-2)  # rad, rad/s
TORQUE_NOISE = (5e-4, 8e-3)  # of a joint's torque limit
ENCODER_BITS = (15, 21)

FAMILIES = ("drive", "friction", "gear", "structure", "sensing")

ATTEMPTS = 20  # machines drawn until one moves as it should
LOST = 1.5  # rad off its way: a machine that cannot follow at all
STILL = 0.05  # rad that every joint travels at least
AT_LIMIT = 0.1  # of the time that a torque may be at its limit


@cache
def dirty(kind: str, number: int) -> Dirty:
    """The machine of a kind in KINDS with this number; raises ValueError for other kinds."""
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r}; there are {', '.join(KINDS)}")
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([crc32(kind.encode()), number, attempt])
        case = _machine(kind, number, rng)
        healthy = case.trial()
        if not moves(healthy):
            continue
        chosen = chosen_for(case, healthy, rng)
        if chosen is None:
            continue
        case, targets = chosen
        first = case.trial()
        if not moves(first):
            continue
        case = adjusted(case, first, targets)
        if moves(case.trial()):
            return case
    raise RuntimeError(f"{kind} {number}: no machine that moves in {ATTEMPTS} attempts")


def moves(recorded: Recorded) -> bool:
    """Whether a machine follows its reference, if not well."""
    run, n = recorded.run, len(recorded.real.joints)
    states = run.states[:, : 4 * n]
    if not np.isfinite(states).all() or np.abs(states[:, 2 * n : 3 * n] - run.told.theta_ref).max() > LOST:
        return False
    at_limit = np.abs(run.tau_m) >= run.sensors.robot.torque_limit
    still = np.ptp(states[:, 2 * n : 3 * n], axis=0) < STILL
    return bool(at_limit.mean(axis=0).max() < AT_LIMIT and not still.any())


# --- drawing ----------------------------------------------------------------------------------------------
def _machine(kind: str, number: int, rng: np.random.Generator) -> Dirty:
    """A machine with nothing but wrong numbers."""
    family = pick(ROBOTS, rng)
    drawn = int(rng.integers(1000, 100000))
    base = {
        "small": str(rng.choice(SMALL)),
        "drawn": f"drawn_{drawn}",
        "long": f"drawn_{drawn}_of{rng.integers(*JOINTS_OF_LONG)}",
        "reach": "reach",
    }[family]
    robot = f"dirty_{base}_{pick(SPRINGS, rng)}_{rng.choice(PERCENT)}"
    nominal = read_robot(robot_file(robot))
    n = len(nominal.joints)
    rigid = np.isinf(nominal.stiffness)
    springs = "rigid" if rigid.all() else "mixed" if rigid.any() else "flexible"
    sensed = pick({name: share for name, (share, _) in SENSORS.items()}, rng)
    rate, seconds = float(pick(RATES, rng)), rng.uniform(*(SECONDS if n < 5 else LARGE_SECONDS))
    return Dirty(
        f"{kind}-{number:04d}",
        robot,
        pick(EXCITATIONS, rng),
        (),
        int(rng.integers(1, 2**30)),
        _sensors(SENSORS[sensed][1], nominal.torque_limit, rng),
        0.0,
        round(float(seconds), 1),
        rate if n < 5 else min(rate, LARGE_RATE),
        kind=kind,
        sensed=sensed,
        robot_family=f"{family} {springs}",
        background_family=str(rng.choice(FAMILIES)),
    )


def _sensors(sensors: SensorSet, limit: Array, rng: np.random.Generator) -> SensorSet:
    """The set with encoders and noise of some quality; `limit` (n,) of the joints' torques."""
    position, velocity = in_logarithm(rng, *POSITION_NOISE), in_logarithm(rng, *VELOCITY_NOISE)
    torque = tuple(in_logarithm(rng, *TORQUE_NOISE) * limit)
    noise = {"q": position, "theta": position, "dq": velocity, "dtheta": velocity}
    bits = int(rng.integers(ENCODER_BITS[0], ENCODER_BITS[1]))
    return replace(
        sensors,
        noise={**noise, "tau_t": torque, CURRENT: torque},
        resolution=2 * np.pi / 2**bits,
        noisy_feedback=bool(rng.random() < NOISY_FEEDBACK),
    )
