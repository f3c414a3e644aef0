"""Named cases with known truth: every effect alone, healthy, double, late, weak, inexact and half-blind ones.

A folder of cases has truth.json, robots/ and <case>/{train,fresh}.parquet.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
import yaml

from .catalogue import CATALOGUE, TWO_JOINTS, Planted
from .machine.sensing import ENCODERS, FULL, LINK_SIDE, MOTOR_ONLY, NO_COMMAND, Ragged, SensorSet
from .robots import robot_file
from .simulate import Recorded, plant
from .sizes import MET_EFFECTS, nominal, rounded, usual_effect, usual_excitation

SMALL_ROBOTS = ("lever", "turret", "crane", "gimbal")
INEXACT = 0.02  # every nominal number off by 1 to 3 %, damping by 3 to 9 %
WEAK = 0.12  # size of the weak cases

AFTER_FIRST = ("payload", "coupled_friction")  # not on a vertical axis; with a joint before

LIMIT_DROP = 0.3  # of the greatest torque, that a torque_speed_limit falls by up to the greatest speed

QUIET_FEEDBACK = replace(FULL, noisy_feedback=False)
"""The controller reads its sensors without noise: the command is smooth between two recorded samples."""


@dataclass(frozen=True)
class Case:
    """One planted recording to be; `fresh` is a second trajectory of the same machine, half as long."""

    name: str
    robot: str  # of robots.robot_file
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
            "truth": [truth_of(p) for p in self.effects],
        }

    def train(self) -> Recorded:
        return self._plant(2 * self.seed, self.seconds, self.effects)

    def fresh(self) -> Recorded:
        """Effects that set in late are on from the start here."""
        return self._plant(
            2 * self.seed + 1, self.seconds / 2, tuple(replace(p, since=None) for p in self.effects)
        )

    def _plant(self, seed: int, seconds: float, effects: tuple[Planted, ...]) -> Recorded:
        path = robot_file(self.robot)
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


def truth_of(planted: Planted) -> dict[str, object]:
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
    path = robot_file(case.robot)
    for source in (path, path.parent / yaml.safe_load(path.read_text())["urdf"]):
        shutil.copyfile(source, folder / "robots" / source.name)
    table = folder / "truth.json"
    truth = json.loads(table.read_text()) if table.exists() else {}
    truth[case.name] = case.truth()
    table.write_text(json.dumps(dict(sorted(truth.items())), indent=1))


def _rng(*words: object) -> np.random.Generator:
    """A generator of its own for every name, so that adding a case changes no other."""
    return np.random.default_rng(crc32(" ".join(map(str, words)).encode()))


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
    alone = effect not in TWO_JOINTS
    robot = robot or str(rng.choice([r for r in SMALL_ROBOTS if alone or len(nominal(r).joints) > 1]))
    joints = nominal(robot).joints
    joint = str(rng.choice(joints[1:] if effect in AFTER_FIRST and len(joints) > 1 else joints))
    excitation = excitation or usual_excitation(effect)
    case = Case(name, robot, excitation, (), int(rng.integers(1, 2**30)), sensors, inexact)
    if effect in MET_EFFECTS:
        planted = met_by(case, effect, joint, size, since, rng)
    else:
        planted = usual_effect(effect, robot, joint, rng, size, since)
    return replace(case, effects=(planted,))


def met_by(
    case: Case,
    effect: str,
    joint: str,
    size: float,
    since: float | None,
    rng: np.random.Generator | None = None,
) -> Planted:
    """An effect of MET_EFFECTS that the trajectory reaches; a smaller limit or stop is met more rarely.

    `rng` draws where a rough spot lies (default: in the middle of the travel).
    """
    healthy, j = case.train(), nominal(case.robot).index(joint)
    tau, q, theta, speed = (healthy.true[name][:, j] for name in ("tau", "q", "theta", "dtheta"))
    if effect == "torque_saturation":
        return Planted(effect, joint, {"limit": rounded((1 - 0.45 * size) * np.abs(tau).max())}, since)
    if effect == "torque_speed_limit":
        drop = rounded(LIMIT_DROP * np.abs(tau).max() / np.abs(speed).max())
        stall = (1 - 0.45 * size) * np.abs(tau + drop * speed).max()
        return Planted(effect, joint, {"stall": rounded(stall), "drop": drop}, since)
    if effect == "rough_spot":
        at, width, share = (0.5, 0.15, 1.0) if rng is None else rng.uniform((0.3, 0.1, 0.8), (0.7, 0.2, 1.2))
        level = 0.08 * nominal(case.robot).torque_limit[j] * size * share
        spot = {"level": level, "position": theta.min() + at * np.ptp(theta), "width": width * np.ptp(theta)}
        return Planted(effect, joint, {name: rounded(value) for name, value in spot.items()}, since)
    extreme = q[np.argmax(np.abs(q))]
    stiffness = 4 * nominal(case.robot).stiffness[j]
    return Planted(
        effect,
        joint,
        {"position": rounded((1 - 0.45 * size) * extreme), "stiffness": rounded(stiffness)},
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
        joints = rng.permutation(nominal(robot).joints)
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
