"""The worst case of a feedback over parameter boxes and over the models that a diagnosis gave."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flexjoint.core.errors import ModelError, unknown
from flexjoint.core.parameter import Parameter
from flexjoint.design.feedback import Gains, close_loop
from flexjoint.design.linearise import linearise
from flexjoint.design.margins import disk_margin, smallest_damping
from flexjoint.design.quasilinear import Nonsmooth
from flexjoint.effects import Planned, find
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.robot.robot import Robot

CORNERS = 6  # parameters up to which every corner of the box is tried; beyond, random ones
SAMPLES = 32


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
    box: Iterable[Parameter] = (),
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
        box: parameters of effects with the bounds between which they vary, named effect.joint.parameter, e.g.
            Parameter("spring_stiffness.joint1.scale", low=-0.2, high=0.2), or one of
            `flexjoint.model.parameters.model_parameters` `within` so many standard deviations; * in place of
            the joint is all joints alike. The box is laid about the model and about each of `models`: all
            corners for up to 6 parameters, and `samples` inside it.
        models: robots such as `diagnosis.extend(robot)` gives, or `load` of what `flexjoint diagnose --model`
            wrote.
        nonsmooth, amplitude: see `linearise`; needed where any of the models has effects with kinks.

    Raises:
        UnknownNameError: an effect, joint or parameter of the box.
        ModelError: bounds that are not low <= high or outside what the parameter allows; see `linearise`.
    """
    poses = np.atleast_2d(np.asarray(poses, dtype=float))
    box = list(box)
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
            planned[effect, own] = Planned.of(effect, own, given, nominal=bool(old and old.nominal))
    return robot.extended(planned.values())


def _split(name: str) -> tuple[str, str, str]:
    effect, _, rest = name.partition(".")
    joint, _, parameter = rest.rpartition(".")
    if not (effect and joint and parameter):
        raise ModelError(
            f"box: expected effect.joint.parameter (joint * for all, robot for none), got {name!r}"
        )
    return effect, joint, parameter


def _check(box: Iterable[Parameter]) -> None:
    for item in box:
        effect, _, parameter = _split(item.name)
        names = [p.name for p in find(effect).params if p.size == 1]
        if parameter not in names:
            raise unknown(f"parameter of {effect}", parameter, names)
        if not -math.inf < item.low <= item.high < math.inf:
            raise ModelError(
                f"box of {item.name}: expected finite bounds low <= high, got ({item.low:g}, {item.high:g})"
            )


def _points(box: Sequence[Parameter], samples: int, seed: int) -> Iterator[dict[str, float]]:
    """Corners and seeded random points of the box."""
    names = [item.name for item in box]
    if not names:
        yield {}
        return
    bounds = np.array([(item.low, item.high) for item in box], dtype=float)
    if len(names) <= CORNERS:
        for corner in product(*bounds):
            yield dict(zip(names, map(float, corner), strict=True))
    random = np.random.default_rng(seed)
    shares = random.random((samples, len(names)))
    if len(names) > CORNERS:  # extremes are at the rim
        shares = np.where(random.random(shares.shape) < 0.5, np.round(shares), shares)
    for share in shares:
        yield dict(zip(names, (bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])).tolist(), strict=True))
