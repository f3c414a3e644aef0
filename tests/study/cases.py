"""What the study plants: every case a function of its part and its number, so that shards need no list.

- single: every effect of the generator, sizes from the usual one down to a fiftieth of it
- double: two causes on one machine
- healthy: nothing
- struck: one cause, with its effect (and those that contain it) taken out of the product's catalogue
- several: one cause in two recordings of one machine, with other motions and other unknown encoder offsets;
  in every other case the second was made with a known payload
- beyond: as single, for the effects that came later; none of the other parts has them
- drawn: a robot, its controller, sensors and rates drawn at random for each; every fourth is healthy, the
  others have one cause, of any effect
- dirty, background, unknown: machines with wrong numbers and a background of small errors, under one to three
  large causes, by itself, and under a large law that no catalogue lists (planting/dirty). Their numbers
  below SEALED are for development and may lead to rules; those from SEALED on are sealed: they are run to
  count, and no rule comes from looking at one.
- fresh: machines drawn as for `drawn`, of one to seven joints; one, two or three causes, nothing, or one
  cause that is struck, in the shares FRESH_KINDS. It is run to count what the diagnosis reaches on machines
  that no rule has seen, at any commit; its outcome must never lead to a rule.

Seeds. What a case is follows from a generator seeded with its part's name and its number. A drawn robot
follows from a number, too: `drawn` has 0 to 159, planting/dirty 1000 to 99999, single tests a few below 1000;
fresh has FRESH_ROBOTS + its number, 1000000 to 1001009. The seed of a machine's numbers, motion and noise
lies below FRESH_SEEDS = 2^30 in every other part, and from there to 2^31 in fresh. The last TRIALS numbers of
fresh, 1000 to 1009, are there to see that it works: they are never counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from zlib import crc32

import numpy as np
from planting import (
    BEYOND,
    CATALOGUE,
    ENCODERS,
    FROM_CURRENT,
    FULL,
    LINK_SIDE,
    MOTOR_ONLY,
    NO_COMMAND,
    RAGGED,
    Planted,
    SensorSet,
    read_robot,
    robot_file,
)
from planting.cases import AFTER_FIRST, INEXACT, Case, met_by
from planting.catalogue import DRY_MOTOR, LATER, TWO_JOINTS, WITH_STATE
from planting.dirty.dirty import dirty
from planting.drawn import in_logarithm
from planting.machine.sensing import CURRENT
from planting.sizes import MET_EFFECTS, STEP_EFFECTS, nominal, usual_effect, usual_excitation

EFFECTS = tuple(CATALOGUE)
EVERY = (*EFFECTS, *BEYOND)
ALL = (*EVERY, *LATER)
PLANTED = {"single": EFFECTS, "struck": EFFECTS, "beyond": tuple(BEYOND)}
PER_EFFECT = {"single": 12, "struck": 4, "beyond": 12}
COUNTS = {
    "single": 12 * len(EFFECTS),
    "double": 140,
    "healthy": 1000,
    "struck": 4 * len(EFFECTS),
    "several": 40,
    "beyond": 12 * len(BEYOND),
    "drawn": 160,
    "dirty": 400,
    "background": 400,
    "unknown": 400,
    "fresh": 1000,
}
TRIALS = 10  # numbers of fresh beyond those that count
DIRTY = {"dirty": "causes", "background": "background", "unknown": "unknown"}  # kinds of planting.dirty
SEALED = 200
USUAL = tuple(part for part in COUNTS if part not in (*DIRTY, "fresh"))  # what `make study` runs
SMALLEST = 0.02  # of the usual size: most effects are then below the noise

ROBOT_SHARES = {"lever": 0.2, "turret": 0.18, "crane": 0.24, "scara": 0.16, "gimbal": 0.18, "reach": 0.04}
EXCITATIONS = ("rich", "slow", "steps")
USUAL_EXCITATION = 0.6  # share of cases under the excitation that shows their effect well
RATES = {500.0: 0.7, 250.0: 0.15, 1000.0: 0.15}  # Hz; the controllers tick at 1000 Hz
LARGE_RATE = 500.0  # Hz at most for the robot of seven joints
SECONDS = (8.0, 12.0)
LATE = 0.08  # share of single causes that set in during the recording
SINGLE_STRUCK_SIZE = (0.25, 1.0)
DOUBLE_SIZE = (0.2, 1.0)
DRAWN_SIZE = (0.1, 1.0)
DRAWN_HEALTHY = 4  # every so many
DRAWN_KINDS = {"off": 0.5, "exact": 0.3, "loose": 0.2}  # of nominal models
LOOSE = 0.05  # and off by as much as the loose ones say
DRAWN_RATES = {1000.0: 0.2, 500.0: 0.3, 250.0: 0.2, 200.0: 0.15, 125.0: 0.15}
DRAWN_SECONDS = (5.0, 16.0)
FRESH_KINDS = {"single": 0.35, "double": 0.2, "triple": 0.1, "healthy": 0.25, "struck": 0.1}
TOGETHER = {"double": 2, "triple": 3}  # causes on one machine
FRESH_JOINTS = {1: 0.16, 2: 0.22, 3: 0.2, 4: 0.14, 5: 0.1, 6: 0.1, 7: 0.08}
MANY_JOINTS = 5  # from which a recording is short and slow, for the duration of the study:
MANY_RATE, MANY_SECONDS = 250.0, 10.0  # Hz and s at most
FRESH_ROBOTS, FRESH_SEEDS = 1_000_000, 2**30
POSITION_NOISE, VELOCITY_NOISE = (3e-6, 2e-4), (1e-3, 2e-2)  # rad, rad/s
TORQUE_NOISE = (5e-4, 8e-3)  # of a joint's torque limit
ENCODER_BITS = (14, 20)
OFFSET = 0.02  # rad, of encoder offsets that nobody knows
LOAD = 0.5  # of a link's mass: a known payload

SENSORS: dict[str, SensorSet] = {
    name: replace(sensors, noisy_feedback=False)  # the command is smooth between two recorded samples
    for name, sensors in {
        "full": FULL,
        "no torque sensor": ENCODERS,
        "motor side only": MOTOR_ONLY,
        "link side only": LINK_SIDE,
        "no command": NO_COMMAND,
        "torque from current": FROM_CURRENT,
        "ragged time": RAGGED,
        "unknown offsets": FULL,
    }.items()
} | {"noisy feedback": FULL}
SENSOR_SHARES = {
    "full": 0.34,
    "no torque sensor": 0.12,
    "motor side only": 0.07,
    "link side only": 0.05,
    "no command": 0.08,
    "torque from current": 0.1,
    "ragged time": 0.1,
    "unknown offsets": 0.06,
    "noisy feedback": 0.08,
}

TORQUE_SENSOR = {"torque_sensor_offset", "torque_sensor_gain"}
LINK_EFFECTS = {
    "payload",
    "base_tilt",
    "link_coulomb_friction",
    "link_viscous_friction",
    "cable_spring",
    "end_stop",
    "quadratic_drag",
    "periodic_disturbance",
}
MOTOR_EFFECTS = {
    "torque_gain",
    "torque_offset",
    "torque_saturation",
    "cogging",
    "motor_inertia",
    "motor_viscous_friction",
    *DRY_MOTOR,
    "dahl_friction",
    "torque_speed_limit",
    *TWO_JOINTS,
}
ENCODER_CONSTANTS = {"link_encoder_offset", "motor_encoder_offset", "spring_preload"}
BY_CURRENT = {"torque_delay", "torque_saturation", "current_lag", "torque_speed_limit", "joint_coupling"}
CHANGES_IN_TIME = ("friction_drift", "breakaway_friction")  # by themselves: none sets in late
SHOWN: dict[str, set[str]] = {
    "no torque sensor": set(ALL) - TORQUE_SENSOR,
    "motor side only": MOTOR_EFFECTS | {"payload"},
    "link side only": LINK_EFFECTS,
    "torque from current": set(ALL) - BY_CURRENT,  # which the current shows
    "unknown offsets": set(ALL) - ENCODER_CONSTANTS,
}
"""Effects that leave a mark of their own in what a set of sensors records (default: all)."""

TWINS = (ENCODER_CONSTANTS, {"torque_delay", "sensor_delay"}, {"torque_gain", "torque_sensor_gain"})
"""Effects that would be told apart badly beside each other on one joint."""


@dataclass(frozen=True)
class StudyCase:
    """One recording to be and how it is to be diagnosed."""

    part: str
    number: int
    case: Case  # its effects are what there is to find
    sensors: str
    size: float  # of the usual one
    excluded: tuple[str, ...] = ()
    hidden: tuple[Planted, ...] = ()  # what the robot file declares as unknown: no cause
    second: Case | None = None  # another recording of the machine, all that it holds included: its `fresh`
    load: Planted | None = None  # of the second recording, and known

    @property
    def name(self) -> str:
        return f"{self.part}-{self.number:04d}"


def make(part: str, number: int) -> StudyCase:
    """The case; raises ValueError when there is none."""
    makers = {
        "single": _single,
        "double": _double,
        "healthy": _healthy,
        "struck": _struck,
        "several": _several,
        "beyond": _beyond,
        "drawn": _any_robot,
        "fresh": _fresh,
        **{part: partial(_dirty, part) for part in DIRTY},
    }
    if part not in makers:
        raise ValueError(f"unknown part {part!r}; there are {', '.join(makers)}")
    count = COUNTS[part] + (TRIALS if part == "fresh" else 0)
    if not 0 <= number < count:
        raise ValueError(f"{part} has cases 0 to {count - 1}, got {number}")
    return makers[part](number, np.random.default_rng([crc32(part.encode()), number]))


def _single(number: int, rng: np.random.Generator, part: str = "single") -> StudyCase:
    repeats = PER_EFFECT[part]
    effect, repeat = PLANTED[part][number // repeats], number % repeats
    if part != "struck":
        size = float(SMALLEST ** ((repeat + rng.random()) / repeats))  # evenly in the logarithm
        sensors = _drawn(SENSOR_SHARES, rng, lambda name: effect in SHOWN.get(name, EVERY))
        late = rng.random() < LATE and effect not in CHANGES_IN_TIME
    else:
        size, sensors, late = float(rng.uniform(*SINGLE_STRUCK_SIZE)), "full", False
    robot = _drawn(ROBOT_SHARES, rng, lambda name: _sits_on(effect, name))
    joints = read_robot(robot_file(robot)).joints
    joint = str(rng.choice(joints[1:] if effect == "payload" and len(joints) > 1 else joints))
    usual = rng.random() < USUAL_EXCITATION
    excitation = usual_excitation(effect) if usual else str(rng.choice(EXCITATIONS))
    case = _case(part, number, robot, excitation, sensors, rng)
    since = round(float(rng.uniform(0.35, 0.65)) * case.seconds, 2) if late else None
    if effect in MET_EFFECTS:
        planted = met_by(case, effect, joint, size, since, rng)
    else:
        planted = usual_effect(effect, robot, joint, rng, size, since)
    return _with(part, number, case, (planted,), sensors, size, rng)


def _beyond(number: int, rng: np.random.Generator) -> StudyCase:
    return _single(number, rng, "beyond")


def _struck(number: int, rng: np.random.Generator) -> StudyCase:
    case = _single(number, rng, "struck")
    return replace(case, excluded=(case.case.effects[0].effect,))


def _double(number: int, rng: np.random.Generator) -> StudyCase:
    robot = _drawn(ROBOT_SHARES, rng)
    joints = read_robot(robot_file(robot)).joints
    size = in_logarithm(rng, *DOUBLE_SIZE)
    sensors = _drawn({k: SENSOR_SHARES[k] for k in ("full", "no torque sensor", "ragged time")}, rng)
    pool = [
        e
        for e in EFFECTS
        if e not in STEP_EFFECTS and e in SHOWN.get(sensors, EFFECTS) and _sits_on(e, robot)
    ]
    (first, second), at = _beside_each_other(2, pool, joints, rng)
    excitation = str(rng.choice(["rich", "rich", usual_excitation(first), usual_excitation(second)]))
    planted = tuple(usual_effect(e, robot, j, rng, size) for e, j in zip((first, second), at, strict=True))
    case = _case("double", number, robot, excitation, sensors, rng)
    return _with("double", number, case, planted, sensors, size, rng)


def _beside_each_other(
    count: int, pool: Sequence[str], joints: Sequence[str], rng: np.random.Generator
) -> tuple[list[str], list[str]]:
    """Effects of a pool, on joints of their own or on one, that can be told apart there."""
    while True:
        effects = [str(e) for e in rng.choice(pool, count, replace=False)]
        places = rng.permutation(joints) if rng.random() < 0.7 else [str(rng.choice(joints))] * count
        at = [str(places[k % len(places)]) for k in range(count)]
        placed = list(zip(effects, at, strict=True))
        related = any(
            j == other_j and any({e, other} <= set(group) for group in (*TWINS, DRY_MOTOR, WITH_STATE))
            for (e, j), (other, other_j) in combinations(placed, 2)
        )
        if not related and not any(e in AFTER_FIRST and j == joints[0] != joints[-1] for e, j in placed):
            return effects, at


def _several(number: int, rng: np.random.Generator) -> StudyCase:
    loaded = number % 2 == 1
    robot = _drawn({k: v for k, v in ROBOT_SHARES.items() if k not in ("turret", "reach")}, rng)
    joints = read_robot(robot_file(robot)).joints
    pool = [e for e in EFFECTS if e not in STEP_EFFECTS and e in SHOWN["unknown offsets"]]
    effect = str(rng.choice([e for e in pool if not (loaded and e == "payload")]))
    joint = str(rng.choice(joints[1:] if effect == "payload" and len(joints) > 1 else joints))
    size = in_logarithm(rng, *DOUBLE_SIZE)
    first, other = (str(e) for e in rng.choice(EXCITATIONS, 2, replace=False))
    planted = (usual_effect(effect, robot, joint, rng, size),)
    sensors = "unknown offsets"
    case = _with(
        "several", number, _case("several", number, robot, first, sensors, rng), planted, sensors, size, rng
    )
    again = _with("several", number, case.case, planted, sensors, size, rng)  # draws other offsets
    load = _load(robot, joints[-1]) if loaded else None
    held = (*planted, *again.hidden, *([load] if load else []))
    second = replace(case.case, excitation=other, effects=held, seconds=2.0 * case.case.seconds)
    return replace(case, second=second, load=load)


def _load(robot: str, joint: str) -> Planted:
    """A payload below the centre of a link."""
    body = nominal(robot).bodies[nominal(robot).index(joint)]
    place = [round(1.3 * float(c), 4) for c in body.com]
    return Planted("payload", joint, {"mass": round(LOAD * float(body.mass), 3), "position": place})


def _healthy(number: int, rng: np.random.Generator) -> StudyCase:
    robot = _drawn(ROBOT_SHARES, rng)
    sensors = _drawn(SENSOR_SHARES, rng)
    case = _case("healthy", number, robot, EXCITATIONS[number % 3], sensors, rng)
    return _with("healthy", number, case, (), sensors, 0.0, rng)


def _any_robot(number: int, rng: np.random.Generator) -> StudyCase:
    case, sensors = _any_machine(f"drawn-{number:04d}", f"drawn_{number}", rng)
    if number % DRAWN_HEALTHY == 0:
        return StudyCase("drawn", number, case, sensors, 0.0)
    case, size = _with_any_cause(case, _shown(EVERY, sensors, case.robot), rng)
    return StudyCase("drawn", number, case, sensors, round(size, 4))


def _fresh(number: int, rng: np.random.Generator) -> StudyCase:
    kind = _drawn(FRESH_KINDS, rng)
    joints = int(rng.choice(list(FRESH_JOINTS), p=list(FRESH_JOINTS.values())))
    robot = f"drawn_{FRESH_ROBOTS + number}_of{joints}"
    # with all sensors, what amounts to a struck effect is known (score.STRUCK_EQUIVALENTS)
    case, sensors = _any_machine(f"fresh-{number:04d}", robot, rng, "full" if kind == "struck" else None)
    case = replace(case, seed=FRESH_SEEDS + case.seed)
    if joints >= MANY_JOINTS:
        case = replace(case, rate=min(case.rate, MANY_RATE), seconds=min(case.seconds, MANY_SECONDS))
    pool, size = _shown(ALL, sensors, case.robot), 0.0
    if kind in ("single", "struck"):
        case, size = _with_any_cause(case, pool, rng)
    elif kind in TOGETHER:
        case, size = _with_causes(case, TOGETHER[kind], pool, rng)
    struck = tuple(p.effect for p in case.effects) if kind == "struck" else ()
    return StudyCase("fresh", number, case, sensors, round(size, 4), struck)


def _any_machine(
    name: str, robot: str, rng: np.random.Generator, sensors: str | None = None
) -> tuple[Case, str]:
    """A drawn robot as its file says it or off by what is said, its motion and its sensors (default: any)."""
    kind = _drawn(DRAWN_KINDS, rng)
    robot += {"off": "", "exact": "_exact", "loose": "_loose"}[kind]
    known = {name: share for name, share in SENSOR_SHARES.items() if name != "unknown offsets"}
    sensors = sensors or _drawn(known, rng)
    case = Case(
        name,
        robot,
        str(rng.choice(EXCITATIONS)),
        (),
        int(rng.integers(1, 2**30)),
        _any_sensors(SENSORS[sensors], nominal(robot).torque_limit, rng),
        {"off": INEXACT, "exact": 0.0, "loose": LOOSE}[kind],
        round(in_logarithm(rng, *DRAWN_SECONDS), 1),
        float(rng.choice(list(DRAWN_RATES), p=list(DRAWN_RATES.values()))),
    )
    return case, sensors


def _shown(effects: Sequence[str], sensors: str, robot: str) -> list[str]:
    """Those that leave a mark of their own in what the sensors of a robot record."""
    return [e for e in effects if e in SHOWN.get(sensors, ALL) and _sits_on(e, robot)]


def _with_any_cause(case: Case, pool: Sequence[str], rng: np.random.Generator) -> tuple[Case, float]:
    """The case with one cause of any size, and that size."""
    joints = nominal(case.robot).joints
    effect, size = str(rng.choice(pool)), in_logarithm(rng, *DRAWN_SIZE)
    joint = str(rng.choice(joints[1:] if effect in AFTER_FIRST and len(joints) > 1 else joints))
    if rng.random() < USUAL_EXCITATION:
        case = replace(case, excitation=usual_excitation(effect))
    if effect in MET_EFFECTS:
        planted = met_by(case, effect, joint, size, None, rng)
    else:
        planted = usual_effect(effect, case.robot, joint, rng, size)
    return replace(case, effects=(planted,)), size


def _with_causes(case: Case, count: int, pool: Sequence[str], rng: np.random.Generator) -> tuple[Case, float]:
    """The case with several causes of one relative size; none is of MET_EFFECTS, whose sizes follow from the
    motion without the others."""
    size = in_logarithm(rng, *DOUBLE_SIZE)
    effects, at = _beside_each_other(
        count, [e for e in pool if e not in MET_EFFECTS], nominal(case.robot).joints, rng
    )
    if rng.random() < USUAL_EXCITATION:
        case = replace(case, excitation=usual_excitation(str(rng.choice(effects))))
    planted = tuple(usual_effect(e, case.robot, j, rng, size) for e, j in zip(effects, at, strict=True))
    return replace(case, effects=planted), size


def _dirty(part: str, number: int, _rng: np.random.Generator) -> StudyCase:
    case = dirty(DIRTY[part], number)  # draws by itself
    return StudyCase(part, number, case, case.sensed, 1.0)


def _any_sensors(sensors: SensorSet, limit: np.ndarray, rng: np.random.Generator) -> SensorSet:
    """The set with noise and encoders of any quality; `limit` (n,) of the joints' torques."""
    position, velocity = in_logarithm(rng, *POSITION_NOISE), in_logarithm(rng, *VELOCITY_NOISE)
    torque = tuple(in_logarithm(rng, *TORQUE_NOISE) * limit)
    noise: dict[str, float | tuple[float, ...]] = {
        channel: level * float(rng.uniform(0.5, 1.5))
        for channel, level in {"q": position, "theta": position, "dq": velocity, "dtheta": velocity}.items()
    }
    bits = int(rng.integers(ENCODER_BITS[0], ENCODER_BITS[1] + 1))
    return replace(sensors, noise=noise | {"tau_t": torque, CURRENT: torque}, resolution=2 * np.pi / 2**bits)


def _case(
    part: str, number: int, robot: str, excitation: str, sensors: str, rng: np.random.Generator
) -> Case:
    """Machine and motion: half of the nominal models are off by 2 %, the others are exact, most of them
    with tolerances that say so."""
    kind = rng.choice(["off", "exact", "exact, 2 % claimed"], p=[0.5, 0.35, 0.15])
    large = robot == "reach"  # seven joints: short and not faster than 500 Hz, for the study's duration
    case = Case(
        f"{part}-{number:04d}",
        f"{robot}_exact" if kind == "exact" else robot,
        excitation,
        (),
        int(rng.integers(1, 2**30)),
        SENSORS[sensors],
        INEXACT if kind == "off" else 0.0,
        round(float(rng.uniform(*SECONDS)), 1) if not large else SECONDS[0],
        float(rng.choice(list(RATES), p=list(RATES.values()))),
    )
    return replace(case, rate=min(case.rate, LARGE_RATE)) if large else case


def _with(
    part: str,
    number: int,
    case: Case,
    planted: tuple[Planted, ...],
    sensors: str,
    size: float,
    rng: np.random.Generator,
) -> StudyCase:
    hidden: tuple[Planted, ...] = ()
    if sensors == "unknown offsets":
        hidden = tuple(
            Planted(effect, joint, {"offset": round(float(rng.uniform(-OFFSET, OFFSET)), 5)})
            for joint in read_robot(robot_file(case.robot)).joints
            for effect in ("link_encoder_offset", "motor_encoder_offset")
        )
    return StudyCase(part, number, replace(case, effects=planted), sensors, round(size, 4), (), hidden)


def _sits_on(effect: str, robot: str) -> bool:
    """A payload on a vertical axis shows its inertia only, not its mass; a coupling takes two joints."""
    if effect in TWO_JOINTS:
        return len(read_robot(robot_file(robot)).joints) > 1
    return not (effect == "payload" and robot == "turret")


def _drawn(shares: dict[str, float], rng: np.random.Generator, allowed=lambda _name: True) -> str:
    names = [name for name in shares if allowed(name)]
    weights = np.array([shares[name] for name in names])
    return str(rng.choice(names, p=weights / weights.sum()))
