"""MJCF of MuJoCo: a flexible joint is its own hinge and the hinge of a rotor, with a tendon as the spring.

Link and rotor are two masses with a spring between them, as the model has it (Spong 1987): the rotor's
inertia is the armature of a hinge of its own, and the fixed tendon theta - q carries K and D. A rigid joint
has the rotor's inertia as its armature. What MuJoCo has no word for is built of what it has: an elastic stop
is a tendon with a dead band, a preload one that is stretched far, creep a damped hinge behind a spring,
Dahl's friction and the ripple of a motor are passive motors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from flexjoint.core.errors import RobotError
from flexjoint.effects import Drive, Planned, Site
from flexjoint.export import mjcf_couplings
from flexjoint.export.base import Level, Row, Target, Way, absent, coupled, exact, lines, near
from flexjoint.export.mjcf_couplings import VERSION, SharedMotors
from flexjoint.export.rigid import STALL
from flexjoint.export.subject import Body, Subject
from flexjoint.export.xml import child, note, quaternion, whole
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.reading.mjcf_drives import (
    BIAS,
    CREEP,
    DIFFERENTIAL,
    DRIVE,
    MARK,
    MOTOR,
    OFFSET,
    PRELOAD,
    PULL,
    RK4,
    ROTOR,
    SHARED,
    SOFT,
    SPRING,
    STOP,
)
from flexjoint.robot.robot import Robot
from flexjoint.simulation.schemes.modes import linearised

SPECK = 1e-12  # kg and kg m^2: MuJoCo wants some of each moving body
IMPLICIT = "implicitfast"
FAR = 1e9  # rad, where a dead band ends that has one edge
RESOLVED = 0.5  # largest |lambda| h of springs and dampers at the file's step h; RK4 is stable up to 2.8
SLOW = 2.0  # steps in a lag's time constant, below which it is integrated as an exponential
MORE = 8  # times as many steps for dampers as for springs, from which on RK4 is not taken
STEPS = 1000  # steps at most into which the robot's own is divided
LIGHT = 2.0  # steps by which the mass of a creeping damper is late: a lighter one would be unstable
STIFF = ("cable_spring", "end_stop", "spring_creep", "spring_hysteresis", "dahl_friction")
FAINT = "1e-9 1e-9"  # N m/A: a motor constant, of which MuJoCo wants some; it brakes by its square
STICK = "0.9999 0.9999 0.001 0.5 2"  # the hardest that MuJoCo's solver takes: what rests creeps least
COMMANDS = ("current_lag", "torque_saturation", "torque_speed_limit")  # that a ripple passes through
OF_A_MOTOR = ("current_lag", "torque_saturation", "torque_speed_limit")  # no linear map of commands
LATER = "MuJoCo {} or newer"

POLYNOMIAL = LATER.format("3.7")
DELAYS = LATER.format("3.5")
PASSIVE = LATER.format("3.12")


class Mjcf(Target):
    name = "mjcf"
    title = "MuJoCo"
    suffixes = (".xml", ".mjcf")
    numbers: ClassVar[Mapping[str, Way]] = {
        "spring": exact("stiffness and damping of a tendon between the rotor's hinge and the link's"),
        "motor_inertia": exact("armature of the rotor's hinge, of a rigid joint of its own"),
        "motor_damping": exact("damping of that hinge"),
        "torque_limit": exact("ctrlrange of the actuator, whose ctrl is the motor torque"),
        "controller": absent("the actuators take torques; write the control law in your program"),
        "sensing_delay": absent("it belongs to the control law; delay what that reads"),
        "gravity": exact("option gravity; the base frame is the world's"),
        "contacts": absent("add geoms and a ground"),
        "couplings": exact(f"a tendon of the joints it turns is the motor, with its armature ({VERSION})"),
    }
    effects: ClassVar[Mapping[str, Way]] = {
        "asymmetric_friction": exact(
            "frictionloss of the mean level, and half the difference as a constant torque"
        ),
        "backlash": near(
            "spring and damping are a soft limit of the tendon beyond the play; it never pulls while it opens"
        ),
        "base_tilt": exact("option gravity, turned"),
        "breakaway_friction": absent("it wears off as the joint travels; MuJoCo's friction has no memory"),
        "cable_spring": exact("stiffness and springref of the link's hinge"),
        "cogging": exact(f"cogging of a passive dcmotor ({PASSIVE})"),
        "current_lag": exact("dyntype filter of the actuator"),
        "coupled_friction": exact("frictionloss and damping of a tendon of both hinges"),
        "dahl_friction": exact(f"lugre of a passive dcmotor, without its damping ({PASSIVE})"),
        "differential_friction": exact("frictionloss and damping of two tendons of both hinges"),
        "drive_efficiency": absent("MuJoCo's friction knows no load"),
        "encoder_eccentricity": absent("MuJoCo's sensors read true; add it to what you read"),
        "encoder_ripple": absent("MuJoCo's sensors read true; add it to what you read"),
        "end_stop": exact("tendon of the link's hinge with its stiffness and a dead band up to the stop"),
        "friction_drift": absent("a file knows no time: it fades, as the joint warms up"),
        "hardening_spring": exact(f"cubic stiffness of the tendon that is the spring ({POLYNOMIAL})"),
        "joint_coupling": exact("the neighbour's actuator pulls a tendon of both hinges"),
        "learned_deflection": absent("MuJoCo's tendons are linear in the angles"),
        "learned_link_torque": absent("MuJoCo knows no table of a torque; apply it to qfrc_applied"),
        "learned_surface": absent("MuJoCo knows no table of a torque; apply it to qfrc_applied"),
        "learned_torque": absent("MuJoCo knows no table of a torque; apply it to qfrc_applied"),
        "link_coulomb_friction": exact("frictionloss of the link's hinge"),
        "link_encoder_offset": absent("MuJoCo's sensors read true; add it to what you read"),
        "link_viscous_friction": exact("damping of the link's hinge"),
        "load_friction": absent("MuJoCo's friction knows no load"),
        "magnetic_saturation": absent("MuJoCo's actuators are linear in their command; apply it to ctrl"),
        "motor_coulomb_friction": exact("frictionloss of the rotor's hinge"),
        "motor_encoder_offset": absent("MuJoCo's sensors read true; add it to what you read"),
        "motor_inertia": exact("armature"),
        "motor_viscous_friction": exact("damping of the rotor's hinge"),
        "payload": exact("a body of its mass at its position; a negative one in the link's inertial"),
        "periodic_disturbance": absent("a file knows no time; apply it to qfrc_applied"),
        "quadratic_drag": exact(f"quadratic damping of the link's hinge ({POLYNOMIAL})"),
        "rotor_inertia": exact("armature"),
        "rough_spot": absent("MuJoCo's friction knows no place"),
        "sensor_delay": exact(f"delay of the sensors q, dq, theta and dtheta ({DELAYS})"),
        "spring_creep": exact("a hinge with damping k T behind a tendon of stiffness k"),
        "spring_damping": exact("damping of the tendon that is the spring"),
        "spring_hysteresis": exact(f"lugre of a passive dcmotor on the spring's tendon ({PASSIVE})"),
        "spring_preload": exact("a soft tendon that is stretched far: a constant torque"),
        "spring_stiffness": exact("stiffness of the tendon that is the spring"),
        "stribeck_friction": near("frictionloss of its level; without what it has more near rest"),
        "torque_delay": exact(f"delay of the actuator ({DELAYS})"),
        "torque_gain": exact("gainprm of the actuator"),
        "torque_offset": exact("biasprm of the actuator"),
        "torque_saturation": exact("forcerange of the actuator"),
        "torque_sensor_gain": absent("there is no torque sensor in the file; scale what you read"),
        "torque_sensor_offset": absent("there is no torque sensor in the file; add it to what you read"),
        "torque_speed_limit": exact(f"the actuator is a dcmotor, whose voltage is limited ({PASSIVE})"),
        "transmission_error": absent("MuJoCo's tendons are linear in the angles"),
    }

    def of_robots(self, robot: Robot, name: str) -> Way:
        if name == "couplings" and not SharedMotors(robot).all_carried:
            return absent("MuJoCo has inertia between rigid joints of one branch only: each motor turns one")
        return super().of_robots(robot, name)

    def judge(self, robot: Robot, planned: Planned) -> Way:
        way = self._of_shared_motor(robot, planned) or super().judge(robot, planned)
        if way.level is Level.NONE or planned.joint is None:
            return way
        return self._here(robot, planned, planned.joint) or way

    def _here(self, robot: Robot, planned: Planned, joint: str) -> Way | None:
        """How well it is carried on this robot, where that is less than at best."""
        beside = {other.effect.name for other in robot.effects if other.joint == joint}
        name, p = planned.effect.name, planned.p
        if name == "joint_coupling":
            return self._coupling(robot, planned)
        if planned.effect.reaches_before:
            place = robot.joint_names.index(joint)
            if place == 0 or robot.joints[place].rigid is not robot.joints[place - 1].rigid:
                return absent("it takes a joint and the one before it, both rigid or both flexible")
            return None
        special = {
            "cogging": (
                bool(beside & set(COMMANDS)),
                near("as the dcmotor's own torque: what limits or delays the command leaves it alone"),
            ),
            "spring_hysteresis": (
                "backlash" in beside,
                near("as without the play, inside of which it acts, too"),
            ),
            "motor_viscous_friction": (
                name == "motor_viscous_friction" and robot.joint(joint).drive.D_m + p.coefficient < 0.0,
                absent("it makes the motor's damping negative, which MuJoCo does not take"),
            ),
            "sensor_delay": (
                name == "sensor_delay" and p.channel == "tau_t",
                absent("there is no torque sensor in the file; delay what you read"),
            ),
            "torque_speed_limit": (
                name == "torque_speed_limit" and not _limited_by_speed(beside, p),
                near(f"forcerange {STALL}"),
            ),
        }
        less, way = special.get(name, (False, None))
        return way if less else None

    @staticmethod
    def _of_shared_motor(robot: Robot, planned: Planned) -> Way | None:
        """What is not carried of a command at coupled joints."""
        shared, name = coupled(robot), planned.effect.name
        if planned.joint in shared and name in OF_A_MOTOR:
            return absent("the actuators command torques at joints, and this acts on that of a shared motor")
        if name == "joint_coupling" and {planned.joint, neighbour(robot, planned)} & shared:
            return absent("it takes a share of the command of a motor that joints share")
        return None

    @staticmethod
    def _coupling(robot: Robot, planned: Planned) -> Way | None:
        other = neighbour(robot, planned)
        if other is None:
            return exact("there is no neighbour")
        its = {e.effect.name for e in robot.effects if e.joint == other}
        if its & {"torque_offset", "torque_saturation", "torque_speed_limit", "current_lag"}:
            return near(f"what changes the torque of {other} changes its share here, too")
        if _gain(robot, other) == 0.0:
            return absent(f"the actuator of {other} has the gain 0")
        return None

    def write(self, subject: Subject, account: tuple[Row, ...]) -> str:
        return _Writer(subject).whole(account)


def neighbour(robot: Robot, coupling: Planned) -> str | None:
    """The joint whose command acts on another one, too."""
    names = robot.joint_names
    place = names.index(str(coupling.joint)) + (-1 if coupling.p.side == "before" else 1)
    return names[place] if 0 <= place < len(names) else None


def stepping(model: FlexibleJointModel) -> tuple[str, float]:
    """Integrator and step [s]: the robot's own step, divided until springs are resolved. RK4 has to resolve
    dampers, too; where these take many more steps, implicitfast is taken, to which they do not matter."""
    own = 1.0 / model.robot.rates.physics
    size = model.nv + model.nf
    rates = linearised(model, model.rest())
    springs = np.linalg.eigvals(rates[size:, :size])  # minus the squares of the undamped frequencies
    undamped = max(math.sqrt(float(np.max(np.abs(springs)))), _of_effects(model))
    damped = max(float(np.max(np.abs(np.linalg.eigvals(rates)))), undamped)
    few, many = (min(max(math.ceil(own * x / RESOLVED - 1e-9), 1), STEPS) for x in (undamped, damped))
    return (RK4, own / many) if many <= MORE * few else (IMPLICIT, own / few)


def _of_effects(model: FlexibleJointModel) -> float:
    """The fastest frequency that an effect's own stiffness makes [rad/s]."""
    fastest = 0.0
    inverse = inverse_inertias(model)
    for planned in model.effects:
        if planned.joint is None or planned.effect.name not in STIFF:
            continue
        joint, p = model.robot.joint(planned.joint), planned.p
        flow = model.flows[model.robot.joint_names.index(joint.name)]
        motor = 0.0 if joint.rigid else 1.0 / (flow.drive.B + SPECK)
        on_link = planned.effect.site is not Site.MOTOR or joint.rigid
        on_motor = planned.effect.site is not Site.LINK
        stiffness = p.level / p.scale if hasattr(p, "scale") else p.stiffness
        mobility = on_link * inverse[joint.idx_v] + on_motor * motor
        fastest = max(fastest, math.sqrt(stiffness * mobility))
    return fastest


def inverse_inertias(model: FlexibleJointModel) -> np.ndarray:
    """(nv,) of the links about their joints, where all positions are 0, with the rotors of rigid joints."""
    armature = np.zeros(model.nv)
    for i in model.rigid:
        armature[model.joints[i].idx_v] = model.flows[i].drive.B
    return np.asarray(np.diag(model.body.inverse_mass_matrix(model.body.neutral, armature)))


class _Writer:
    """The elements of one file."""

    def __init__(self, subject: Subject) -> None:
        self.subject, self.robot = subject, subject.robot
        self.integrator, self.step = stepping(subject.model)
        self.payloads = {
            str(e.joint): e.p for e in subject.effects if e.effect.name == "payload" and e.p.mass > 0.0
        }
        bare = [e for e in subject.effects if e.effect.name != "payload" or str(e.joint) not in self.payloads]
        self.bodies = subject.bodies_with(FlexibleJointModel(self.robot, bare))
        self.shared = SharedMotors(self.robot)
        self.root = Element("mujoco", model=self.robot.name)
        self.raised: list[str] = []

    def whole(self, account: tuple[Row, ...]) -> str:
        child(self.root, "compiler", angle="radian", autolimits=True)
        child(
            self.root,
            "option",
            timestep=self.step,
            integrator=self.integrator,
            gravity=self.subject.gravity,
        )
        custom = child(self.root, "custom")
        child(custom, "text", name=MARK[0], data=MARK[1])  # by which init reads it back
        world = child(self.root, "worldbody")
        self._links(world)
        self.tendons, self.actuators = child(self.root, "tendon"), child(self.root, "actuator")
        self.branches: dict[tuple[int, ...], Element] = {}  # by coupling: the rotor that carries the next
        for joint in self.robot.joint_names:
            if not self.robot.joint(joint).rigid:
                self._rotor(world, joint)
            if self.shared.of(joint) is not None:
                self._motor(joint)
            self._shared_friction(joint)
            self._stop(joint)
            self._command(joint)
            self._passive(joint)
        self._sensors(child(self.root, "sensor"))
        for element in (self.tendons, self.actuators):
            if not len(element):
                self.root.remove(element)
        return whole(self.root, [*self._head(), *lines(account)])

    def _head(self) -> Iterator[str]:
        yield f"{self.robot.name}, extended model, written by flexjoint export."
        yield "ctrl is the torque of each motor as seen from the link [N m, of a joint that slides N]."
        yield "q of a joint is its hinge's position, theta that of the hinge of its rotor."
        yield "There are no shapes: nothing to see, and no contacts."
        if self.step < 1.0 / self.robot.rates.physics:
            own = 1.0 / self.robot.rates.physics
            yield f"The step is shorter than the robot's, {own:g} s, so that its springs are resolved."
        for link in self.raised:
            yield f"inertia of {link}: near: no body has it; its smaller moments are raised until one has"
        yield "How well MuJoCo carries numbers and effects, and by what:"

    # --- bodies ---------------------------------------------------------------------------------------------
    def _links(self, world: Element) -> None:
        floating = bool(self.bodies) and self.bodies[0].kind == "free"
        places = {0: world}
        if not floating:
            # all links below one body: Pinocchio reads the first tree of a file
            base = child(world, "body", name=self.subject.base)
            if self.subject.base_inertia.mass > 0.0:
                self._inertial(base, self.subject.base, self.subject.base_inertia, moving=False)
            places[0] = base
            self._sites(base, self.subject.base_frames)
        for body in self.bodies:
            element = child(
                places[body.parent],
                "body",
                name=body.link,
                pos=body.placement.translation,
                quat=quaternion(body.placement.rotation),
            )
            places[body.index] = element
            if body.kind == "free":
                child(element, "freejoint", name=body.joint)
            elif body.kind == "ball":
                child(element, "joint", name=body.joint, type="ball")
            else:
                self._joint(element, body)
            self._inertial(element, body.link, body.inertia)
            payload = self.payloads.get(body.joint)
            if payload is not None:
                carried = child(element, "body", name=f"payload.{body.joint}", pos=payload.position)
                point = {"pos": (0, 0, 0), "mass": payload.mass, "diaginertia": (0, 0, 0)}
                child(carried, "inertial", **point)
            self._sites(element, body.frames)

    def _joint(self, element: Element, body: Body) -> None:
        joint = self.subject.joint(body.joint)
        number = self.subject.number
        armature, friction, bias = body.armature, number("link_coulomb_friction", body.joint, "level"), 0.0
        damping = number("link_viscous_friction", body.joint, "coefficient")
        if joint is not None and joint.rigid and self.shared.of(body.joint) is None:
            drive = self.subject.drive(body.joint)
            level, bias = self._rubbing(body.joint)
            armature, damping, friction = armature + drive.B, damping + drive.D_m, friction + level
        stiffness = number("cable_spring", body.joint, "stiffness")
        rest = number("cable_spring", body.joint, "rest")
        if bias != 0.0:
            stiffness = stiffness or PULL
            rest += bias / stiffness
        drag = number("quadratic_drag", body.joint, "coefficient")
        child(
            element,
            "joint",
            name=body.joint,
            type=body.kind,
            axis=body.axis,
            range=body.limits,
            armature=armature or None,
            damping=(damping, drag, 0.0) if drag else damping or None,
            stiffness=stiffness or None,
            springref=rest if stiffness else None,
            **self._dry(friction),
        )

    def _dry(self, level: float) -> dict[str, object]:
        """Dry friction that stops within a step and hardly creeps."""
        if level <= 0.0:
            return {}
        return {
            "frictionloss": level,
            "solreffriction": (2.0 * self.step, 1.0),
            "solimpfriction": STICK,
        }

    def _rubbing(self, joint: str) -> tuple[float, float]:
        """Level of a motor's dry friction, and the constant torque of one that differs between directions."""
        number = self.subject.number
        level = sum(number(name, joint, "level") for name in ("motor_coulomb_friction", "stribeck_friction"))
        forth = number("asymmetric_friction", joint, "level_positive")
        back = number("asymmetric_friction", joint, "level_negative")
        return level + 0.5 * (forth + back), 0.5 * (back - forth)

    def _inertial(self, element: Element, link: str, inertia: pin.Inertia, moving: bool = True) -> None:
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] *= np.linalg.det(axes)
        least = SPECK if moving else 0.0
        moments = np.maximum(moments, least)
        lacking = moments[2] - moments[0] - moments[1]
        if lacking > 0.0:  # MuJoCo refuses it; rounding alone is no news
            if lacking > 1e-9 * moments[2]:
                self.raised.append(link)
            moments[:2] += 0.5 * lacking * (1.0 + 1e-12)
        child(
            element,
            "inertial",
            pos=inertia.lever,
            quat=quaternion(axes),
            mass=max(inertia.mass, least),
            diaginertia=moments,
        )

    @staticmethod
    def _sites(element: Element, frames: tuple[tuple[str, pin.SE3], ...]) -> None:
        for name, place in frames:
            child(element, "site", name=name, pos=place.translation, quat=quaternion(place.rotation))

    def _rotor(self, world: Element, joint: str) -> None:
        subject, drive = self.subject, self.subject.drive(joint)
        level, bias = self._rubbing(joint)
        coupling = self.shared.of(joint)
        if coupling is not None:
            branch = self.branches.get(coupling.joints, world)
            self.branches[coupling.joints] = self._extra_hinge(branch, f"{ROTOR}{joint}")
        else:
            self._extra_hinge(
                world,
                f"{ROTOR}{joint}",
                armature=drive.B,
                damping=drive.D_m or None,
                stiffness=PULL if bias else None,
                springref=bias / PULL if bias else None,
                **self._dry(level),
            )
        self._spring(joint, drive)
        preload = subject.number("spring_preload", joint, "torque")
        if preload:  # tau_t > 0 pulls the rotor back
            self._constant(f"{PRELOAD}{joint}", {f"{ROTOR}{joint}": -1.0, joint: 1.0}, preload)
        creep = subject.find("spring_creep", joint)
        if creep is not None and creep.stiffness > 0.0:
            # Maxwell: a spring k and a damper k T in series; z is what stretches the spring
            damping = creep.stiffness * creep.time_constant
            self._extra_hinge(world, f"{CREEP}{joint}", armature=LIGHT * damping * self.step, damping=damping)
            self._tendon(
                f"{CREEP}{joint}",
                {f"{ROTOR}{joint}": 1.0, joint: -1.0, f"{CREEP}{joint}": -1.0},
                stiffness=creep.stiffness,
                springlength=0.0,
            )

    def _motor(self, joint: str) -> None:
        """The motor of a coupled joint: what it has acts along the joints that it turns."""
        drive, (level, bias) = self.subject.drive(joint), self._rubbing(joint)
        turns = {self._hinge(other): share for other, share in self.shared.turns(joint).items()}
        self._tendon(
            f"{MOTOR}{joint}", turns, armature=drive.B, damping=drive.D_m or None, **self._dry(level)
        )
        for name, torque in (
            (BIAS, bias),
            (OFFSET, self.subject.number("torque_offset", joint, "offset")),
        ):
            if torque:
                self._constant(f"{name}{joint}", turns, torque)

    def _shared_friction(self, joint: str) -> None:
        """Friction of shafts that turn with this joint and the one before it."""
        sharing = [e for e in self.subject.effects if e.joint == joint and e.effect.reaches_before]
        for one in (part for planned in sharing for part in planned.parts):
            before = self.robot.joint_names[self.robot.joint_names.index(joint) - 1]
            own, other = one.effect.shares(one.p)
            kind = SHARED if one in sharing else DIFFERENTIAL[one.p.speed]
            self._tendon(
                f"{kind}{joint}",
                {self._hinge(joint): float(own), self._hinge(before): float(other)},
                damping=one.p.coefficient or None,
                **self._dry(one.p.level),
            )

    def _constant(self, name: str, along: dict[str, float], torque: float) -> None:
        """A constant torque along a tendon: a soft spring that is stretched far."""
        sign = math.copysign(1.0, torque)
        shares = {joint: sign * share for joint, share in along.items()}
        self._tendon(name, shares, stiffness=PULL, springlength=abs(torque) / PULL)

    def _spring(self, joint: str, drive: Drive) -> None:
        play = self.subject.number("backlash", joint, "gap")
        cubic = self.subject.number("hardening_spring", joint, "cubic")
        linear: dict[str, object] = {
            "stiffness": (drive.K, 0.0, cubic) if cubic else drive.K,
            "damping": drive.D or None,
            "springlength": 0.0,
        }
        if play > 0.0:
            # a limit of impedance d has the force -(k r + b v + dv/dt) / R, R = (1 - d)/d A, with the inverse
            # inertia A at the file's pose (MuJoCo's documentation, Solver parameters): here K and D
            band, share = (-0.5 * play, 0.5 * play), (1.0 - SOFT) * self._inverse_inertia(joint)
            linear = {
                "range": band,
                "solreflimit": (-drive.K * share, -drive.D * share),
                "solimplimit": (SOFT, SOFT, 1e-3, 0.5, 2.0),
            }
            if cubic:
                linear.update(stiffness=(0.0, 0.0, cubic), springlength=band)
        self._tendon(f"{SPRING}{joint}", {f"{ROTOR}{joint}": 1.0, joint: -1.0}, **linear)

    def _inverse_inertia(self, joint: str) -> float:
        """Of theta - q, where all positions are 0 [1/(kg m^2)]."""
        place, model = self.robot.joint(joint).idx_v, self.subject.model
        rotor = mjcf_couplings.mobility(model, self.robot.joint_names.index(joint))
        return float(inverse_inertias(model)[place]) + rotor

    def _extra_hinge(self, world: Element, name: str, **attributes: object) -> Element:
        if self.robot.model.existJointName(name):
            raise RobotError(
                f"{self.robot.name}: joint {name} has the name of a hinge that the file needs; rename it"
            )
        body = child(world, "body", name=name)
        child(body, "joint", name=name, type="hinge", axis="0 0 1", **attributes)
        child(body, "inertial", pos="0 0 0", mass=SPECK, diaginertia=(SPECK,) * 3)
        return body

    def _tendon(self, name: str, joints: dict[str, float], **attributes: object) -> None:
        tendon = child(self.tendons, "fixed", name=name, **attributes)
        for joint, share in joints.items():
            child(tendon, "joint", joint=joint, coef=share)

    def _stop(self, joint: str) -> None:
        stop = self.subject.find("end_stop", joint)
        if stop is None or stop.stiffness <= 0.0:
            return
        band = (-FAR, stop.position) if stop.position >= 0.0 else (stop.position, FAR)
        self._tendon(f"{STOP}{joint}", {joint: 1.0}, stiffness=stop.stiffness, springlength=band)

    # --- actuators ------------------------------------------------------------------------------------------
    def _hinge(self, joint: str) -> str:
        return joint if self.robot.joint(joint).rigid else f"{ROTOR}{joint}"

    def _command(self, joint: str) -> None:
        number, limit = self.subject.number, self.robot.joint(joint).torque_limit
        gain, offset = _gain(self.robot, joint), number("torque_offset", joint, "offset")
        lag, delay = (
            number("current_lag", joint, "time_constant"),
            number("torque_delay", joint, "delay"),
        )
        most = min(
            number("torque_saturation", joint, "limit", math.inf),
            number("torque_speed_limit", joint, "stall", math.inf),
        )
        attributes: dict[str, object] = {
            "name": joint,
            **self._pulled(joint),
            "gainprm": gain if self.shared.of(joint) is None else 1.0,
            "ctrlrange": (-limit, limit) if limit < math.inf else None,
            "forcerange": (-most, most) if most < math.inf else None,
        }
        if offset and self.shared.of(joint) is None:
            attributes.update(biastype="affine", biasprm=(offset, 0.0, 0.0))
        if lag > 0.0:
            kind = "filter" if lag > SLOW * self.step else "filterexact"
            attributes.update(dyntype=kind, dynprm=lag)
        if delay > 0.0:
            # RK4 looks in between, linearly where commands are held: half a step later than these
            late = delay + 0.5 * self.step * (self.integrator == RK4)
            samples = math.ceil(late / self.step - 1e-9) + 1
            attributes.update(delay=late, nsample=str(samples), interp="linear")
        beside = {e.effect.name for e in self.subject.effects if e.joint == joint}
        line = self.subject.find("torque_speed_limit", joint)
        if line is None or not _limited_by_speed(beside, line):
            child(self.actuators, "general", **attributes)
            return
        # torque K/R (V - K w) with the voltage R/K tau + K w, limited: stall K V/R, drop K^2/R; here R is 1
        constant = math.sqrt(line.drop)
        del attributes["gainprm"], attributes["forcerange"]
        attributes.update(input="ff", motorconst=(constant, constant), resistance=1.0)
        attributes["controller"] = (0.0, 0.0, 0.0, 0.0, 0.0, line.stall / constant)
        child(self.actuators, "dcmotor", **attributes)

    def _pulled(self, joint: str) -> dict[str, object]:
        """What the actuator of a joint pulls: its hinge, or a tendon of it and the hinges of coupled ones."""
        if self.shared.of(joint) is not None:
            gains = {name: _gain(self.robot, name) for name in self.robot.joint_names}
            pulls = {self._hinge(name): share for name, share in self.shared.pulls(joint, gains).items()}
            return self._along(joint, pulls)
        shares = {}
        for planned in self.subject.effects:
            reaches = planned.effect.name == "joint_coupling"
            if reaches and neighbour(self.robot, planned) == joint and planned.joint is not None:
                own = _gain(self.robot, planned.joint) / _gain(self.robot, joint)
                shares[self._hinge(planned.joint)] = planned.p.share * own
        return self._along(joint, {self._hinge(joint): 1.0, **shares})

    def _along(self, joint: str, shares: dict[str, float]) -> dict[str, object]:
        if set(shares) == {self._hinge(joint)} and math.isclose(shares[self._hinge(joint)], 1.0):
            return {"joint": self._hinge(joint)}
        self._tendon(f"{DRIVE}{joint}", shares)
        return {"tendon": f"{DRIVE}{joint}"}

    def _shaft(self, joint: str) -> dict[str, str]:
        """What turns with the motor of a joint."""
        if self.shared.of(joint) is not None:
            return {"tendon": f"{MOTOR}{joint}"}
        return {"joint": self._hinge(joint)}

    def _passive(self, joint: str) -> None:
        """Motors without a command: the torques of their gears and bristles alone."""
        motor = {"input": "none", "motorconst": FAINT, "resistance": "1"}
        cogging = self.subject.find("cogging", joint)
        if cogging is not None and cogging.amplitude > 0.0:
            wave = (_gain(self.robot, joint) * cogging.amplitude, cogging.cycles, cogging.phase)
            child(
                self.actuators,
                "dcmotor",
                name=f"cogging.{joint}",
                **self._shaft(joint),
                **motor,
                cogging=wave,
            )
        for effect, where in (
            ("dahl_friction", self._shaft(joint)),
            ("spring_hysteresis", {"tendon": f"{SPRING}{joint}"}),
        ):
            loop = self.subject.find(effect, joint)
            if loop is None or loop.level <= 0.0:
                continue
            # LuGre's bristles without damping and with one level are Dahl's: z of the effect is sigma_0 z
            bristles = (loop.level / loop.scale, 0.0, loop.level, loop.level, 1.0)
            child(self.actuators, "dcmotor", name=f"{effect}.{joint}", **where, **motor, lugre=bristles)

    # --- sensors --------------------------------------------------------------------------------------------
    def _sensors(self, sensors: Element) -> None:
        if any(e.effect.name == "sensor_delay" for e in self.subject.effects):
            note(sensors, "delays as the effect sensor_delay has them")
        for joint in self.robot.joint_names:
            for tag, link, motor in (("jointpos", "q", "theta"), ("jointvel", "dq", "dtheta")):
                for channel, hinge in ((link, joint), (motor, self._hinge(joint))):
                    delay = sum(
                        e.effect.delay(e.p)
                        for e in self.subject.effects
                        if e.joint == joint
                        and e.effect.overrides("delay")
                        and channel in e.effect.channels(e.p)
                    )
                    late = {}
                    if delay > 0.0:
                        late = {
                            "delay": delay,
                            "nsample": str(math.ceil(delay / self.step - 1e-9) + 1),
                            "interp": "linear",
                        }
                    child(sensors, tag, name=f"{channel}.{joint}", joint=hinge, **late)


def _limited_by_speed(beside: set[str], line: Any) -> bool:
    """Whether a motor's limit that falls with speed is written as one: it stands alone, and falls."""
    others = {"torque_gain", "torque_offset", "torque_saturation", "current_lag"}
    return not beside & others and line.drop > 0.0 and line.stall > 0.0


def _gain(robot: Robot, joint: str) -> float:
    gains = [e.p.gain for e in robot.effects if e.key == ("torque_gain", joint) and e.since is None]
    return 1.0 + float(gains[0]) if gains else 1.0
