"""Nominal robots drawn at random, a robot a number: what no list of robots thinks of.

One to four joints, or as many as the name says (drawn_12_of6 has six); links of 8 cm to 1.5 m, springs that
swing at 3 to 30 Hz, motors of a tenth to 2.5 times their load, controllers from lazy to stiff.
"""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

TOLERANCES = {
    "": "",  # what is usual
    "_exact": "tolerance: {inertial: 0.001, stiffness: 0.001, damping: 0.002, torque: 0.001}\n",
    "_loose": "tolerance: {inertial: 0.05, stiffness: 0.05, damping: 0.15, torque: 0.01}\n",
}
NAME = re.compile(r"drawn_(\d+)(?:_of([1-7]))?(|_exact|_loose)")

GRAVITY = 9.81
ACROSS, ALONG, UP = (0, 1, 0), (1, 0, 0), (0, 0, 1)  # axes; links lie along x
THICKNESS = 0.15  # radius of a link over its length
SAMPLED = 200.0  # rad/s, which a position loop sampled at 1 kHz stays below


@dataclass(frozen=True)
class Link:
    length: float
    mass: float
    com: tuple[float, float, float]
    axis: tuple[int, int, int]
    tilt: tuple[float, float]  # roll and pitch of the joint's frame [rad]

    @property
    def inertia(self) -> tuple[float, float]:
        """About the link's own axis and across it: a cylinder's."""
        radius = THICKNESS * self.length
        return self.mass * radius**2 / 2, self.mass * (3 * radius**2 + self.length**2) / 12


def drawn_robot(name: str) -> Path:
    """YAML file of robot `drawn_<number>`, with `_exact` or `_loose` for other tolerances, its URDF beside
    it; raises ValueError for other names."""
    match = NAME.fullmatch(name)
    if match is None:
        raise ValueError(
            f"{name!r} is no robot that is drawn; such are drawn_12, drawn_12_exact, drawn_12_loose"
        )
    number, joints, tolerance = match.groups()
    path = _folder() / f"{name}.yaml"
    if not path.exists():
        rng = np.random.default_rng([2026, int(number)])
        links = _links(rng, None if joints is None else int(joints))
        path.with_suffix(".urdf").write_text(_urdf(name, links))
        path.write_text(
            f"name: {name}\nurdf: {name}.urdf\nbase: fixed\n{TOLERANCES[tolerance]}"
            f"rates: {{physics: 1000, control: 1000}}\njoints:\n{_joints(links, rng)}"
        )
    return path


@cache
def _folder() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="drawn_robots_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def in_logarithm(rng: np.random.Generator, low: float, high: float) -> float:
    """A number drawn evenly in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _links(rng: np.random.Generator, wanted: int | None) -> list[Link]:
    count = int(rng.integers(1, 5))
    count = wanted or count
    length = in_logarithm(rng, 0.08, 1.5)
    mass = in_logarithm(rng, 0.1, 6.0) * (length / 0.4) ** 2.2
    links = []
    for k in range(count):
        own = length * 0.85**k * rng.uniform(0.6, 1.2)
        com = own * np.array([rng.uniform(0.35, 0.6), *rng.uniform(-0.05, 0.05, 2)])
        axes = [ACROSS, UP, ALONG] if k else [ACROSS, UP] if count > 1 else [ACROSS]
        weights = np.array([0.7, 0.2, 0.1])[: len(axes)]
        axis = axes[int(rng.choice(len(axes), p=weights / weights.sum()))]
        roll, pitch = rng.uniform(-0.4, 0.4, 2)
        links.append(
            Link(own, mass * 0.6**k * rng.uniform(0.6, 1.4), (com[0], com[1], com[2]), axis, (roll, pitch))
        )
    return links


def _urdf(name: str, links: list[Link]) -> str:
    parts = [f'<?xml version="1.0"?><robot name="{name}"><link name="base"/>']
    for k, link in enumerate(links):
        along, across = link.inertia
        com, axis = (" ".join(f"{c:.5g}" for c in v) for v in (link.com, link.axis))
        place = f"{links[k - 1].length:.5g} 0 0" if k else "0 0 0"
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="{com}"/><mass value="{link.mass:.5g}"/>'
            f'<inertia ixx="{along:.5g}" iyy="{across:.5g}" izz="{across:.5g}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="joint_{k}" type="revolute">'
            f'<parent link="{f"link_{k - 1}" if k else "base"}"/><child link="link_{k}"/>'
            f'<origin xyz="{place}" rpy="{link.tilt[0]:.3f} {link.tilt[1]:.3f} 0"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="1000" velocity="20"/></joint>'
        )
    return "\n".join(parts) + "\n</robot>\n"


def _joints(links: list[Link], rng: np.random.Generator) -> str:
    lines = []
    for k, link in enumerate(links):
        inertia, weight = _load(links[k:])
        if link.axis == ALONG:
            inertia *= 0.6 if k < len(links) - 1 else 0.0
            inertia, weight = max(inertia, 1.2 * link.inertia[0]), 0.3 * weight
        stiffness = inertia * (2 * np.pi * in_logarithm(rng, 3.0, 30.0)) ** 2
        motor = inertia * in_logarithm(rng, 0.1, 2.5)
        kp = min(stiffness * rng.uniform(0.6, 3.0), motor * SAMPLED**2)
        numbers = {
            "stiffness": stiffness,
            "damping": 2 * in_logarithm(rng, 0.01, 0.08) * np.sqrt(stiffness * inertia),
            "motor_inertia": motor,
            "motor_damping": 2 * (inertia + motor) * in_logarithm(rng, 0.3, 4.0),
            "torque_limit": (weight + (inertia + motor) * rng.uniform(8, 30)) * rng.uniform(1.2, 2.0),
            "kp": kp,
            "kd": 2 * rng.uniform(0.3, 0.7) * np.sqrt(kp * motor),
        }
        told = ", ".join(f"{key}: {value:.4g}" for key, value in numbers.items())
        lines.append(f"  joint_{k}: {{{told}}}\n")
    return "".join(lines)


def _load(links: list[Link]) -> tuple[float, float]:
    """Inertia [kg m^2] and weight [N m] of a stretched chain about its first joint, across it."""
    inertia = weight = start = 0.0
    for link in links:
        reach = start + link.com[0]
        inertia += link.mass * (reach**2 + link.length**2 / 12)
        weight += link.mass * GRAVITY * reach
        start += link.length
    return inertia, weight
