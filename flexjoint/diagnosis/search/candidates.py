"""Every effect on every joint it can sit on, and the first-order trace that each would leave."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, SPRING, acts_within_a_joint
from flexjoint.diagnosis.regression.fit import load_params
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.whitening import Band, Whitening
from flexjoint.diagnosis.search.ripples import ripples
from flexjoint.diagnosis.settings import SearchSettings
from flexjoint.diagnosis.signals.reading_jumps import reading_jumps
from flexjoint.effects import Effect, Parameter, Planned, Site, catalogue

UNSEEN = 1e-12  # of the largest curvature: below it is rounding
FARTHEST = 2.0  # weak prior deviations from the joint, of the places of a load that a search starts from
PLACES = 11  # along each axis


@dataclass(frozen=True)
class Candidate:
    """An effect on a joint (None: the robot), with its words chosen."""

    effect: Effect
    joint: str | None
    words: tuple[tuple[str, str | None], ...] = ()

    @property
    def key(self) -> tuple[str, str | None]:
        return self.effect.name, self.joint

    def planned(self, values: Mapping[str, Any], since: float | None = None) -> Planned:
        full = {p.name: p.value if p.size == 1 else (p.value,) * p.size for p in self.effect.params}
        return Planned(self.effect, self.joint, {**full, **dict(self.words), **values}, since)


@dataclass(frozen=True)
class Trace:
    """A candidate at one start: its columns before they are whitened, and how their amplitudes become
    parameter values."""

    candidate: Candidate
    start: Mapping[str, Any]
    bands: tuple[Band, ...]
    whitening: Whitening
    kind: str  # amplitudes | whole | phase
    trial: Mapping[str, float]
    origin: Mapping[str, float]  # values at amplitude 0: null, or what the nominal model lists
    since: float | None = None  # onset [s] that the columns have; None: they act all the time

    @cached_property
    def columns(self) -> np.ndarray:
        """(k, samples) whitened."""
        return np.array([self.whitening.white(band).ravel() for band in self.bands])

    def values(self, amplitude: np.ndarray) -> dict[str, Any]:
        """Parameter values for fitted amplitudes of the columns, clipped into the bounds."""
        effect = self.candidate.effect
        out: dict[str, Any] = dict(self.start)
        if self.kind == "whole":
            # the start values of a limit are kept as they are, not scaled
            scale = 1.0 if _is_limit(effect) else float(np.clip(amplitude[0], 0.1, 10.0))
            for name, size in self.trial.items():
                out[name] = self.origin[name] + scale * (size - self.origin[name])
        elif self.kind == "phase":
            size, angle = np.hypot(*amplitude), np.arctan2(amplitude[1], amplitude[0])
            for param in effect.params:
                if param.wraps:
                    out[param.name] = float(angle)
                elif param.name in self.trial:
                    out[param.name] = float(size) * self.trial[param.name]
        else:
            for name, size in zip(self.trial, amplitude, strict=True):
                out[name] = self.origin[name] + float(size) * self.trial[name]
        return {p.name: _clip(p, out[p.name]) for p in effect.params if p.name in out}


def _clip(param: Parameter, value: Any) -> Any:
    if param.size > 1:
        return tuple(float(np.clip(v, param.low, param.high)) for v in value)
    return float(np.clip(value, param.low, param.high))


def enumerate_candidates(problem: Problem, excluded: frozenset[str] = frozenset()) -> list[Candidate]:
    """All candidates that the sensors of this recording could show; `excluded` effects are left out."""
    out = []
    for effect in catalogue().values():
        if effect.name in excluded or not effect.is_cause:
            continue
        choices = [[(w.name, c) for c in w.choices] for w in effect.words]
        joints: Sequence[str | None] = [None] if effect.whole_robot else problem.robot.joint_names
        for joint in joints:
            for words in itertools.product(*choices):
                candidate = Candidate(effect, joint, tuple(words))
                if visible(problem, candidate):
                    out.append(candidate)
    return out


def visible(problem: Problem, candidate: Candidate) -> bool:
    """Whether the effect acts on something that this recording balances or measures."""
    effect, joint = candidate.effect, candidate.joint
    if joint is None:
        return True
    i = problem.robot.joint_names.index(joint)
    rigid = problem.robot.joints[i].rigid
    if not effect.possible(problem.robot.joints[i].drive):
        return False
    if effect.reaches_before and (i == 0 or problem.robot.joints[i - 1].rigid != rigid):
        return False
    rows = {row.balance for row in problem.balances.rows if row.joint == i}
    if effect.site is Site.SENSOR:
        return _sensed(problem, candidate, i, rows)
    met = not problem.readings.commanded[i] and _is_limit(effect)  # a measured torque is limited already
    shown = {
        Site.COMMAND: MOTOR in rows and not met,
        Site.MOTOR: MOTOR in rows,
        Site.DEFLECTION: not rigid,
        Site.SPRING: not rigid,
        Site.LINK: LINK in rows or (rigid and MOTOR in rows),
        Site.BODY: LINK in rows or (rigid and MOTOR in rows),
    }
    if effect.for_rigid and not _bends(problem, i):
        return False
    return shown[effect.site] and not (rigid and (effect.needs_spring or effect.on_rigid))


def _bends(problem: Problem, i: int) -> bool:
    """Whether a recording can show that a joint taken as rigid bends: it has an encoder at the motor, and
    turns by itself."""
    joint, coupled = problem.robot.joints[i], {k for c in problem.robot.couplings for k in c.joints}
    return joint.rigid and problem.readings.encoder(joint.name) == "theta" and i not in coupled


def _is_limit(effect: Effect) -> bool:
    """Whether an effect is a limit: absent where that is far beyond its usual size."""
    return any(p.null is not None and p.null > p.value for p in effect.nulls)


def _sensed(problem: Problem, candidate: Candidate, i: int, rows: set[str]) -> bool:
    readings = {
        "q": bool(np.isfinite(problem.readings.q[i, 0])),
        "theta": bool(np.isfinite(problem.readings.theta[i, 0])),
        "tau_t": SPRING in rows,
    }
    joint = problem.robot.joints[i]
    if joint.rigid:
        readings["q"] = readings["theta"] = False
        readings[problem.readings.encoder(joint.name)] = True
    if not _moves(problem, i) and (
        candidate.effect.overrides("delay") or any(p.wraps for p in candidate.effect.params)
    ):
        return False
    concerned = [c for c in candidate.effect.channels(candidate.planned({}).p) if c in readings]
    if candidate.words and len(concerned) > 1:  # "all of the joint" needs more than one sensor to differ
        return sum(readings[c] for c in concerned) > 1
    return any(readings[c] for c in concerned)


def may_replace(candidate: Candidate, e: Planned, joints: Sequence[str]) -> bool:
    """Whether a candidate can take the place of an effect of a robot with these joints. An effect that acts
    within a joint changes the balances of that joint alone: only candidates of that joint, of the robot, of a
    body, or of a shaft that this joint and the next share can explain that."""
    if not acts_within_a_joint(e) or candidate.joint in (e.joint, None):
        return True
    next_one = candidate.effect.reaches_before and joints.index(str(candidate.joint)) == (
        joints.index(str(e.joint)) + 1
    )
    return candidate.effect.site is Site.BODY or next_one


def _moves(problem: Problem, i: int) -> bool:
    """Whether a joint's position changes by more than its sensors' noise."""
    used, noise = problem.readings.valid, problem.readings.noise
    return any(
        float(np.ptp(signal[i][used])) > problem.settings.balances.still * max(float(noise[name][i]), 1e-9)
        for name, signal in (("q", problem.motion.q), ("theta", problem.motion.theta))
    )


def traces(problem: Problem, candidate: Candidate, base: Sequence[Planned], y: np.ndarray) -> Iterator[Trace]:
    """First-order traces of a candidate on top of `base`, whose whitened residual is y, one per start."""
    effect = candidate.effect
    if effect.site is Site.BODY and effect.overrides("edit_inertial"):
        yield from load_traces(problem, candidate, y)
        return
    listed = next((e for e in base if e.key == candidate.key), None)
    phase = [p.name for p in effect.params if p.wraps]
    starts: Sequence[Mapping[str, Any]] = problem.starts(effect, candidate.joint)
    if effect.repeats and candidate.joint is not None:
        signal = str(dict(candidate.words).get("channel", effect.against))
        number = next(p for p in effect.params if p.name == effect.repeats)
        unit = 2.0 * np.pi if signal == "t" else 1.0  # Hz of a rhythm
        cycles = ripples(problem, candidate.joint, signal, base)
        starts = [*starts, *({number.name: _clip(number, n / unit)} for n in cycles)]
    if listed is not None:
        starts = [{p.name: listed.values[p.name] for p in effect.params if p.null is None}]
    seen: set[tuple[tuple[str, Any], ...]] = set()
    for start in starts:
        kept = {k: v for k, v in start.items() if k not in phase}
        key = tuple(sorted(kept.items()))
        if key not in seen:
            seen.add(key)
            yield _trace(problem, candidate, base, kept, phase, listed)
    for since in jump_times(problem, effect, candidate.joint):
        yield _trace(problem, candidate, base, {}, phase, listed, since)


def jump_times(problem: Problem, effect: Effect, joint: str | None) -> Iterator[float]:
    """The times [s] at which an effect on a joint may have set in, as its channel's reading jumps. Such a
    jump is seen in the accelerations for a moment only, which no onset elsewhere shows."""
    if not effect.jumps or joint is None:
        return
    i, t = problem.robot.joint_names.index(joint), problem.balances.chains.t
    for channel in effect.channels(Candidate(effect, joint).planned({}).p):
        for k in reading_jumps(getattr(problem.readings, channel)[i], problem.settings.signals):
            yield float(0.5 * (t[k] + t[k + 1]))


def _trace(
    problem: Problem,
    candidate: Candidate,
    base: Sequence[Planned],
    start: dict[str, Any],
    phase: list[str],
    listed: Planned | None,
    since: float | None = None,
) -> Trace:
    effect = candidate.effect
    given = [p.name for p in effect.nulls if p.name in start]
    without = [e for e in base if e.key != candidate.key]
    origin: dict[str, float] = {
        p.name: float(p.null or 0.0) if listed is None else float(listed.values[p.name]) for p in effect.nulls
    }

    # noise that is shifted against itself would look like a trace of a delay: it is left out
    moved = problem.denoised_moved_band if effect.overrides("delay") else problem.slightly_moved_band

    def column(values: Mapping[str, Any]) -> Band:
        return moved(base, [*without, candidate.planned(values, since)])

    white = problem.whitening

    if given:
        trial = {name: start[name] for name in given}
        return Trace(candidate, start, (column(start),), white, "whole", trial, origin, since)
    trial = {p.name: trial_size(problem, candidate, p) for p in effect.nulls if p.name not in phase}
    if phase:
        bands = tuple(column({**start, **trial, phase[0]: a}) for a in (0.0, 0.5 * np.pi))
        return Trace(candidate, start, bands, white, "phase", trial, origin, since)
    bands = tuple(column({**start, **origin, name: origin[name] + trial[name]}) for name in trial)
    return Trace(candidate, start, bands, white, "amplitudes", trial, origin, since)


def trial_size(problem: Problem, candidate: Candidate, param: Parameter) -> float:
    """A value of a parameter at which the effect is well visible and still small, by the parameter's unit."""
    limits = problem.settings.search
    scale = 1.0
    if candidate.joint is not None:
        i = problem.robot.joint_names.index(candidate.joint)
        scale = float(problem.torque_scale[i])
        signals = problem.signals(candidate.joint)
        travel, speed = float(np.std(signals.q)) + 1e-6, float(np.std(signals.dtheta)) + 1e-6
    else:
        travel = speed = 1.0
    stiff, angle = 1.0, 0.01
    if candidate.joint is not None and problem.robot.joints[i].rigid:
        angle = param.value  # no spring says what an angle does
    elif candidate.joint is not None:
        stiff = problem.robot.joints[i].drive.K
        angle = limits.trial_share * scale / stiff
    by_unit = {
        "N m": limits.trial_share * scale,
        "N m s/rad": limits.trial_share * scale / speed,
        "N m s^2/rad^2": limits.trial_share * scale / speed**2,
        "N m/rad": limits.trial_share * scale / travel,
        "N m/rad^3": limits.trial_share * scale / (scale / stiff) ** 3,
        "rad": angle,
        "s": 1e-3,
        "": limits.trial_share,
        "1": limits.trial_share,
    }
    return float(np.clip(by_unit.get(param.unit, param.value), param.low, param.high))


def load_traces(problem: Problem, candidate: Candidate, y: np.ndarray) -> Iterator[Trace]:
    """Traces of a change of a link's inertial parameters, one fitted to the whole recording and others to its
    later parts. The residual is linear in the ten parameters, so that the few parameters of the effect are
    found on a quadratic form, without evaluating the signals again."""
    assert candidate.joint is not None
    i = problem.robot.joint_names.index(candidate.joint)
    white, time = problem.whitening, problem.time
    moments = np.stack([white.white(problem.inertial_band(i, unit)) for unit in np.eye(10)])
    own = float(problem.motion.rigid.inertial[i, 0]) or 1.0
    amplitude, shape = load_params(candidate.effect)
    for share in problem.settings.search.later:
        later = time >= time[0] + share * (time[-1] - time[0])
        form = problem.normal((moments * later).reshape(10, -1), y)
        mass, *place = _load(candidate, *form, own, problem.settings.search)
        mass = float(np.clip(mass, amplitude.low, amplitude.high))
        values = {amplitude.name: mass, shape.name: tuple(place)}
        band = problem.inertial_band(i, _inertial(candidate, np.array([mass, *place])))
        yield Trace(candidate, values, (band,), white, "whole", {amplitude.name: mass}, {amplitude.name: 0.0})


def _inertial(candidate: Candidate, load: np.ndarray) -> np.ndarray:
    """(10, ...) inertial parameters of loads (4, ...): mass and place."""
    amplitude, shape = load_params(candidate.effect)
    p = candidate.planned({}).p._replace(**{amplitude.name: load[0], shape.name: tuple(load[1:])})
    return np.array(candidate.effect.edit_inertial([0.0 * load[0]] * 10, p))


def _load(
    candidate: Candidate,
    curvature: np.ndarray,
    slope: np.ndarray,
    own: float,
    settings: SearchSettings,
) -> list[float]:
    """Mass and place at which 2 slope pi + pi curvature pi is least, of a link of mass `own`; weak priors
    keep them near it. There are several minima: the best places of a grid, each with its best mass, are where
    a positive and a negative one start."""
    # as a sum of squares, a constant aside; what is not seen has no part in it
    seen, axes = np.linalg.eigh(curvature)
    root = np.sqrt(seen[seen > UNSEEN * seen[-1]])
    rows = root[:, None] * axes[:, -root.size :].T
    target = axes[:, -root.size :].T @ slope / root
    spread = np.array([settings.heavy * own, *3 * [settings.reach]])

    def misfit(x: np.ndarray) -> np.ndarray:
        return np.concatenate([rows @ _inertial(candidate, x) + target, x / spread])

    def change(x: np.ndarray) -> np.ndarray:  # by complex steps, exact: the law is a polynomial
        steps = _inertial(candidate, x[:, None] + 1e-20j * np.eye(4)).imag / 1e-20
        return np.concatenate([rows @ steps, np.diag(1.0 / spread)])

    best, least = np.zeros(4), np.inf
    axis = np.linspace(-FARTHEST, FARTHEST, PLACES) * settings.reach
    places = np.array(np.meshgrid(axis, axis, axis)).reshape(3, -1)
    unit = rows @ _inertial(candidate, np.concatenate([np.ones((1, places.shape[1])), places]))
    size = np.sum(unit**2, axis=0) + 1.0 / spread[0] ** 2
    masses = -(target @ unit) / size
    gains = masses**2 * size - np.sum((places / spread[1:, None]) ** 2, axis=0)
    for sign in (1.0, -1.0):
        k = int(np.argmax(np.where(np.sign(masses) == sign, gains, -np.inf)))
        start = np.concatenate([masses[k : k + 1], places[:, k]])
        found = least_squares(misfit, start, change, method="lm", x_scale="jac", max_nfev=300)
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return [float(v) for v in best]
