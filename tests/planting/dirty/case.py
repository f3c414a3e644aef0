"""A dirty machine as a case: its numbers, its recordings, and the truth with the share of every effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from ..cases import Case, truth_of
from ..catalogue import Planted, law
from ..machine.chain import Array
from ..robots import Robot, read_robot, robot_file, within_tolerance
from ..shares import Torques
from ..simulate import Recorded, plant

LARGE = 0.1  # share from which a cause is large whatever else there is ...
ABOVE = 3.0  # ... or which is as many times what its joint's background makes, ...
ABOVE_LEAST = 0.05  # ... and not less than this
TRIAL = 6.0  # s


@dataclass(frozen=True)
class Dirty(Case):
    """A dirty machine and its recording; `effects` are the large causes of the catalogue."""

    kind: str = "causes"
    background: tuple[Planted, ...] = ()
    unknown: tuple[Planted, ...] = ()
    sensed: str = "all"  # of SENSORS
    robot_family: str = ""
    background_family: str = ""

    @property
    def everything(self) -> tuple[Planted, ...]:
        return (*self.effects, *self.unknown, *self.background)

    def real(self) -> Robot:
        """The machine with its own numbers."""
        rng = np.random.default_rng([self.seed, 7])
        return within_tolerance(read_robot(robot_file(self.robot)), tolerance(self.robot), rng)

    def trial(self) -> Recorded:
        """A recording of TRIAL seconds at most, by which effects are sized."""
        return self._plant(2 * self.seed, min(self.seconds, TRIAL), self.effects)

    def truth(self) -> dict[str, object]:
        """As of any case, with the background and what is unknown."""
        return {
            **super().truth(),
            "kind": self.kind,
            "background": [_small(p) for p in self.background],
            "unknown": [_small(p) for p in self.unknown],
            "off": self.off(),
            "robot_family": self.robot_family,
            "background_family": self.background_family,
        }

    def off(self) -> list[dict[str, object]]:
        """Relative errors of the nominal numbers that effects bear the names of."""
        nominal, real = read_robot(robot_file(self.robot)), self.real()
        pairs = {
            "motor_inertia": (nominal.motor_inertia, real.motor_inertia),
            "spring_stiffness": (nominal.stiffness, real.stiffness),
            "spring_damping": (nominal.damping, real.damping),
            "motor_viscous_friction": (nominal.motor_damping, real.motor_damping),
        }
        return [
            {"effect": effect, "joint": joint, "change": float(own - told), "scale": float(own / told - 1)}
            for effect, (was, is_) in pairs.items()
            for joint, told, own in zip(nominal.joints, was, is_, strict=True)
            if 0 < told < np.inf
        ]

    def measured(self, recorded: Recorded) -> dict[str, object]:
        """truth() with every effect's share of the torque of the joint where it is largest, whether a cause
        is `large`, and what background and wrong numbers make of each joint's torque."""
        effects = list(self.everything)
        torques = Torques(recorded.run.sensors.robot, recorded.real, recorded.run, effects)
        shares = [torques.share(k) for k in range(len(effects))]
        first = len(effects) - len(self.background)
        background = torques.together(range(first, len(effects)))
        told = self.truth()
        entries = [*told["truth"], *told["unknown"], *told["background"]]  # type: ignore[misc]
        for entry, share in zip(entries, shares, strict=True):
            j = int(np.argmax(share))
            entry["share"], entry["at"] = round(float(share[j]), 5), recorded.real.joints[j]
            entry["large"] = bool(is_large(share, background))
        joints = recorded.real.joints
        return {
            **told,
            "background_share": _by_joint(joints, background),
            "off_share": _by_joint(joints, torques.of_numbers()),
        }

    def _plant(self, seed: int, seconds: float, effects: tuple[Planted, ...]) -> Recorded:
        path = robot_file(self.robot)
        held = [*effects, *self.unknown, *self.background]
        return plant(path, held, self.excitation, seconds, seed, self.sensors, self.rate, real=self.real())


def is_large(share: Array, background: Array) -> bool:
    """Whether a cause of these shares (n,) stands out against a background of those."""
    clear = (share >= ABOVE * background) & (share >= ABOVE_LEAST)
    return bool((clear | (share >= LARGE)).any())


def _small(planted: Planted) -> dict[str, object]:
    return {**truth_of(planted), "family": law(planted.effect).family or "catalogue"}


def _by_joint(joints: Sequence[str], values: Array) -> dict[str, float]:
    return {joint: round(float(v), 5) for joint, v in zip(joints, values, strict=True)}


def tolerance(robot: str) -> dict[str, float]:
    """What a dirty robot's file states."""
    return dict(yaml.safe_load(robot_file(robot).read_text())["tolerance"])
