"""Named cases with known truth: every effect alone, healthy, double, late, weak, inexact and half-blind ones.

A folder of cases has truth.json, robots/ and <case>/{train,fresh}.parquet.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from zlib import crc32

import numpy as np

from .laws import CATALOGUE, Planted
from .robots import ROBOTS, Robot, read_robot
from .sensing import ENCODERS, FULL, LINK_SIDE, MOTOR_ONLY, NO_COMMAND, Ragged, SensorSet
from .simulate import Recorded, plant

SMALL_ROBOTS = ("lever", "turret", "crane", "gimbal")
INEXACT = 0.02  # every nominal number off by 1 to 3 %, damping by 3 to 9 %
WEAK = 0.12  # size of the weak cases

SLOW_EFFECTS = ("stribeck_friction", "torque_offset", "cogging", "transmission_error", "cable_spring")
STEP_EFFECTS = ("torque_saturation", "end_stop")

QUIET_FEEDBACK = replace(FULL, noisy_feedback=False)
"""The controller reads its sensors without noise: the command is smooth between two recorded samples."""


@dataclass(frozen=True)
class Case:
    """One planted recording to be; `fresh` is a second trajectory of the same machine, half as long."""

    name: str
    robot: str  # file name in ROBOTS, without suffix
    excitation: str
    effects: tuple[Planted, ...]
    seed: int
    sensors: SensorSet = QUIET_FEEDBACK
    inexact: float = 0.0
    seconds: float = 16.0
    rate: float = 500  # Hz, of the recording

    def truth(self) -> dict[str, object]:
        """What truth.json says of the case; parameters that are words stand under `words`."""
        return {
            "robot": self.robot,
            "excitation": self.excitation,
            "truth": [_truth(p) for p in self.effects],
        }

    def train(self) -> Recorded:
        return self._plant(2 * self.seed, self.seconds, self.effects)

    def fresh(self) -> Recorded:
        """Effects that set in late are on from the start here."""
        return self._plant(
            2 * self.seed + 1, self.seconds / 2, tuple(replace(p, since=None) for p in self.effects)
        )

    def _plant(self, seed: int, seconds: float, effects: tuple[Planted, ...]) -> Recorded:
        path = ROBOTS / f"{self.robot}.yaml"
        return plant(
            path,
            list(effects),
            self.excitation,
            seconds,
            seed,
            self.sensors,
            self.rate,
            inexact=self.inexact,
            plant_seed=self.seed,
        )


def _truth(planted: Planted) -> dict[str, object]:
    words = {k: v for k, v in planted.parameters.items() if isinstance(v, str)}
    numbers = {k: v for k, v in planted.parameters.items() if v is not None and k not in words}
    entry = {"effect": planted.effect, "joint": planted.joint, "parameters": numbers, "since": planted.since}
    return {**entry, "words": words} if words else entry


def write_case(case: Case, folder: Path) -> None:
    """Write <case>/train.parquet and fresh.parquet, its robot, and its entry in truth.json."""
    (folder / case.name).mkdir(parents=True, exist_ok=True)
    (folder / "robots").mkdir(exist_ok=True)
    case.train().write(folder / case.name / "train.parquet")
    case.fresh().write(folder / case.name / "fresh.parquet")
    for source in (f"{case.robot}.yaml", f"{case.robot.removesuffix('_exact')}.urdf"):
        shutil.copyfile(ROBOTS / source, folder / "robots" / source)
    table = folder / "truth.json"
    truth = json.loads(table.read_text()) if table.exists() else {}
    truth[case.name] = case.truth()
    table.write_text(json.dumps(dict(sorted(truth.items())), indent=1))


@cache
def _nominal(robot: str) -> Robot:
    return read_robot(ROBOTS / f"{robot}.yaml")


def _rng(*words: object) -> np.random.Generator:
    """A generator of its own for every name, so that adding a case changes no other."""
    return np.random.default_rng(crc32(" ".join(map(str, words)).encode()))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def usual_excitation(effect: str) -> str:
    return "steps" if effect in STEP_EFFECTS else "slow" if effect in SLOW_EFFECTS else "rich"


def usual_effect(
    effect: str,
    robot: str,
    joint: str,
    rng: np.random.Generator,
    size: float = 1.0,
    since: float | None = None,
) -> Planted:
    """An effect of the usual size for a joint, varied by 20 % and times `size`; signs are drawn where both
    exist.

    torque_saturation and end_stop depend on the trajectory and are sized by `single_case`. Raises ValueError
    for them and for unknown names.
    """
    r = _nominal(robot)
    j = r.index(joint)
    limit, stiffness, viscous = r.torque_limit[j], r.stiffness[j], r.motor_damping[j]
    s = size * rng.uniform(0.8, 1.2)
    sign = rng.choice([-1.0, 1.0])
    load = 0.25 * limit  # a usual spring torque
    reach = r.bodies[j].com
    phase = rng.uniform(-3, 3)
    parameters: dict[str, dict[str, float]] = {
        "torque_gain": {"gain": 0.1 * s * sign},
        "torque_offset": {"offset": 0.03 * limit * s * sign},
        "torque_delay": {"delay": 0.0045 * s},
        "cogging": {"amplitude": 0.018 * limit * s, "cycles": float(rng.integers(10, 24)), "phase": phase},
        "motor_inertia": {"scale": 0.3 * s},
        "motor_viscous_friction": {"coefficient": 0.45 * viscous * s},
        "motor_coulomb_friction": {"level": 0.035 * limit * s},
        "asymmetric_friction": {"level_positive": 0.05 * limit * s, "level_negative": 0.025 * limit * s},
        "stribeck_friction": {"level": 0.03 * limit * s, "static_extra": 0.03 * limit * s, "velocity": 0.06},
        "load_friction": {"coefficient": 0.13 * s},
        "friction_drift": {"level": 0.06 * limit * s, "time_constant": rng.uniform(5, 9)},
        "spring_stiffness": {"scale": 0.25 * s * sign},
        "spring_damping": {"scale": 1.5 * s},
        "hardening_spring": {"cubic": 0.5 * s * stiffness**3 / load**2},
        "backlash": {"gap": 0.009 * s},
        "spring_hysteresis": {"level": 0.025 * limit * s, "scale": 0.0035},
        "transmission_error": {"amplitude": 0.002 * s, "cycles": float(rng.integers(12, 24)), "phase": phase},
        "spring_preload": {"torque": 0.03 * limit * s * sign},
        "base_tilt": {"roll": 0.06 * s * sign, "pitch": 0.05 * s},
        "link_coulomb_friction": {"level": 0.018 * limit * s},
        "link_viscous_friction": {"coefficient": 0.25 * viscous * s},
        "cable_spring": {"stiffness": 0.012 * stiffness * s, "rest": rng.uniform(-0.3, 0.3)},
        "link_encoder_offset": {"offset": 0.015 * s * sign},
        "motor_encoder_offset": {"offset": 0.015 * s * sign},
        "torque_sensor_offset": {"offset": 0.03 * limit * s * sign},
        "torque_sensor_gain": {"gain": 0.1 * s * sign},
        "sensor_delay": {"delay": 0.005 * s},
        "encoder_eccentricity": {"amplitude": 0.008 * s, "phase": phase},
    }
    if effect == "payload":
        place = [_rounded(1.3 * c) for c in reach]
        return Planted(
            effect, joint, {"mass": _rounded(0.3 * r.bodies[j].mass * s), "position": place}, since
        )
    if effect not in parameters:
        raise ValueError(
            f"no usual size for {effect!r}; there is one for {', '.join((*parameters, 'payload'))}"
        )
    values: dict[str, object] = {name: _rounded(value) for name, value in parameters[effect].items()}
    if effect == "encoder_eccentricity":
        values["channel"] = str(rng.choice(["q", "theta"]))
    if effect == "sensor_delay" and (
        channel := rng.choice(["", "q", "theta"])
    ):  # none: all sensors of the joint
        values["channel"] = str(channel)
    if effect == "base_tilt":  # only a tilt about horizontal directions across the joint axes can be seen
        hidden = {"lever": "roll", "crane": "pitch"}.get(robot.removesuffix("_exact"))
        values = {name: 0.0 if name == hidden else value for name, value in values.items()}
        return Planted(effect, None, values, since)
    return Planted(effect, joint, values, since)


def single_case(
    name: str,
    effect: str,
    seed: int,
    robot: str | None = None,
    size: float = 1.0,
    excitation: str | None = None,
    sensors: SensorSet = QUIET_FEEDBACK,
    inexact: float = 0.0,
    since: float | None = None,
) -> Case:
    """A case of one effect; what is not given is drawn from the name and the seed."""
    rng = _rng(name, seed)
    robot = robot or str(rng.choice(SMALL_ROBOTS))
    joints = _nominal(robot).joints
    joint = str(
        rng.choice(joints[1:] if effect == "payload" and len(joints) > 1 else joints)
    )  # not on a vertical axis
    excitation = excitation or usual_excitation(effect)
    case = Case(name, robot, excitation, (), int(rng.integers(1, 2**30)), sensors, inexact)
    if effect in STEP_EFFECTS:
        planted = met_by(case, effect, joint, size, since)
    else:
        planted = usual_effect(effect, robot, joint, rng, size, since)
    return replace(case, effects=(planted,))


def met_by(case: Case, effect: str, joint: str, size: float, since: float | None) -> Planted:
    """A saturation or an end stop that the trajectory reaches; a smaller size is met more rarely."""
    healthy, j = case.train(), _nominal(case.robot).index(joint)
    if effect == "torque_saturation":
        peak = np.abs(healthy.true["tau"][:, j]).max()
        return Planted(effect, joint, {"limit": _rounded((1 - 0.45 * size) * peak)}, since)
    q = healthy.true["q"][:, j]
    extreme = q[np.argmax(np.abs(q))]
    stiffness = 4 * _nominal(case.robot).stiffness[j]
    return Planted(
        effect,
        joint,
        {"position": _rounded((1 - 0.45 * size) * extreme), "stiffness": _rounded(stiffness)},
        since,
    )


def single_cases(seed: int, size: float = 1.0, effects: Sequence[str] = tuple(CATALOGUE)) -> list[Case]:
    """One case for every effect, of the usual sizes times `size`."""
    return [single_case(f"single_{effect}", effect, seed, size=size) for effect in effects]


def healthy_cases(seed: int) -> list[Case]:
    """Every small robot, fast and slow, and the seven-joint arm."""
    plans = [(robot, kind) for robot in SMALL_ROBOTS for kind in ("rich", "slow")] + [("reach", "rich")]
    return [
        Case(f"healthy_{r}_{k}", r, k, (), int(_rng("healthy", r, k, seed).integers(1, 2**30)))
        for r, k in plans
    ]


def weak_cases(seed: int, effects: Sequence[str] = tuple(CATALOGUE)) -> list[Case]:
    """Every effect at WEAK of its usual size, on robots whose numbers are trusted to 0.1 %."""
    cases = []
    for effect in effects:
        robot = f"{_rng('weak', effect, seed).choice(SMALL_ROBOTS)}_exact"
        cases.append(single_case(f"weak_{effect}", effect, seed, robot=robot, size=WEAK))
    return cases


DOUBLES = (
    ("crane", ("backlash", "motor_coulomb_friction")),
    ("gimbal", ("payload", "link_viscous_friction")),
    ("crane", ("torque_gain", "link_coulomb_friction")),
    ("gimbal", ("hardening_spring", "torque_sensor_offset")),
    ("reach", ("load_friction", "spring_stiffness")),
    ("crane", ("spring_hysteresis", "torque_delay")),
    ("gimbal", ("motor_inertia", "sensor_delay")),
    ("lever", ("motor_coulomb_friction", "payload")),
    ("turret", ("motor_viscous_friction", "torque_sensor_gain")),
)


def double_cases(seed: int) -> list[Case]:
    """Two causes at once, on two joints where the robot has them."""
    cases = []
    for robot, pair in DOUBLES:
        name = f"double_{robot}_{pair[0]}"
        rng = _rng(name, seed)
        joints = rng.permutation(_nominal(robot).joints)
        planted = tuple(usual_effect(e, robot, str(joints[i % len(joints)]), rng) for i, e in enumerate(pair))
        cases.append(Case(name, robot, "rich", planted, int(rng.integers(1, 2**30))))
    return cases


def since_cases(
    seed: int,
    effects: Sequence[str] = (
        "motor_coulomb_friction",
        "backlash",
        "spring_stiffness",
        "payload",
        "torque_gain",
    ),
) -> list[Case]:
    """Causes that set in between 6 and 10 s."""
    cases = []
    for effect in effects:
        since = round(float(_rng("since", effect, seed).uniform(6, 10)), 2)
        cases.append(single_case(f"since_{effect}", effect, seed, excitation="rich", since=since))
    return cases


def inexact_cases(
    seed: int,
    effects: Sequence[str] = (
        "motor_coulomb_friction",
        "payload",
        "backlash",
        "spring_hysteresis",
        "torque_gain",
        "load_friction",
        "link_encoder_offset",
        "torque_delay",
    ),
) -> list[Case]:
    """Causes beside a nominal model whose every number is off by INEXACT, and such healthy machines."""
    cases = [single_case(f"inexact_{effect}", effect, seed, inexact=INEXACT) for effect in effects]
    healthy = [replace(case, name=f"inexact_{case.name}", inexact=INEXACT) for case in healthy_cases(seed)]
    return cases + [case for case in healthy if case.excitation == "rich" and case.robot != "reach"]


def sensor_cases(seed: int) -> list[Case]:
    """Causes seen with some channels only, on ragged time, or under a controller that reads noisy sensors."""
    quiet = {"noisy_feedback": False}
    plans = (
        ("encoders", "hardening_spring", replace(ENCODERS, **quiet)),
        ("encoders", "motor_coulomb_friction", replace(ENCODERS, **quiet)),
        ("motor_only", "motor_coulomb_friction", replace(MOTOR_ONLY, **quiet)),
        ("motor_only", "payload", replace(MOTOR_ONLY, **quiet)),
        ("no_command", "motor_coulomb_friction", replace(NO_COMMAND, **quiet)),
        ("no_command", "spring_stiffness", replace(NO_COMMAND, **quiet)),
        ("link_side", "payload", replace(LINK_SIDE, **quiet)),
        ("ragged", "spring_stiffness", replace(QUIET_FEEDBACK, ragged=Ragged())),
        ("ragged", "backlash", replace(QUIET_FEEDBACK, ragged=Ragged())),
        (
            "ragged_sampled_late",
            "motor_coulomb_friction",
            replace(QUIET_FEEDBACK, ragged=Ragged(sampled_late=True)),
        ),
        ("noisy_feedback", "load_friction", FULL),
        ("noisy_feedback", "torque_delay", FULL),
    )
    cases = []
    for kind, effect, sensors in plans:
        robot = f"{_rng(kind, effect, seed).choice(SMALL_ROBOTS)}_exact"
        cases.append(single_case(f"{kind}_{effect}", effect, seed, robot=robot, sensors=sensors))
    return cases


def all_cases(seed: int) -> list[Case]:
    """Everything above."""
    makers = (single_cases, healthy_cases, weak_cases, double_cases, since_cases, inexact_cases, sensor_cases)
    return [case for maker in makers for case in maker(seed)]
