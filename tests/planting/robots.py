"""The nominal robots of this generator, and the real ones that deviate from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from .dirty.robots import base_of, dirty_robot
from .drawn import drawn_robot
from .machine.chain import Array, Body, read_bodies

ROBOTS = Path(__file__).parent / "robots"

DEFAULT_GRAVITY = (0.0, 0.0, -9.81)


def robot_file(name: str) -> Path:
    """YAML file of a robot of ROBOTS, of one that is drawn, or of one that is dirty."""
    if name.startswith("dirty_"):
        return dirty_robot(name, robot_file(base_of(name)))
    return drawn_robot(name) if name.startswith("drawn_") else ROBOTS / f"{name}.yaml"


@dataclass(frozen=True)
class Robot:
    """Numbers of one machine, link-referred SI; joint arrays have shape (n,), in the order of `joints`."""

    name: str
    joints: tuple[str, ...]
    bodies: tuple[Body, ...]
    gravity: Array  # (3,) in the base frame [m/s^2]
    control_rate: float  # [Hz]
    stiffness: Array
    damping: Array
    motor_inertia: Array
    motor_damping: Array
    torque_limit: Array
    kp: Array
    kd: Array

    def index(self, joint: str | None) -> int:
        if joint not in self.joints:
            raise ValueError(f"{self.name} has no joint {joint!r}; it has {', '.join(self.joints)}")
        return self.joints.index(joint)


def read_robot(path: Path) -> Robot:
    """Read a fixed-base robot YAML in which every moving joint is actuated; raises ValueError otherwise."""
    data = yaml.safe_load(path.read_text())
    if data.get("base", "fixed") != "fixed":
        raise ValueError(f"{path.name}: only a fixed base can be planted")
    bodies = read_bodies(path.parent / data["urdf"], tuple(data.get("lock", ())))
    names = tuple(body.joint for body in bodies)
    if set(names) != set(data["joints"]):
        raise ValueError(
            f"{path.name}: its moving joints are {names}, its YAML lists {tuple(data['joints'])}"
        )

    def numbers(key: str, default: float | None = None) -> Array:
        return np.array(
            [
                float(data["joints"][n][key] if default is None else data["joints"][n].get(key, default))
                for n in names
            ]
        )

    return Robot(
        name=data["name"],
        joints=names,
        bodies=tuple(bodies),
        gravity=np.array(data.get("gravity", DEFAULT_GRAVITY), dtype=float),
        control_rate=float(data.get("rates", {}).get("control", 1000)),
        stiffness=numbers("stiffness"),
        damping=numbers("damping", 0.0),
        motor_inertia=numbers("motor_inertia"),
        motor_damping=numbers("motor_damping", 0.0),
        torque_limit=numbers("torque_limit", np.inf),
        kp=numbers("kp"),
        kd=numbers("kd"),
    )


def deviating(robot: Robot, inexact: float, rng: np.random.Generator) -> Robot:
    """The real machine behind a nominal one.

    Each mass, centre-of-mass coordinate, inertia tensor, K and B is off by a relative error uniform in
    +-[inexact / 2, 1.5 inexact]; D and D_m by three times that. A tensor is scaled as a whole: independent
    errors of its entries could make it impossible for any body.
    """

    def factor(shape: int | tuple[int, ...], weight: float = 1.0) -> Array:
        size = rng.uniform(inexact / 2, 1.5 * inexact, shape)
        return 1 + weight * size * rng.choice([-1.0, 1.0], shape)

    n = len(robot.joints)
    bodies = []
    for body in robot.bodies:
        mass, tensor = factor(2)
        bodies.append(
            replace(body, mass=body.mass * mass, com=body.com * factor(3), inertia=body.inertia * tensor)
        )
    return replace(
        robot,
        bodies=tuple(bodies),
        stiffness=robot.stiffness * factor(n),
        motor_inertia=robot.motor_inertia * factor(n),
        damping=robot.damping * factor(n, 3.0),
        motor_damping=robot.motor_damping * factor(n, 3.0),
    )


MOST = 2.0  # standard deviations that a number of a machine within its tolerances is off, at most


def within_tolerance(robot: Robot, tolerance: dict[str, float], rng: np.random.Generator) -> Robot:
    """A real machine whose numbers are off as its file says they may be.

    `tolerance` are relative standard deviations: `inertial` of masses, coordinates of centres of mass,
    inertia tensors and motor inertias, `stiffness` of K, `damping` of D and D_m. Errors are normal, cut at
    MOST, so that nothing changes sign.
    """

    def factor(kind: str, *shape: int) -> Array:
        return np.maximum(1 + tolerance[kind] * np.clip(rng.normal(size=shape), -MOST, MOST), 0.05)

    n = len(robot.joints)
    bodies = []
    for body in robot.bodies:
        mass, tensor = factor("inertial", 2)
        com = body.com * factor("inertial", 3)
        bodies.append(replace(body, mass=body.mass * mass, com=com, inertia=body.inertia * tensor))
    return replace(
        robot,
        bodies=tuple(bodies),
        stiffness=robot.stiffness * factor("stiffness", n),
        motor_inertia=robot.motor_inertia * factor("inertial", n),
        damping=robot.damping * factor("damping", n),
        motor_damping=robot.motor_damping * factor("damping", n),
    )
