"""The worst case of a feedback over parameter boxes and over the models that a diagnosis gave."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flexjoint.effect import find, plan
from flexjoint.errors import ModelError, unknown
from flexjoint.feedback import Gains, close_loop
from flexjoint.linearise import linearise
from flexjoint.margins import disk_margin, smallest_damping
from flexjoint.model import FlexibleJointModel
from flexjoint.quasilinear import Nonsmooth
from flexjoint.robot import Robot

CORNERS = 6  # parameters up to which every corner of the box is tried; beyond, random ones
SAMPLES = 32
Box = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Case:
    """One model of those tried: which robot, the parameters set on it, the row of its pose, and how its loop
    does."""

    robot: str
    parameters: Mapping[str, float]
    pose: int
    disk: float
    damping: float

    @property
    def stable(self) -> bool:
        return self.disk > 0.0


@dataclass(frozen=True)
class WorstCase:
    """`worst` has the smallest disk margin (0: unstable; then the smallest damping decides). `cases` are all
    that were
    tried: the worst found, not a proof about what lies between."""

    worst: Case
    cases: tuple[Case, ...]

    @property
    def stable(self) -> bool:
        return self.worst.stable


def worst_case(
    model: FlexibleJointModel,
    gains: Gains,
    poses: np.ndarray,
    *,
    box: Box | None = None,
    models: Sequence[Robot] = (),
    delay: float = 0.0,
    samples: int = SAMPLES,
    seed: int = 0,
    nonsmooth: Nonsmooth | None = None,
    amplitude: Mapping[str, float] | None = None,
) -> WorstCase:
    """Try the feedback, sampled at the robot's control rate, on the model, on `models`, and over a box of
    parameters.

    Args:
        poses: (N, nq), at rest.
        box: bounds by effect.joint.parameter, as `SymbolicModel.parameters` names them, e.g.
            {"spring_stiffness.joint1.scale": (-0.2, 0.2)}; * in place of the joint is all joints alike. The
            box is laid about the model and about each of `models`: all corners for up to 6 parameters, and
            `samples` inside it.
        models: robots such as `diagnose.extended_model` gives, or `load` of what `flexjoint diagnose --out`
            wrote.
        nonsmooth, amplitude: see `linearise`; needed where any of the models has effects with kinks.

    Raises:
        UnknownNameError: an effect, joint or parameter of the box.
        ModelError: bounds that are not low <= high or outside what the parameter allows; see `linearise`.
    """
    poses = np.atleast_2d(np.asarray(poses, dtype=float))
    box = dict(box or {})
    _check(box)
    cases = []
    candidates = [
        ("nominal", model.robot.extended(model.effects)),
        *((f"model {k + 1}", r) for k, r in enumerate(models)),
    ]
    for name, robot in candidates:
        for point in _points(box, samples, seed):
            varied = FlexibleJointModel(with_parameters(robot, point))
            for k, q in enumerate(poses):
                linear = linearise(varied, q, nonsmooth=nonsmooth, amplitude=amplitude)
                sampled = linear.sampled(robot.rates.control, delay)
                closed = close_loop(sampled, gains)
                cases.append(Case(name, point, k, disk_margin(sampled, gains), smallest_damping(closed)))
    return WorstCase(min(cases, key=lambda case: (case.disk, case.damping)), tuple(cases))


def with_parameters(robot: Robot, values: Mapping[str, float]) -> Robot:
    """The robot with parameters of effects set, by effect.joint.parameter; an effect that it lacks is
    added."""
    planned = {item.key: item for item in robot.effects}
    for name, value in values.items():
        effect, joint, parameter = _split(name)
        for place in robot.joint_names if joint == "*" else (joint,):
            own = None if place == "robot" else place
            old = planned.get((effect, own))
            given = {**(old.values if old else {}), parameter: value}
            planned[effect, own] = plan(effect, own, given, nominal=bool(old and old.nominal))
    return robot.extended(planned.values())


def _split(name: str) -> tuple[str, str, str]:
    effect, _, rest = name.partition(".")
    joint, _, parameter = rest.rpartition(".")
    if not (effect and joint and parameter):
        raise ModelError(
            f"box: expected effect.joint.parameter (joint * for all, robot for none), got {name!r}"
        )
    return effect, joint, parameter


def _check(box: Box) -> None:
    for name, (low, high) in box.items():
        effect, _, parameter = _split(name)
        names = [p.name for p in find(effect).params if p.size == 1]
        if parameter not in names:
            raise unknown(f"parameter of {effect}", parameter, names)
        if not low <= high:
            raise ModelError(f"box of {name}: expected low <= high, got ({low:g}, {high:g})")


def _points(box: Box, samples: int, seed: int) -> Iterator[dict[str, float]]:
    """Corners and seeded random points of the box."""
    names = list(box)
    if not names:
        yield {}
        return
    bounds = np.array([box[name] for name in names], dtype=float)
    if len(names) <= CORNERS:
        for corner in product(*bounds):
            yield dict(zip(names, map(float, corner), strict=True))
    random = np.random.default_rng(seed)
    shares = random.random((samples, len(names)))
    if len(names) > CORNERS:  # extremes are at the rim
        shares = np.where(random.random(shares.shape) < 0.5, np.round(shares), shares)
    for share in shares:
        yield dict(zip(names, (bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])).tolist(), strict=True))
