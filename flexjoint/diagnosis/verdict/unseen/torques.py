"""What is left of each balance on data that was held out of the fit, and how much of it depends on one
signal.

A real machine always leaves something: many small errors that nobody names. A true cause leaves just these;
a wrong one leaves more, and a smooth law of one signal would often remove that. So what is left is regressed
on one signal after another, on the blocks that were fitted, and judged on those that were held out.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flexjoint.diagnosis.balances.balances import LINK, MOTOR, Balances, balances_of
from flexjoint.diagnosis.regression.deviations import converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.fit import Fit, fit, nominal_deviations
from flexjoint.diagnosis.regression.problem import NoiseLevel, Problem
from flexjoint.diagnosis.regression.recorded import Recorded
from flexjoint.diagnosis.result import Remaining, Removed
from flexjoint.diagnosis.settings import USUAL, Settings, VerdictSettings
from flexjoint.diagnosis.verdict import instead
from flexjoint.diagnosis.verdict.residuals import NEIGHBOURS, smooth_curve
from flexjoint.diagnosis.verdict.unseen.simulation import held_out_blocks
from flexjoint.effects import Planned, Signals, Site
from flexjoint.recording.readings.quantities import of_robot
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot

BLOCK = 1.0  # s, over which errors are taken for dependent
RIDGE = 1e-3  # of a curve's normal matrix, on its mean diagonal: corners that few samples visit stay flat
THROUGH_TORQUE = (Site.COMMAND, Site.MOTOR, Site.LINK, Site.BODY)  # where effects change motor torque


@dataclass(frozen=True)
class View:
    """Filtered residuals [N m] of all balances on usable samples, by sets of causes: along one motion, beside
    one set of nominal numbers."""

    problem: Recorded
    away: np.ndarray  # (N,) bool: samples that the fits did not see
    before: np.ndarray  # (rows, N) of the nominal model
    after: np.ndarray  # of the whole set
    without: tuple[np.ndarray, ...] = ()  # of the same model without each of its causes
    frictionless: Mapping[str, np.ndarray] = field(
        default_factory=dict
    )  # without a joint's ordinary friction

    def left(self, joint: str) -> float:
        """[N m] RMS of what is left of a joint where the fits did not look; infinite if it has no torque."""
        total = _total(self.problem.balances, self.after, self.problem.robot.joint_names.index(joint))
        return float("inf") if total is None else float(np.sqrt(np.mean(total[self.away] ** 2)))


@dataclass(frozen=True)
class Unseen:
    """What is left of a model, in several views. An error of the model shows in all of them, what is wrong
    with a view only in this one: so a joint is judged by the view that leaves least of it. Nominal numbers
    fitted to some blocks may make the others worse, above all where much is left; and a link encoder that is
    off by 0.1 mrad, times a stiffness of 5e6 N m/rad, is more torque than most causes have."""

    effects: tuple[Planned, ...]
    views: tuple[View, ...]  # the first along the readings, with numbers corrected; the last may be of motors
    of_joint: Mapping[str, View]
    doubted: frozenset[str | None] = frozenset()  # joints with friction off by more than a tolerance explains

    def of_cause(self, k: int, joint: str) -> View:
        """The view in which what cause k does to a joint is measured. Along the motors a spring, and sensors
        of the links, do not show."""
        view = self.of_joint[joint]
        if view.problem is self.views[0].problem or self.effects[k].effect.site in THROUGH_TORQUE:
            return view
        return min(self.views[:2], key=lambda one: one.left(joint))


def unseen(best: Fit, nothing: Fit) -> Unseen:
    """Residuals of a set of causes, fitted on every second block of two seconds, of the same model without
    each of them, and of the nominal model."""
    fitted = fit(unseen_problem(best.problem), best.effects)
    problem, effects, numbers = fitted.problem, fitted.effects, nominal_deviations(fitted)
    corrected = _view(problem, effects, _nominal(nothing), lambda some: _left(problem, some, numbers))
    doubted = zip(problem.nuisance, _doubted(problem, numbers), strict=True)
    return replace(
        in_views(corrected, effects), doubted=frozenset(number.joint for number, is_so in doubted if is_so)
    )


def in_views(corrected: View, effects: Sequence[Planned], singly: bool = True) -> Unseen:
    """What effects leave in the view with corrected nominal numbers, and in others; there also without each
    of them, unless not `singly`."""
    problem = corrected.problem
    plain = _uncorrected(problem, effects, singly)
    views = [corrected, plain]
    names = [
        joint.name
        for j, joint in enumerate(problem.robot.joints)
        if not joint.rigid and np.isfinite([problem.readings.q[j, 0], problem.readings.theta[j, 0]]).all()
    ]
    of_joint = _least(views, problem.robot.joint_names)
    left = {joint.joint for joint in beyond_background(_remaining(of_joint, False), problem.settings.verdict)}
    if left.intersection(names):
        motors = _along_motors(problem, left.intersection(names))
        acting = [e for e in effects if e.effect.site in THROUGH_TORQUE]
        views.append(_uncorrected(motors, acting, singly))
        of_joint = _least(views, problem.robot.joint_names)
    return Unseen(tuple(effects), tuple(views), of_joint)


def _least(views: Sequence[View], joints: Sequence[str]) -> dict[str, View]:
    return {joint: min(views, key=lambda view: view.left(joint)) for joint in joints}


def _view(
    problem: Recorded,
    effects: Sequence[Planned],
    before: np.ndarray,
    left: Callable[[Sequence[Planned]], np.ndarray],
    singly: bool = True,
) -> View:
    if not singly:
        return View(problem, away(problem), before, left(effects))
    rubbing = dict.fromkeys(str(e.joint) for e in effects if e.effect.ordinary)
    return View(
        problem,
        away(problem),
        before,
        left(effects),
        tuple(left(instead.without(one, effects, problem.nominal)) for one in effects),
        {
            joint: left([e for e in effects if not (e.effect.ordinary and e.joint == joint)])
            for joint in rubbing
        },
    )


def _uncorrected(problem: Recorded, effects: Sequence[Planned], singly: bool) -> View:
    def left(some: Sequence[Planned]) -> np.ndarray:
        return uncorrected(problem, some)

    return _view(problem, effects, left([]), left, singly)


def _along_motors(problem: Recorded, joints: Collection[str]) -> Recorded:
    """The same recording without the link encoders of some joints: the links follow the motors through the
    model's springs."""
    recording = problem.readings.recording
    columns = {key: x for key, x in recording.columns.items() if not (key[0] == "q" and key[1] in joints)}
    return Recorded(balances_of(problem.robot, replace(recording, columns=columns), problem.settings))


def unseen_problem(problem: Problem) -> Problem:
    """The problem with every second block of two seconds counted only; all samples of a short recording."""
    blocks = held_out_blocks(
        problem.balances.chains.t[0] + problem.time, problem.settings.verdict.held_out_block
    )
    if np.any(blocks) and not np.all(blocks):
        return problem.at(NoiseLevel(problem.level.inflation)).only(~blocks)
    return problem


def away(problem: Recorded) -> np.ndarray:
    """(N,) bool: usable samples that a fit of `unseen_problem` does not see; every second one of a recording
    that is too short for blocks."""
    blocks = held_out_blocks(problem.balances.chains.t, problem.settings.verdict.held_out_block)
    blocks = blocks[problem.readings.valid]
    return blocks if np.any(blocks) and not np.all(blocks) else np.arange(blocks.size) % 2 == 1


def joint_left(fitted: Fit, joint: str) -> tuple[float, tuple[float, ...]]:
    """[N m] RMS of what a fit of `unseen_problem` leaves where it did not look: of a joint's torque, and of
    each of its balances; with the nominal numbers corrected or as they are, whichever leaves less."""
    problem, j = fitted.problem, fitted.problem.robot.joint_names.index(joint)
    corrected = _left(problem, fitted.effects, nominal_deviations(fitted))
    own = [row.joint == j for row in problem.balances.rows]
    found = []
    for series in (corrected, uncorrected(problem, fitted.effects)):
        left = series[:, away(problem)]
        total = _total(problem.balances, left, j)
        balances = tuple(float(x) for x in np.sqrt(np.mean(left[own] ** 2, axis=1)))
        found.append((0.0 if total is None else float(np.sqrt(np.mean(total**2))), balances))
    return min(found, key=lambda one: one[0])


def lowered(best: Fit, instead: Sequence[Planned], joint: str) -> float:
    """[N m, RMS] by which a set leaves less of a joint's torque than other effects instead, each fitted
    anew, where the fits did not look."""
    seen = unseen_problem(best.problem)
    least, left = (joint_left(fit(seen, effects), joint)[0] for effects in (best.effects, instead))
    return float(np.sqrt(max(0.0, left**2 - least**2)))


def small_errors(joint: Remaining, settings: VerdictSettings) -> float:
    """[N m, RMS] up to which a torque may be the sum of small errors that nobody names."""
    return settings.background_even * background(joint, settings)


def background(joint: Remaining, settings: VerdictSettings) -> float:
    """[N m, RMS] that small errors make: as many as a machine usually has, or what is left of the joint
    beyond noise where that is less."""
    return min(settings.background_typical * joint.torque, joint.beyond_noise)


def uncorrected(problem: Recorded, effects: Sequence[Planned]) -> np.ndarray:
    """(rows, N) what effects leave beside the nominal numbers as they are, about its mean where encoder
    offsets are free."""
    left = _of(problem, problem.with_nominal(effects))
    if problem.robot.file.offsets == "per_recording":
        left = left - np.mean(left, axis=1, keepdims=True)
    return left


def joint_uncorrected(problem: Recorded, effects: Sequence[Planned], joint: str) -> float:
    """[N m] RMS of that in a joint's torque, on the blocks that a fit of `unseen_problem` does not see."""
    left = uncorrected(problem, effects)[:, away(problem)]
    total = _total(problem.balances, left, problem.robot.joint_names.index(joint))
    return 0.0 if total is None else float(np.sqrt(np.mean(total**2)))


def left_beside(problem: Problem, effects: Sequence[Planned]) -> np.ndarray:
    """(rows, N) what effects leave of all balances [N m] on all usable samples, beside nominal numbers as the
    samples that the problem counts tell them: on the others it is unseen."""
    return _left(problem, effects, converged_deviations(problem, effects, problem.residual(effects)))


def _left(problem: Problem, effects: Sequence[Planned], numbers: np.ndarray) -> np.ndarray:
    """(rows, N) what effects leave beside deviations (numbers,) of the nominal numbers, as far as a tolerance
    explains them: friction that is further off is an error of the model."""
    numbers = np.where(_doubted(problem, numbers), 0.0, numbers)
    every = problem.with_nominal([*effects, *deviation_effects(problem, numbers)])
    return _of(problem, every) - problem.jumped(numbers)[:, problem.readings.valid]


def _doubted(problem: Problem, numbers: np.ndarray) -> np.ndarray:
    """(numbers,) bool: friction of which deviations (numbers,) are more than a tolerance explains."""
    rubs = [number.name == "motor_damping" for number in problem.nuisance]
    return np.asarray(rubs & (np.abs(numbers) > problem.settings.verdict.believed))


def _nominal(nothing: Fit) -> np.ndarray:
    """(rows, N) what the nominal model leaves. Encoder offsets, free in each recording, are no error."""
    problem = nothing.problem
    offsets = [
        e for e in deviation_effects(problem, nominal_deviations(nothing)) if e.effect.site is Site.SENSOR
    ]
    return _of(problem, [*problem.nominal, *offsets])


def _of(problem: Recorded, effects: Sequence[Planned]) -> np.ndarray:
    return np.asarray(problem.balances.residual_torques(effects)[:, problem.readings.valid])


def torque_errors(robot: Robot, recording: Recording, settings: Settings = USUAL) -> dict[str, float]:
    """RMS [N m], by joint, of the measured motor torque minus what the model needs for the measured motion,
    on all usable samples; about its mean where encoder offsets are free. No number is corrected."""
    problem = Recorded(balances_of(robot, of_robot(robot, recording), settings))
    left = uncorrected(problem, [])
    totals = {name: _total(problem.balances, left, j) for j, name in enumerate(robot.joint_names)}
    return {name: float(np.sqrt(np.mean(x**2))) for name, x in totals.items() if x is not None}


# ------------------------------------------------------------------ causes
def removed(data: Unseen, k: int) -> Removed:
    """What cause k of a set removes, in the balance in which it removes the largest share; of one that makes
    all of them worse, in that of which it makes least worse."""
    best: tuple[tuple[bool, float], View, str, str, np.ndarray, np.ndarray] | None = None
    for joint in data.of_joint:
        view = data.of_cause(k, joint)
        without = view.without[_place(data, view, k)]
        for balance, there, left, noise in _of_a_joint(data, view, without, joint):
            before, after = (float(np.mean(x[view.away] ** 2)) for x in (there, left))
            share = (before - after) / max(after, noise**2, 1e-300)
            rank = (not np.array_equal(there, left), share)  # it acts there, and clears much of it
            if best is None or rank > best[0]:
                best = (rank, view, joint, balance, there, left)
    assert best is not None  # every joint has a balance
    _, view, joint, balance, there, left = best
    before, after = (float(np.mean(x[view.away] ** 2)) for x in (there, left))
    share, against = shape(view, left, joint)
    structured = float(np.sqrt(share * after))
    held = _held(view, there, left)
    return Removed(joint, balance, float(np.sqrt(before)), float(np.sqrt(after)), structured, against, *held)


def _held(view: View, there: np.ndarray, left: np.ndarray) -> tuple[float | None, float | None]:
    """`Removed.held` and its standard error, of residuals (N,) without the cause and with it: from errors
    that are alike within blocks (Liang and Zeger 1986), and from their size. None where that error is above
    1, as the cause hardly acts on unseen data: an end stop may be met only in a block that the fit saw."""
    times = view.problem.balances.chains.t[view.problem.readings.valid][view.away]
    error, own = there[view.away], (there - left)[view.away]
    power = float(own @ own)
    if power <= 0.0:
        return None, None
    held = float(own @ error) / power
    beside = error - held * own
    scores = np.bincount((times / BLOCK).astype(int), own * beside)
    independent = float(np.mean(view.problem.balances.filter.gain**2))  # share of the samples
    by_size = np.sqrt(np.mean(beside**2) / (power * independent))
    std = float(np.hypot(np.linalg.norm(scores) / power, by_size))
    return (held, std) if std < 1.0 else (None, None)


def _of_a_joint(
    data: Unseen, view: View, without: np.ndarray, joint: str
) -> list[tuple[str, np.ndarray, np.ndarray, float]]:
    """A joint's balances in a view: name, residual (N,) without a cause and with it, deviation of the noise.
    Along the motors it has one, of its whole torque: the spring's is computed."""
    problem, j = view.problem, view.problem.robot.joint_names.index(joint)
    rows = [r for r, row in enumerate(problem.balances.rows) if row.joint == j]
    if problem is not data.views[0].problem:
        there, left = (_total(problem.balances, x, j) for x in (without, view.after))
        if there is not None and left is not None:
            return [(MOTOR, there, left, float(np.linalg.norm(problem.deviation[rows[:2]])))]
    balances = problem.balances.rows
    return [(balances[r].balance, without[r], view.after[r], float(problem.deviation[r])) for r in rows]


def _place(data: Unseen, view: View, k: int) -> int:
    """The place of cause k among those of a view."""
    if view.problem is data.views[0].problem:
        return k
    return sum(e.effect.site in THROUGH_TORQUE for e in data.effects[:k])


def friction(data: Unseen, joint: str | None) -> float | None:
    """[N m] RMS of the torque that all ordinary friction of a joint removes; None where it has none."""
    view = None if joint is None else data.of_joint.get(joint)
    if view is None or joint is None or joint not in view.frictionless:
        return None
    j = view.problem.robot.joint_names.index(joint)
    without, left = (_total(view.problem.balances, x, j) for x in (view.frictionless[joint], view.after))
    if without is None or left is None:
        return None
    gone = np.mean(without[view.away] ** 2) - np.mean(left[view.away] ** 2)
    return float(np.sqrt(max(0.0, gone)))


def spoils(data: Unseen, k: int) -> bool:
    """Whether cause k of a set makes its joint's torque far worse with the nominal numbers as they are, which
    an extended model has. A wrong cause may explain an error together with nominal numbers that are all off:
    with half the torque, half the inertia and half the friction as well, little is left."""
    return spoiling(data, k) > data.views[1].problem.settings.verdict.spoilt


def spoiling(data: Unseen, k: int) -> float:
    """How many times as much is left of a joint's torque with cause k of a set as without it, with the
    nominal numbers as they are; 0 of a cause that does not act through the torque of a joint."""
    planned, view = data.effects[k], data.views[1]
    if planned.joint is None or planned.effect.site not in THROUGH_TORQUE:
        return 0.0
    j = view.problem.robot.joint_names.index(planned.joint)
    without, left = (_total(view.problem.balances, x, j) for x in (view.without[k], view.after))
    if without is None or left is None:
        return 0.0
    return float(np.std(left[view.away])) / max(float(np.std(without[view.away])), 1e-300)


# ------------------------------------------------------------------ joints
def remaining(data: Unseen) -> tuple[Remaining, ...]:
    """What is left of each joint's torque."""
    return _remaining(data.of_joint)


def _remaining(of_joint: Mapping[str, View], shapes: bool = True) -> tuple[Remaining, ...]:
    """The same; without `shapes` no joint's has one, as these take long to find."""
    noises: dict[int, list[float]] = {}
    out = []
    for joint, view in of_joint.items():
        problem, j = view.problem, view.problem.robot.joint_names.index(joint)
        before, after = (_total(problem.balances, x, j) for x in (view.before, view.after))
        if before is None or after is None:
            continue
        if id(problem) not in noises:
            noises[id(problem)] = _noise(problem)
        share, against = shape(view, after, joint) if shapes else (0.0, "t")
        left = float(np.sqrt(np.mean(after[view.away] ** 2)))
        out.append(
            Remaining(
                joint,
                float(problem.torque_scale[j]),
                float(np.sqrt(np.mean(before[view.away] ** 2))),
                left,
                noises[id(problem)][j],
                float(np.sqrt(share)) * left,
                against,
            )
        )
    return tuple(out)


def _total(balances: Balances, series: np.ndarray, j: int) -> np.ndarray | None:
    """(N,) the joint's torque error: motor and link balance together, in which no spring torque appears."""
    rows = [k for k, row in enumerate(balances.rows) if row.joint == j and row.balance in (MOTOR, LINK)]
    return np.sum(series[rows], axis=0) if rows else None


def _noise(problem: Recorded) -> list[float]:
    """RMS [N m] that the sensors' noise has in each joint's torque error."""
    balances, readings = problem.balances, problem.readings
    nominal = list(problem.nominal)
    measured, denoised = (
        b.time_series(b.residual(nominal))[:, readings.valid] for b in (balances, balances.denoised)
    )
    smoothing = float(np.sqrt(np.mean(balances.filter.gain**2)))  # of a torque's white noise
    out = []
    for j in range(len(problem.robot.joints)):
        positions = _total(balances, measured - denoised, j)
        moved = 0.0 if positions is None else float(np.std(positions))
        out.append(float(np.hypot(moved, smoothing * float(readings.noise["torque"][j]))))
    return out


def lefts(data: Unseen, joint: str, nominal: bool = False) -> tuple[float, ...]:
    """[N m] RMS of what is left of a joint along its encoders: of its torque, and of each of its balances; by
    the set, or by the `nominal` model."""
    view = min(data.views[:2], key=lambda one: one.left(joint))
    problem, series = view.problem, view.before if nominal else view.after
    j = problem.robot.joint_names.index(joint)
    own = [series[r] for r, row in enumerate(problem.balances.rows) if row.joint == j]
    total = _total(problem.balances, series, j)
    whole = [] if total is None else [total]
    return tuple(float(np.sqrt(np.mean(x[view.away] ** 2))) for x in (*whole, *own))


def missing_causes(data: Unseen) -> tuple[Remaining, ...]:
    """Joints at which some cause is still missing: the unfinished ones, and those with a balance of which
    more is left than noise and a background make, and most of what there was. An error of a spring moves
    torque from the motor to the link, and does not show in their sum."""
    problem = data.views[0].problem
    settings, joints, out = problem.settings.verdict, remaining(data), []
    open_ones = {joint.joint for joint in unfinished(joints, settings)}
    for joint in joints:
        j = problem.robot.joint_names.index(joint.joint)
        own = [float(problem.deviation[r]) for r, row in enumerate(problem.balances.rows) if row.joint == j]
        before, after = (lefts(data, joint.joint, nominal)[1:] for nominal in (True, False))
        wrong = any(
            now >= max(settings.above_noise * noise, settings.finished * joint.torque)
            and now**2 > settings.unfinished_share * then**2
            for noise, then, now in zip(own, before, after, strict=True)
        )
        if wrong or joint.joint in open_ones:
            out.append(joint)
    return tuple(out)


def beyond_background(joints: Sequence[Remaining], settings: VerdictSettings) -> tuple[Remaining, ...]:
    """Joints of which more is left than noise and a background make, most first."""
    limit = [max(settings.above_noise * joint.noise, settings.finished * joint.torque) for joint in joints]
    out = [joint for joint, most in zip(joints, limit, strict=True) if joint.after >= most]
    return tuple(sorted(out, key=lambda joint: -joint.after / max(joint.torque, 1e-300)))


def unfinished(joints: Sequence[Remaining], settings: VerdictSettings) -> tuple[Remaining, ...]:
    """Joints at which some cause is still missing: more is left than noise and a background make, and this is
    either most of what there was, or a smooth law of one signal removes much of it."""
    out = []
    for joint in beyond_background(joints, settings):
        shaped = joint.structured**2 > settings.unfinished_shape * joint.before**2
        if shaped or joint.after**2 > settings.unfinished_share * joint.before**2:
            out.append(joint)
    return tuple(out)


def standing_out(joints: Sequence[Remaining], settings: VerdictSettings) -> tuple[Remaining, ...]:
    """The unfinished ones of which clearly more is left than of the machine's other joints: a real machine
    has a background on all of them, and a single one's says nothing of another cause."""
    shares = {joint.joint: joint.after / max(joint.torque, 1e-300) for joint in joints}
    out = []
    for joint in unfinished(joints, settings):
        others = [share for name, share in shares.items() if name != joint.joint]
        usual = settings.usual * float(np.median(others)) if others else 0.0
        if shares[joint.joint] > min(usual, settings.usual_most):
            out.append(joint)
    return tuple(out)


# ------------------------------------------------------------------ shape
def shape(data: View, series: np.ndarray, joint: str) -> tuple[float, str]:
    """The share of what is left of a joint (N,) on held-out blocks that a smooth law of one signal removes,
    fitted on the other blocks, and that signal."""
    best, most = "t", 0.0
    seen, away = ~data.away, data.away
    if not np.any(seen) or not np.any(away):
        return most, best
    whole = max(float(np.sum(series[away] ** 2)), 1e-300)
    for name, x in signals(data.problem, joint).items():
        design = smooth_curve(x)
        normal = design[seen].T @ design[seen]
        normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
        rest = series[away] - design[away] @ np.linalg.solve(normal, design[seen].T @ series[seen])
        share = 1.0 - float(np.sum(rest**2)) / whole
        if share > most:
            best, most = name, share
    return most, best


def signals(problem: Recorded, joint: str) -> Mapping[str, np.ndarray]:
    """(N,) signals that an error of a joint may depend on: its own, its neighbours' positions and loads."""
    names = problem.robot.joint_names
    at = names.index(joint)
    own = problem.signals(joint)
    out = {name: getattr(own, name) for name in ("q", "dtheta", "tau_t", "phi", "tau_m", "t")}
    for k in (at - 1, at + 1):
        if 0 <= k < len(names):
            other: Signals = problem.signals(names[k])
            out |= {f"{name}.{names[k]}": getattr(other, name) for name in NEIGHBOURS}
    return {name: x for name, x in out.items() if float(np.ptp(x)) > 0.0}
