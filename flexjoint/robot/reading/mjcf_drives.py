"""The drives and effects of an MJCF that `flexjoint export` wrote, read back.

Such a file says so (`MARK`), and has names of its own for what MuJoCo has no word for: they are defined here,
for who writes and who reads it. Of other files nothing of this is read: there a gain may be anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from flexjoint.core.errors import RobotError
from flexjoint.core.messages import shown
from flexjoint.robot.reading import xml_file

MARK = ("written_by", "flexjoint export")  # a <text> below <custom>
ROTOR = "rotor."  # before the name of a joint: its rotor's hinge
SPRING, PRELOAD, CREEP, STOP, DRIVE = "spring.", "preload.", "creep.", "stop.", "drive."  # tendons
MOTOR, SHARED = "motor.", "shared."  # tendons: of a motor that several joints share, of a shared friction
DIFFERENTIAL = {"sum": "sum.", "difference": "difference."}  # tendons of the two motors of a differential
BIAS, OFFSET = "bias.", "offset."  # constant torques along the tendon of a motor
RK4 = "RK4"  # the integrator under which delays are half a step longer
SOFT = 1e-4  # smallest impedance of MuJoCo's limits: as a spring whose end has this share of its inertia
PULL = 1e-6  # N m/rad: so soft a spring, stretched far, is a constant torque

Entry = Mapping[str, Any]  # an effect as a robot file lists it


@dataclass(frozen=True)
class Drives:
    """What an exported MJCF says: keys of a robot file by joint, effects, gravity [m/s^2], steps a second."""

    joints: Mapping[str, Mapping[str, float]]
    effects: Sequence[Entry]
    gravity: tuple[float, float, float]
    rate: float
    couplings: Sequence[Entry] = ()  # as a robot file lists them


def read(root: Element, where: str, inverse_inertia: Callable[[str], float]) -> Drives | None:
    """The drives of an exported MJCF, None of another one.

    inverse_inertia: of a link about its joint, where all positions are 0 [1/(kg m^2)].
    Raises RobotError where a number is none.
    """
    if not any((e.get("name"), e.get("data")) == MARK for e in root.iter("text")):
        return None
    return _Reader(root, where, inverse_inertia).drives()


class _Reader:
    def __init__(self, root: Element, where: str, inverse_inertia: Callable[[str], float]) -> None:
        self.root, self.where, self.inverse_inertia = root, where, inverse_inertia
        self.hinges = {
            e.get("name", ""): e for world in root.findall("worldbody") for e in world.iter("joint")
        }
        self.tendons = {e.get("name", ""): e for e in root.findall("tendon/fixed")}
        commanded = [*root.findall("actuator/general"), *root.findall("actuator/dcmotor")]
        self.motors = {e.get("name", ""): e for e in commanded}
        option = root.find("option")
        self.step = self._number(option, "timestep") or 1e-3
        self.integrator = option.get("integrator") if option is not None else None
        self.names = [e.get("name", "") for e in root.findall("actuator/*") if e.get("input") != "none"]

    def drives(self) -> Drives:
        option = self.root.find("option")
        gravity = self._numbers(option, "gravity", (3,)) or [0.0, 0.0, -9.81]
        joints, effects = {}, []
        for name in self.names:
            if name not in self.hinges:
                raise RobotError(
                    f"{self.where}: actuator '{shown(name)}' has no joint of its name; export it anew"
                )
            rotor = self.hinges.get(f"{ROTOR}{name}")
            joints[name] = self._drive(name, self._motor(name), rotor is not None)
            effects += [
                {"effect": effect, "joint": name, **values} for effect, values in self._effects(name, rotor)
            ]
        return Drives(
            joints, effects, (gravity[0], gravity[1], gravity[2]), 1.0 / self.step, self._couplings()
        )

    # --- motors that joints share ---------------------------------------------------------------------------
    def _motor(self, name: str) -> Element:
        """What carries the inertia, damping and friction of a joint's motor."""
        shared = self.tendons.get(f"{MOTOR}{name}")
        own = self.hinges.get(f"{ROTOR}{name}", self.hinges[name])
        return own if shared is None else shared

    def _coupled(self, name: str) -> bool:
        return f"{MOTOR}{name}" in self.tendons

    def _turns(self, name: str) -> dict[str, float]:
        """Shares of the joints in the position of a coupled motor, by joint."""
        shares = self._by_joint(f"{MOTOR}{name}")
        if not shares:
            raise self._edited(f"{MOTOR}{name}")
        return shares

    def _by_joint(self, tendon: str) -> dict[str, float]:
        """Shares of the joints that have a motor in a tendon."""
        shares = self._shares(self.tendons[tendon])
        by_joint = {hinge.removeprefix(ROTOR): share for hinge, share in shares.items()}
        if not by_joint.keys() <= set(self.names):
            raise self._edited(tendon)
        return by_joint

    def _edited(self, tendon: str) -> RobotError:
        return RobotError(
            f"{self.where}: tendon '{shown(tendon)}' does not turn with joints that have motors, as exported"
            " files have it; export it anew"
        )

    def _matrix(self, group: list[str]) -> np.ndarray:
        """(k, k) of a coupling; RobotError where it has no inverse."""
        matrix = np.array([[self._turns(motor).get(joint, 0.0) for joint in group] for motor in group])
        if np.linalg.matrix_rank(matrix) < len(group):
            raise self._edited(f"{MOTOR}{group[0]}")
        return matrix

    def _group(self, name: str) -> list[str]:
        group = next(group for group in self._groups(self.names_coupled) if name in group)
        lacking = [joint for joint in group if not self._coupled(joint)]
        if lacking:
            raise self._edited(f"{MOTOR}{lacking[0]}")
        return group

    def _couplings(self) -> list[Entry]:
        out: list[Entry] = []
        for group in self._groups(self.names_coupled):
            out.append({"joints": group, "matrix": self._matrix(self._group(group[0])).tolist()})
        return out

    def _groups(self, motors: list[str]) -> list[list[str]]:
        """The joints of each coupling, in the file's order."""
        groups: list[set[str]] = []
        for name in motors:
            own = {name, *self._turns(name)}
            for other in [group for group in groups if group & own]:
                groups.remove(other)
                own |= other
            groups.append(own)
        return [[name for name in self.names if name in group] for group in groups]

    def _shared_gains(self, name: str) -> float:
        """The gain of a coupled motor, from what the commands at its joints pull: N' G N'^-1."""
        group = self._group(name)
        turns = self._matrix(group)
        pulls = np.zeros((len(group), len(group)))
        for column, joint in enumerate(group):
            tendon = f"{DRIVE}{joint}"
            shares = self._by_joint(tendon) if tendon in self.tendons else {joint: 1.0}
            if not shares.keys() <= set(group):
                raise self._edited(tendon)
            for pulled, share in shares.items():
                pulls[group.index(pulled), column] = share
        place = group.index(name)
        return float(np.linalg.solve(turns.T, pulls @ turns.T)[place, place])

    @property
    def names_coupled(self) -> list[str]:
        return [name for name in self.names if self._coupled(name)]

    def _constant(self, tendon: str, along: str) -> float:
        """The constant torque that a soft tendon makes along another one; 0 where it is not there."""
        soft = self.tendons.get(tendon)
        if soft is None:
            return 0.0
        size = self._number(soft, "stiffness") * self._number(soft, "springlength")
        shares, others = self._shares(soft), self._shares(self.tendons[along])
        return math.copysign(size, sum(share * others.get(name, 0.0) for name, share in shares.items()))

    # --- numbers --------------------------------------------------------------------------------------------
    def _numbers(self, element: Element | None, key: str, counts: tuple[int, ...] = ()) -> list[float]:
        text = element.get(key) if element is not None else None
        if element is None or text is None:
            return []
        return xml_file.numbers(
            text, counts, f"{self.where}: {element.tag} {shown(element.get('name', ''))}: {key}"
        )

    def _number(self, element: Element | None, key: str, place: int = 0) -> float:
        found = self._numbers(element, key)
        return found[place] if place < len(found) else 0.0

    def _drive(self, name: str, motor: Element, flexible: bool) -> dict[str, float]:
        stiffness, damping = math.inf, 0.0
        inertia = self._number(motor, "armature")
        if flexible:
            spring = self.tendons.get(f"{SPRING}{name}")
            stiffness, damping = self._number(spring, "stiffness"), self._number(spring, "damping")
            limit = self._numbers(spring, "solreflimit", (2,))
            if (
                limit
            ):  # a play: a limit's stiffness, scaled by the inverse inertia (MuJoCo, Solver parameters)
                scale = (1.0 - SOFT) * (self.inverse_inertia(name) + self._mobility(name, inertia))
                stiffness, damping = -limit[0] / scale, -limit[1] / scale
        out = {
            "stiffness": stiffness,
            "damping": damping,
            "motor_inertia": inertia,
            "motor_damping": self._number(motor, "damping"),
        }
        most = self._number(self.motors.get(name), "ctrlrange", 1)
        return {**out, "torque_limit": most} if most > 0.0 else out

    def _mobility(self, name: str, inertia: float) -> float:
        """Of a rotor about its joint [1/(kg m^2)]."""
        if not self._coupled(name):
            return 1.0 / max(inertia, 1e-12)
        group = self._group(name)
        inverse = np.linalg.inv(self._matrix(group))
        motors = [self._number(self.tendons[f"{MOTOR}{motor}"], "armature") for motor in group]
        place = group.index(name)
        return float(np.sum(inverse[place] ** 2 / np.maximum(motors, 1e-12)))

    # --- effects --------------------------------------------------------------------------------------------
    def _effects(self, name: str, rotor: Element | None) -> Iterator[tuple[str, dict[str, Any]]]:
        link = self.hinges[name]
        yield from self._friction(name, rotor)
        stiffness = self._number(link, "stiffness")
        if stiffness > PULL:
            yield "cable_spring", {"stiffness": stiffness, "rest": self._number(link, "springref")}
        drag = self._number(link, "damping", 1)
        if drag:
            yield "quadratic_drag", {"coefficient": drag}
        stop = self.tendons.get(f"{STOP}{name}")
        band = self._numbers(stop, "springlength", (2,))
        if band:
            place = band[1] if abs(band[1]) < abs(band[0]) else band[0]  # the other edge is far
            yield "end_stop", {"position": place, "stiffness": self._number(stop, "stiffness")}
        if rotor is not None:
            yield from self._spring(name)
        yield from self._command(name)
        yield from self._delays(name)

    def _friction(self, name: str, rotor: Element | None) -> Iterator[tuple[str, dict[str, Any]]]:
        link, motor = self.hinges[name], self._motor(name)
        level = self._number(motor, "frictionloss")
        constant = self._constant(f"{BIAS}{name}", f"{MOTOR}{name}")
        if self._number(motor, "stiffness") == PULL:
            constant = PULL * self._number(motor, "springref")
        if constant:
            yield (
                "asymmetric_friction",
                {"level_positive": level - constant, "level_negative": level + constant},
            )
        elif level:
            yield "motor_coulomb_friction", {"level": level}
        if rotor is not None or self._coupled(name):
            for effect, key, number in (
                ("link_coulomb_friction", "frictionloss", "level"),
                ("link_viscous_friction", "damping", "coefficient"),
            ):
                if self._number(link, key):
                    yield effect, {number: self._number(link, key)}
        yield from self._loop("dahl_friction", name)
        numbers = {"level": "frictionloss", "coefficient": "damping"}
        shared = self.tendons.get(f"{SHARED}{name}")
        if shared is not None:
            before = [
                share
                for hinge, share in self._shares(shared).items()
                if hinge not in (name, f"{ROTOR}{name}")
            ]
            speed = "difference" if before and before[0] < 0.0 else "sum"
            values = {key: self._number(shared, attribute) for key, attribute in numbers.items()}
            yield "coupled_friction", {**values, "speed": speed}
        both = {speed: self.tendons.get(f"{kind}{name}") for speed, kind in DIFFERENTIAL.items()}
        if None not in both.values():
            yield (
                "differential_friction",
                {
                    f"{key}_{speed}": self._number(tendon, attribute)
                    for speed, tendon in both.items()
                    for key, attribute in numbers.items()
                },
            )

    def _loop(self, effect: str, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        bristles = self._numbers(self.motors.get(f"{effect}.{name}"), "lugre", (5,))
        if bristles and bristles[0] > 0.0:
            yield effect, {"level": bristles[2], "scale": bristles[2] / bristles[0]}

    def _spring(self, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        spring = self.tendons.get(f"{SPRING}{name}")
        play = self._numbers(spring, "range", (2,))
        if play:
            yield "backlash", {"gap": play[1] - play[0]}
        if self._number(spring, "stiffness", 2):
            yield "hardening_spring", {"cubic": self._number(spring, "stiffness", 2)}
        preload = self.tendons.get(f"{PRELOAD}{name}")
        if preload is not None:
            size = self._number(preload, "stiffness") * self._number(preload, "springlength")
            yield "spring_preload", {"torque": -size * self._shares(preload).get(f"{ROTOR}{name}", 0.0)}
        creep = self.tendons.get(f"{CREEP}{name}")
        stiffness = self._number(creep, "stiffness")
        if stiffness:
            damping = self._number(self.hinges.get(f"{CREEP}{name}"), "damping")
            yield "spring_creep", {"stiffness": stiffness, "time_constant": damping / stiffness}
        yield from self._loop("spring_hysteresis", name)

    def _shares(self, tendon: Element) -> dict[str, float]:
        return {e.get("joint", ""): self._number(e, "coef") for e in tendon.findall("joint")}

    def _gain(self, name: str) -> float:
        if self._coupled(name):
            gain = self._shared_gains(name)
            return 1.0 if math.isclose(gain, 1.0, rel_tol=1e-9) else gain
        return (
            self._number(self.motors.get(name), "gainprm") if "gainprm" in self.motors[name].attrib else 1.0
        )

    def _command(self, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        motor, gain = self.motors.get(name), self._gain(name)
        if motor is not None and motor.tag == "dcmotor":
            constant = self._number(motor, "motorconst")
            stall = constant * self._number(motor, "controller", 5)
            yield "torque_speed_limit", {"stall": stall, "drop": constant**2}
        if gain != 1.0:
            yield "torque_gain", {"gain": gain - 1.0}
        for effect, key, place, number in (
            ("torque_offset", "biasprm", 0, "offset"),
            ("torque_saturation", "forcerange", 1, "limit"),
            ("current_lag", "dynprm", 0, "time_constant"),
        ):
            if self._number(motor, key, place):
                yield effect, {number: self._number(motor, key, place)}
        offset = self._constant(f"{OFFSET}{name}", f"{MOTOR}{name}")
        if offset:
            yield "torque_offset", {"offset": offset}
        late = self._number(motor, "delay")
        if late > 0.0:  # half a step of it is that commands are held
            held = 0.5 * self.step if self.integrator == RK4 else 0.0
            yield "torque_delay", {"delay": max(late - held, 0.0)}
        wave = self._numbers(self.motors.get(f"cogging.{name}"), "cogging", (3,))
        if wave and gain:
            yield "cogging", {"amplitude": wave[0] / gain, "cycles": wave[1], "phase": wave[2]}
        for side, step in () if self._coupled(name) else (("before", -1), ("after", 1)):
            place = self.names.index(name) + step
            other = self.names[place] if 0 <= place < len(self.names) else ""
            tendon = self.tendons.get(f"{DRIVE}{other}")
            shares = self._shares(tendon) if tendon is not None else {}
            share = shares.get(f"{ROTOR}{name}", shares.get(name, 0.0))
            if other and share and gain:
                yield "joint_coupling", {"share": share * self._gain(other) / gain, "side": side}

    def _delays(self, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        late = {
            channel: self._number(sensor, "delay")
            for channel in ("q", "theta")
            for sensor in self.root.findall("sensor/jointpos")
            if sensor.get("name") == f"{channel}.{name}"
        }
        q, theta = late.get("q", 0.0), late.get("theta", 0.0)
        if q and q == theta:
            yield "sensor_delay", {"delay": q}
        elif q or theta:
            yield "sensor_delay", {"delay": q or theta, "channel": "q" if q else "theta"}
