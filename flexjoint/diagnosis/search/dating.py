"""When an effect sets in during a recording, and when it ceases and acts again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, fit_tried
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.search.criteria import score
from flexjoint.diagnosis.search.scan import onset_margin
from flexjoint.effects import Planned

PRICES, CHEAPER = 6, 4.0  # at which switches are tried, and by how much each is lower than the last


def date_onset(result: Fit) -> Fit:
    """Refine the onset of the last effect, or drop the onset: where the effect without one fits nearly as
    well, and where the onset is too near to an end of the recording to be seen."""
    added = result.effects[-1]
    if added.since is None:
        return result
    problem, limits = result.problem, result.settings.search
    always = fit_tried(problem, [*result.effects[:-1], replace(added, since=None, switches=())], added)
    result = _dated_finely(result)
    end, since = float(problem.balances.chains.t[-1]), float(result.effects[-1].since or 0.0)
    margin = onset_margin(end, limits)
    if not margin <= since <= end - margin:
        return always
    granted = limits.undated * max(0.0, always.energy - result.energy)
    return always if score(always) < score(result) + granted else result


def _dated_finely(result: Fit) -> Fit:
    """The times at which the last effect sets in, ceases and so on, where the energy is least: searched in
    smaller and smaller steps with all numbers fixed, and fitted anew after each row of steps."""
    problem = result.problem
    for steps in result.settings.search.onset_steps:
        *others, moved = result.effects
        for place in range(1 + len(moved.switches)):
            moved = _moved(problem, others, moved, place, steps)
        if moved.identity != result.effects[-1].identity:
            trial = fit_tried(problem, [*others, moved], moved)
            if trial.energy < result.energy:
                result = trial
    return result


def _moved(
    problem: Problem, others: Sequence[Planned], dated: Planned, place: int, steps: Sequence[float]
) -> Planned:
    """An effect beside others with one of its times, the first of which is `since`, where the energy is
    least, in smaller and smaller steps; the times keep their order."""
    times = [dated.since or 0.0, *dated.switches]
    if not math.isfinite(times[place]):
        return dated
    low = max(0.0, *times[:place]) if place else 0.0
    high = times[place + 1] if place + 1 < len(times) else float(problem.balances.chains.t[-1])

    def at(time: float) -> Planned:
        now = [*times[:place], time, *times[place + 1 :]]
        return replace(dated, since=now[0], switches=tuple(now[1:]))

    def energy(time: float) -> float:
        return problem.energy(problem.residual([*others, at(time)])) if low < time < high else math.inf

    best = times[place]
    least = energy(best)
    for step in steps:
        start = best
        for sign in (-1.0, 1.0):
            if best == start:  # it is on one side
                while (there := energy(best + sign * step)) < least:
                    least, best = there, best + sign * step
    return at(best)


def switched(result: Fit, finely: bool = True) -> Fit:
    """The last effect with the times at which it ceases and acts again, where it may do so
    (`Effect.comes_and_goes`) and the data support them: times for given numbers, and numbers for given times,
    in turn until neither gains. Without `finely` times are those of white samples.

    The level of a set that holds all the time what comes and goes counts what that leaves as noise. Gains are
    therefore those in likelihood where the variance of each balance is unknown, n log(E) (`_lowered`)."""
    problem, limits = result.problem, result.settings.search
    *others, added = result.effects
    if not added.effect.comes_and_goes or any(e.key == added.key for e in problem.nominal):
        return result
    best = result
    for _ in range(limits.switch_rounds):
        moved = _with_switches(best)
        if not moved.switches or moved.identity == best.effects[-1].identity:
            break
        trial = fit_tried(problem, [*others, moved], added)
        more = len(moved.changes) - len(best.effects[-1].changes)
        if _lowered(best, _squares(trial)) <= limits.price_number * more:
            break
        best = trial
    return _dated_finely(best) if finely and best.effects[-1].switches else best


def _squares(result: Fit) -> np.ndarray:
    """(rows,) energy that a fit leaves in each balance."""
    return np.asarray(np.sum(result.problem.rest_by_row(result.y) ** 2, axis=1))


def _lowered(result: Fit, squares: np.ndarray) -> float:
    """What is gained where the balances' energies (rows,) become these: n log(E), with as many independent
    samples as the level of the fit counts, and no less left than the sensors' noise. For small changes this
    is the change of the energy."""
    problem, before = result.problem, _squares(result)
    noise = problem.by_row * problem.freedom / len(problem.counted)
    floor = np.maximum(noise, 1e-9)
    return float(np.sum(before * np.log(np.maximum(before, floor) / np.maximum(squares, floor))))


def _with_switches(result: Fit) -> Planned:
    """The last effect, acting when that lowers the energy, with its trace of any size and all other numbers
    fixed. A switch costs what a number does; what that is in energy depends on the level which the set will
    leave, so that lower prices are tried, too."""
    problem, limits = result.problem, result.settings.search
    *others, added = result.effects
    explained = problem.along(problem.deviations(result.y))

    def left(since: float | None) -> np.ndarray:
        """(rows, N) what is left with the effect always on, or never."""
        y = problem.residual([*others, replace(added, since=since, switches=())])
        return ((y - explained) * problem.weights).reshape(len(problem.balances.rows), -1)

    without = left(math.inf)
    trace = left(None) - without
    shortest = math.ceil(limits.switch_seconds / float(np.median(np.diff(problem.time))))
    best, most = added.acts(problem.balances.chains.t[0] + problem.time), 0.0
    for k in range(PRICES):
        acting, size = best, 1.0
        for _ in range(limits.switch_rounds):
            gains = np.sum(without**2 - (without + size * trace) ** 2, axis=0)
            acting = _spans(gains, limits.price_number / CHEAPER**k, shortest)
            size = -float(np.sum(without * trace * acting)) / max(float(np.sum(trace**2 * acting)), 1e-300)
        squares = np.sum((without + size * trace * acting) ** 2, axis=1)
        gained = _lowered(result, squares) - limits.price_number * np.sum(acting[1:] != acting[:-1])
        if gained > most:
            best, most = acting, gained
    return _acting(added, best, problem)


def _acting(added: Planned, acting: np.ndarray, problem: Problem) -> Planned:
    """An effect that acts at these samples (N,), switched between two of them; never, from inf on."""
    time = problem.balances.chains.t[0] + problem.time
    at = np.flatnonzero(acting[1:] != acting[:-1]) + 1
    changes = tuple((0.5 * (time[at - 1] + time[at])).tolist())
    if acting[0]:
        return replace(added, since=-math.inf if changes else None, switches=changes)
    return replace(added, since=changes[0] if changes else math.inf, switches=changes[1:])


def _spans(gains: np.ndarray, price: float, shortest: int) -> np.ndarray:
    """(N,) bool, where something is on that gains so much (N,) at each sample while it is on, so that all
    gains less a price for each switch are most; a span takes at least so many samples (Viterbi 1967)."""
    gained = [0.0, *np.cumsum(gains).tolist()]
    count = len(gains)
    # of the samples before, the last one off or on: the most, and where the last span began
    most = [[0.0] * (count + 1), gained.copy()]
    since = [[0] * (count + 1), [0] * (count + 1)]
    for k in range(2 * shortest, count + 1):
        begin = k - shortest
        for on in (0, 1):
            stays = most[on][k - 1] + on * (gained[k] - gained[k - 1])
            turns = most[1 - on][begin] + on * (gained[k] - gained[begin]) - price
            most[on][k], since[on][k] = max((stays, since[on][k - 1]), (turns, begin))
    out, end, on = np.zeros(count, dtype=bool), count, int(most[1][count] > most[0][count])
    while end > 0:
        begin = since[on][end]
        out[begin:end] = on
        end, on = begin, 1 - on
    return out
