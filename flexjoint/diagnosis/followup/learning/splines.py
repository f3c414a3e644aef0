"""The penalised fit of a smooth law of one or two signals to what causes leave.

It is fitted to the whitened balances, and not to torques as they are recorded: there the noise is white, so
that least squares are right and standard errors mean something; what nominal numbers may explain within their
tolerances is taken out, so that a law does not repeat it; and the law passes the same filter and the same
rest of dry friction as any effect. Columns come from the effect's own law along the recording without its
sensors' noise (noise in a regressor would flatten the law).

Coefficients have a penalty on their second differences (P-splines, Eilers and Marx 1996): its weight decides
how many degrees of freedom are used, from a line to all. Generalised cross-validation and restricted
likelihood take errors for independent; what machines leave is not, and both would follow it. So blocks of
time are left out instead, and the weight is taken that foretells them best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.candidates import Candidate
from flexjoint.diagnosis.settings import LearnSettings
from flexjoint.effects import Parameter, Planned, Signals, Site

TRIAL = 1e-3  # of a joint's torque: laws are linear in their coefficients, a spring's law nearly so
# Of a law's range, at either end: what happens there alone (a stop) would make a spline over all of it swing
PARTS = tuple(part for k in (0.5, 0.25, 0.125) for part in ((0.0, k), (1.0 - k, 1.0)))
RIDGE = 1e-6  # of the mean curvature: coefficients that no sample shows stay finite
AT_AN_END = 3  # coefficients that make a law's value at an end, and its slope and curvature there
POINTS = 61  # of a law's curve
RANGES = (("start", "span"), ("other_start", "other_span"))  # names of the numbers of each signal's range
SECTIONS = (0.1, 0.5, 0.9)  # of the range of the other signal: where a law of two signals is drawn
WEIGHTS = np.logspace(-3.0, 5.0, 17)  # of the penalty, of curvature: from all degrees of freedom to two


@dataclass(frozen=True)
class Shape:
    """A law to be fitted: an effect on a joint with its signal and the signal's range, and, by recording, its
    whitened columns (coefficients, samples), one unit of each coefficient. `mean` (coefficients,) gives the
    law's mean over the recordings. Coefficients that are not `free` are none: so a law over a part of a range
    is none over the rest of it, where no error is."""

    law: Planned
    columns: tuple[np.ndarray, ...]
    mean: np.ndarray
    free: np.ndarray  # (coefficients,) bool

    def at(self, coefficients: np.ndarray, std: Sequence[float] = ()) -> Planned:
        """The law with these coefficients, inside their bounds."""
        size = coefficients_of(self.law)
        values = tuple(float(np.clip(c, size.low, size.high)) for c in coefficients)
        errors = {size.name: tuple(float(s) for s in std)} if len(std) else {}
        return replace(self.law.with_values({size.name: values}), std=errors)


@dataclass(frozen=True)
class Choice:
    """A shape with the weight of its penalty, and the squared error that it foretells, left out block by
    block, over that without it. `centred`: a mean that is not known is none."""

    shape: Shape
    weight: float
    foretold: float
    centred: bool = True


def coefficients_of(law: Planned) -> Parameter:
    """The parameter of a law that holds its coefficients."""
    (size,) = law.effect.nulls
    return size


def coefficients(law: Planned) -> tuple[float, ...]:
    """(k,) the coefficients of a law."""
    values: tuple[float, ...] = law.values[coefficients_of(law).name]
    return values


def followed(law: Planned) -> tuple[str, ...]:
    """The signals that a law follows, one or two."""
    return tuple(str(law.values[word.name]) for word in law.effect.words)


def signals_of(problem: Problem, law: Planned) -> np.ndarray:
    """(signals, N) what a law follows, on the usable samples of a recording."""
    return np.array([getattr(problem.signals(law.joint), name) for name in followed(law)])


def ranges_of(law: Planned) -> list[tuple[float, float]]:
    """Start and span of a law's range in each of its signals."""
    names = RANGES[: len(law.effect.words)]
    return [(float(law.values[start]), float(law.values[span])) for start, span in names]


def shape_of(
    problems: Sequence[Problem], candidate: Candidate, base: Sequence[Planned], limits: LearnSettings
) -> Shape | None:
    """The law over the range that its signal has in the recordings; None where that does not move."""
    law = candidate.planned({})
    signals = np.concatenate([signals_of(problem, law) for problem in problems], axis=1)
    span = next(p for p in law.effect.params if p.name == "span")
    for signal, names in zip(signals, RANGES, strict=False):
        low, high = np.quantile(signal, (limits.outside, 1.0 - limits.outside))
        if not span.low < high - low < span.high:
            return None
        law = law.with_values(dict(zip(names, (float(low), float(high - low)), strict=True)))
    return _shape(problems, law, base)


def part_of(
    problems: Sequence[Problem], shape: Shape, part: tuple[float, float], base: Sequence[Planned]
) -> Shape | None:
    """The same law of one signal over a part of its range, beyond which it is constant; None where that is no
    range."""
    law = shape.law
    start, span = (float(law.values[name]) for name in ("start", "span"))
    low, high = part
    if span * (high - low) <= next(p for p in law.effect.params if p.name == "span").low:
        return None
    law = law.with_values({"start": start + low * span, "span": (high - low) * span})
    one = _shape(problems, law, base)
    free = one.free.copy()
    free[: AT_AN_END if low > 0.0 else 0] = False
    free[free.size - (AT_AN_END if high < 1.0 else 0) :] = False
    return replace(one, free=free)


def _shape(problems: Sequence[Problem], law: Planned, base: Sequence[Planned]) -> Shape:
    signal = np.concatenate([signals_of(problem, law) for problem in problems], axis=1)
    columns = tuple(_columns(problem, law, base) for problem in problems)
    mean = np.mean(basis(law, signal), axis=0)
    return Shape(law, columns, mean, np.ones(mean.size, dtype=bool))


def _columns(problem: Problem, law: Planned, base: Sequence[Planned]) -> np.ndarray:
    assert law.joint is not None
    joint = problem.robot.joint(law.joint)
    size = coefficients_of(law)
    trial = TRIAL * float(problem.torque_scale[problem.robot.joint_names.index(joint.name)])
    if size.unit == "rad":
        trial = trial / joint.drive.K
    columns = []
    for k in range(size.size):
        unit = tuple(trial if i == k else 0.0 for i in range(size.size))
        moved = problem.denoised_moved_band(base, [*base, law.with_values({size.name: unit})])
        columns.append(problem.whitening.white(moved).ravel() / trial)
    return np.array(columns)


def basis(law: Planned, at: np.ndarray) -> np.ndarray:
    """(N, k) what a unit of each coefficient makes of the signals' values (signals, N), by the law itself."""
    size = coefficients_of(law)
    signals = Signals(**dict(zip(followed(law), at, strict=True)))
    columns = []
    for k in range(size.size):
        p = law.with_values({size.name: tuple(float(i == k) for i in range(size.size))}).p
        if law.effect.site is Site.DEFLECTION:
            columns.append(law.effect.map(signals, p, signals.phi) - signals.phi)
        else:
            columns.append(law.effect.torque(signals, p, 0.0))
    return np.stack([column * np.ones(at.shape[1]) for column in columns], axis=1)


def penalty(count: int) -> np.ndarray:
    """(count, count) squared second differences of coefficients."""
    second = np.diff(np.eye(count), 2, axis=0)
    return np.asarray(second.T @ second)


def penalty_of(law: Planned) -> np.ndarray:
    """(k, k) that of a law's coefficients; of two signals along each of them (Eilers and Marx 2003)."""
    count = coefficients_of(law).size
    if len(law.effect.words) == 1:
        return penalty(count)
    side = math.isqrt(count)
    one, all_ = penalty(side), np.eye(side)
    return np.asarray(np.kron(one, all_) + np.kron(all_, one))


def _penalty(shape: Shape) -> np.ndarray:
    """That of the coefficients that are free, the others being none."""
    return penalty_of(shape.law)[np.ix_(shape.free, shape.free)]


def chosen(
    problems: Sequence[Problem], shape: Shape, ys: Sequence[np.ndarray], folds: Sequence[np.ndarray]
) -> Choice:
    """The weight with which a shape, fitted to the residuals ys of all other parts of time, foretells those
    left out best. `folds` (N,) numbers, by recording, the part of each sample of time; what a problem does
    not use counts nowhere."""
    normals: list[np.ndarray] = []
    slopes: list[np.ndarray] = []
    nothing = 0.0
    for problem, given, y, own in zip(problems, shape.columns, ys, folds, strict=True):
        columns = problem.project(given[shape.free]) * problem.weights
        rest = problem.rest(y) * problem.weights
        every = np.tile(own, len(problem.balances.rows))
        used = problem.squares > 0.0
        parts = [used & (every == fold) for fold in np.unique(own[problem.used > 0.0])]
        normals += [columns[:, part] @ columns[:, part].T for part in parts]
        slopes += [columns[:, part] @ rest[part] for part in parts]
        nothing += float(rest @ rest)
    whole, slope = np.sum(normals, axis=0), np.sum(slopes, axis=0)
    bent = _penalty(shape)
    scaled = bent * np.trace(whole) / np.trace(bent)
    best, least = float(WEIGHTS[-1]), np.inf
    for weight in WEIGHTS:
        error = nothing
        for part, pull in zip(normals, slopes, strict=True):
            c = _solved(whole - part, slope - pull, weight * scaled)
            error += float(2.0 * c @ pull + c @ part @ c)
        if error < least:
            best, least = float(weight), error
    return Choice(shape, best, least / max(nothing, 1e-300))


def _solved(normal: np.ndarray, slope: np.ndarray, penalised: np.ndarray) -> np.ndarray:
    return -np.asarray(cho_solve(_factor(normal, penalised), slope))


def _factor(normal: np.ndarray, penalised: np.ndarray) -> tuple[np.ndarray, bool]:
    ridge = RIDGE * np.trace(normal) / len(normal) + np.finfo(float).tiny
    factor: tuple[np.ndarray, bool] = cho_factor(normal + penalised + ridge * np.eye(len(normal)))
    return factor


@dataclass(frozen=True)
class Fitted:
    """A fitted law, with the covariance (k, k) of its coefficients, the smoothing's own error included, and
    the degrees of freedom that the penalty leaves."""

    law: Planned
    covariance: np.ndarray
    freedom: float

    def curve(self, points: int, other: float = 0.5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(points,) of the signal over the law's range, of the law, and of its standard errors; of a law of
        two signals where the other one is at this share of its range."""
        (start, span), *others = ranges_of(self.law)
        at = np.linspace(start, start + span, points)
        along = [np.full(points, low + other * width) for low, width in others]
        columns = basis(self.law, np.array([at, *along]))
        value = columns @ np.array(self.law.values[coefficients_of(self.law).name])
        variance = np.einsum("ij,jk,ik->i", columns, self.covariance, columns)
        return at, value, np.sqrt(np.maximum(variance, 0.0))

    @property
    def certainty(self) -> float:
        """Distance of the law from none, in its standard errors where it is furthest."""
        shares = SECTIONS if len(self.law.effect.words) > 1 else SECTIONS[1:2]
        curves = [self.curve(POINTS, share) for share in shares]
        return max(float(np.max(np.abs(c) / np.maximum(std, 1e-300))) for _, c, std in curves)


def fitted(problems: Sequence[Problem], choice: Choice, ys: Sequence[np.ndarray]) -> Fitted:
    """The coefficients from the samples that the problems use.

    The covariance is that of the posterior (Wahba 1983; Wood 2006), widened where scores of blocks of time
    say that what is left is not white (`fit.covariance` does the same). A mean that is not known, since
    unknown zeros of sensors and torques may stand for it, is no part of a centred law, whose mean is zero."""
    shape, limits = choice.shape, problems[0].settings.learn
    own = [columns[shape.free] for columns in shape.columns]
    pairs = [p.normal(columns, y) for p, columns, y in zip(problems, own, ys, strict=True)]
    normal, slope = np.sum([n for n, _ in pairs], axis=0), np.sum([s for _, s in pairs], axis=0)
    bent = _penalty(shape)
    penalised = bent * choice.weight * np.trace(normal) / np.trace(bent)
    factor = _factor(normal, penalised)
    c = -cho_solve(factor, slope)
    bread = cho_solve(factor, np.eye(len(c)))
    freedom = float(np.trace(bread @ normal))
    scores = np.concatenate(
        [_scores(p, columns, y, c) for p, columns, y in zip(problems, own, ys, strict=True)], axis=1
    )
    count = scores.shape[1]
    robust = bread @ scores @ scores.T @ bread * count / max(1.0, count - freedom)
    wider = np.sqrt(np.maximum(1.0, np.diag(robust) / np.maximum(np.diag(bread), 1e-300)))
    places = np.eye(shape.free.size)[:, shape.free]
    c, covariance = places @ c, places @ (bread * np.outer(wider, wider)) @ places.T
    unknown = abs(shape.mean @ c) < limits.sure * np.sqrt(shape.mean @ covariance @ shape.mean)
    if choice.centred and unknown and np.all(shape.free):
        about = np.eye(len(c)) - np.outer(np.ones(len(c)), shape.mean)  # equal coefficients: a constant
        c, covariance = about @ c, about @ covariance @ about.T
    return Fitted(shape.at(c, np.sqrt(np.diag(covariance)).tolist()), covariance, freedom)


def _scores(problem: Problem, columns: np.ndarray, y: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(coefficients, blocks) slopes of what is left, by block of time."""
    blocks = ((problem.time - problem.time[0]) / problem.settings.regression.time_block).astype(int)
    blocks = np.tile(blocks, len(problem.balances.rows))
    residual = problem.rest(y + c @ columns) * problem.weights
    projected = problem.project(columns) * problem.weights
    return np.stack([np.bincount(blocks, row * residual) for row in projected])
