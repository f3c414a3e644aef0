"""Which set of effects explains the recording: scan, fit the best, add, exchange, prune, date.

A set is judged by its energy Q(y, y) plus a price for every effect and every number in it. An effect
enters only when it earns more than its price, matters by the robot's own torque tolerance (or leaves
nothing but noise), and removes more than the method's own error in the balances it touches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.diagnose.candidates import Candidate
from flexjoint.diagnose.fit import Fit, fit
from flexjoint.diagnose.nuisance import NUMBERS
from flexjoint.diagnose.scan import Scanner, Scored
from flexjoint.diagnose.workspace import Workspace
from flexjoint.effect import Planned

# energy that an effect of one number must earn, 4 deviations: some hundred candidates are tried, and in a
# hundred healthy recordings chance may favour one of them
PRICE = 16.0
PRICE_NUMBER = 12.0  # and for each further number, or an onset: more than chance gives, less than a law
METHOD_ERROR = (
    1e-3  # share of what a joint's other causes explain, which filters and friction zones may leave
)
BLIND = 24.0  # more where a position is made of the nominal model, which is known to first order only
LEFTOVER = 0.05  # share of the unexplained energy that a cause, or a finer one, must at least explain
FILTERED = 1e-5  # share of the explained energy by which laws differ as filtered balances see their kinks
POLISHED = 8  # candidates fitted in full at each stage, at most ...
PROMISING = 0.3  # ... with this share of the best one's first-order gain ...
RIVALLING = 0.7  # ... and, as rivals of an effect, this share of what it explains
CLEARED = 10.0  # factor in variance by which a set must leave less, to be judged at the level that it leaves
COMPLETE = 3.0  # times the predicted noise, up to which a balance counts as explained
NEGLIGIBLE = 0.1  # of the torque tolerance, below which no effect is named whatever it explains ...
CERTAIN = 100.0  # ... and energy that one below the tolerance must earn: ten deviations, ...
CERTAIN_DATED = 1000.0  # ... more with an onset: over the whole record, one fits something small by chance
CERTAIN_LOUD = 1000.0  # energy of which a good part is not the noise's, whatever the law
CALM_SHARE = 0.5  # of a smaller one, that a law must earn along the denoised recording
AT_BOUND = 0.1  # relative distance from a shape's bound (all lie far outside of what machines do)
TOLERATED = 2.0  # prior deviations up to which a nominal number that is off is no cause
MOST_EFFECTS = 12
MOST_EXCHANGES = 4
LEVEL_ROUNDS = 5
ONSET_STEPS = (0.25, 0.1, 0.04, 0.015)  # s, of the search for an onset

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Selection:
    """The chosen set with its fit, the first scan, and the alternatives to each chosen effect."""

    best: Fit
    nothing: Fit  # no effect beyond the nominal model
    scan: tuple[Scored, ...]  # of the nominal model, best start of each candidate
    last_scan: tuple[Scored, ...]  # of the chosen set: what was looked for beyond it
    rivals: tuple[tuple[Fit, ...], ...]  # per chosen effect: fits with another in its place, best first


def price(effects: Sequence[Planned]) -> float:
    numbers = [sum(p.size for p in e.effect.params) + (e.since is not None) for e in effects]
    return sum(PRICE + PRICE_NUMBER * (count - 1) for count in numbers)


def score(result: Fit) -> float:
    """What is compared: energy plus price."""
    blind = BLIND * len(result.effects) if result.workspace.motion.missing else 0.0
    return result.energy + price(result.effects) + blind


def select(
    workspace: Workspace, candidates: Sequence[Candidate], report: Progress, start: Sequence[Planned] = ()
) -> Selection:
    """Forward selection with full refits, exchanges and pruning; `start` seeds the set."""
    nothing = at_own_level(fit(workspace, []))
    best = at_own_level(fit(workspace, start)) if start else nothing
    scanner = Scanner(candidates)
    first: tuple[Scored, ...] = ()
    scanned: tuple[Scored, ...] = ()
    rivals: tuple[tuple[Fit, ...], ...] = ()
    seen = {_keys(best)}  # a cause may enter at its own level and not stay at that of the set
    while len(best.effects) < MOST_EFFECTS:
        report(len(best.effects) / (len(best.effects) + 2.0), f"looking for cause {len(best.effects) + 1}")
        bare = at_noise(best)
        scanned, *beyond = scanner.scans([best] if bare is None else [best, bare])
        first = first or scanned
        trials = polish(best, scanned)
        found = [f for f in trials if worthwhile(f, best, f.effects[-1])]
        found = on_one_level([*found, *clearing(best, trials, bare, beyond)])
        if not found:
            break
        best = prune(at_own_level(date_onset(choose(found))))
        if _keys(best) in seen:
            break
        seen.add(_keys(best))
        newest = best.effects[-1]
        best, _ = exchange(
            scanner, best, [e for e in best.effects if e.joint == newest.joint and e is not newest]
        )
    report(0.9, "comparing rival causes")
    best, rivals = exchange(scanner, best, best.effects)
    return Selection(best, nothing, first, scanned, rivals)


def _keys(result: Fit) -> frozenset[tuple[str, str | None]]:
    return frozenset(e.key for e in result.effects)


def at_own_level(result: Fit) -> Fit:
    """The fit again, judged against the variance that it leaves itself."""
    for _ in range(LEVEL_ROUNDS):
        workspace = result.workspace.tempered(result.y)
        settled = np.all(np.abs(np.log(workspace.temper / result.workspace.temper)) < 0.1)
        result = fit(workspace, result.effects)
        if settled:
            break
    return result


def at_noise(best: Fit) -> Fit | None:
    """The set fitted at the level of the predicted noise; None where neither a balance is wrong nor a nominal
    number implausible."""
    workspace = best.workspace
    if workspace.strain <= 1.0 and not np.any(workspace.temper > CLEARED):
        return None
    return fit(workspace.at(np.ones_like(workspace.temper)), best.effects)


def clearing(
    best: Fit, trials: Sequence[Fit], bare: Fit | None, scanned: Sequence[tuple[Scored, ...]]
) -> list[Fit]:
    """Sets of one more effect that leave a tenth of the variance in the balances that are wrong, or no
    nominal number implausible, each at the level that it leaves. At the level of `best`, at which hardly
    anything counts, they need not show: the scan of the `bare` set at the predicted noise is looked at,
    too."""
    if bare is None:
        return []
    strained = best.workspace.strain > 1.0
    left = best.workspace.temper / best.workspace.strain
    wrong = left > CLEARED

    def clears(levels: np.ndarray) -> bool:
        return bool(np.any(wrong) and np.mean(np.log(left[wrong] / levels[wrong])) >= np.log(CLEARED))

    out = []
    for trial in (*trials, *(one for scan in scanned for one in polish(bare, scan))):
        if strained or clears(bare.workspace.levels(trial.y)):
            settled = at_own_level(trial)
            relieved = strained and settled.workspace.strain <= 1.0
            if relieved or clears(settled.workspace.temper):
                without = fit(settled.workspace, best.effects)
                if worthwhile(settled, without, settled.effects[-1]):
                    out.append(settled)
    return out


def on_one_level(fits: Sequence[Fit]) -> list[Fit]:
    """The fits at the lowest level among theirs."""
    if not fits:
        return []
    lowest = min((f.workspace for f in fits), key=lambda w: float(np.sum(np.log(w.temper))))
    return [f if f.workspace is lowest else fit(lowest, f.effects) for f in fits]


def leftover(result: Fit) -> float:
    """Energy that is still above the predicted noise."""
    return max(0.0, result.energy - result.workspace.noise_energy)


def choose(fits: Sequence[Fit]) -> Fit:
    """The best score; of those that differ by little against what all leave unexplained, or against what
    filters leave of all that is explained, the plainest."""
    best = min(fits, key=score)
    bare = best.workspace.energy(best.workspace.residual([]))
    close = score(best) + LEFTOVER * leftover(best) + FILTERED * max(0.0, bare - best.energy)
    return min((f for f in fits if score(f) <= close), key=lambda f: (price(f.effects), score(f)))


def polish(current: Fit, scanned: Sequence[Scored], needed: float = 0.0) -> list[Fit]:
    """The most promising candidates fitted together with the current set: those whose first-order gain
    comes near the best one's, and near the `needed` energy."""
    out: list[Fit] = []
    if not scanned:
        return out
    most = scanned[0].removes  # to first order; what is `needed` may lie beyond it
    enough = max(PROMISING * most, RIVALLING * min(needed, most), 1.0)
    for scored in scanned[:POLISHED]:
        if scored.removes >= enough:
            fitted = fit(current.workspace, [*current.effects, scored.planned()])
            if not degenerate(fitted.effects[-1]):
                out.append(fitted)
    return out


def degenerate(planned: Planned) -> bool:
    """Whether a law has shrunk to none, or to a simpler one: a shape parameter at its bound."""
    sizes = [(planned.values[p.name], p.null) for p in planned.effect.nulls]
    if all(np.all(np.ravel(size) == null) for size, null in sizes):
        return True
    shapes = [p for p in planned.effect.params if p.null is None and p.size == 1 and not p.wraps]
    return any(
        np.isclose(planned.values[p.name], (p.low, p.high), rtol=AT_BOUND, atol=0.0).any() for p in shapes
    )


def worthwhile(trial: Fit, without: Fit, added: Planned) -> bool:
    """Whether `added`, present in `trial`, earns its price, is material and beyond the method's error."""
    if degenerate(added):
        return False
    if score(trial) >= score(without) - LEFTOVER * leftover(trial):
        return False
    beside = [e for e in trial.effects if e is not added and e.joint == added.joint]
    if beside:
        # what other causes on the joint explain is known only to the method's own error
        alone = fit(trial.workspace, [e for e in trial.effects if e not in beside])
        if without.energy - trial.energy < METHOD_ERROR * (alone.energy - trial.energy):
            return False
    return told_by_motion(trial, without) and material(trial, added, without.energy - trial.energy)


def told_by_motion(trial: Fit, without: Fit) -> bool:
    """Whether what a set of effects earns beyond another comes from the motion: a law of little energy (a gap
    as wide as the encoders' noise) may earn as much from the noise that it shrinks, which it no longer does
    along the denoised recording."""
    earned = without.energy - trial.energy
    if earned >= CERTAIN_LOUD:
        return True
    workspace = trial.workspace
    moved = workspace.whitening.white(workspace.calmly_moved_band(without.effects, trial.effects)).ravel()
    calm = workspace.energy(without.y) - workspace.energy(without.y + moved)
    return calm >= CALM_SHARE * earned


def material(trial: Fit, added: Planned, earned: float) -> bool:
    """Whether an effect's torque is beyond the tolerance for what a model does not hold. That tolerance
    stands for errors of the model; where noise alone is left there are none, and next to none where the
    effect clears the balances that it touches: smaller effects count there that are beyond doubt."""
    if tolerated(trial.workspace, added):
        return False
    shares = torque_shares(trial.workspace, trial.effects, trial.effects.index(added))
    tolerance = trial.workspace.robot.tolerance.torque
    doubtful = earned < (CERTAIN if added.since is None else CERTAIN_DATED)
    if np.max(shares) >= tolerance or np.max(shares) < NEGLIGIBLE * tolerance or doubtful:
        return bool(np.max(shares) >= tolerance)
    touched = shares > 0.0
    left = at_own_level(trial).workspace.temper[touched]
    if np.all(left < COMPLETE):
        return True
    others = [e for e in trial.effects if e is not added]
    before = at_own_level(fit(trial.workspace, others)).workspace.temper[touched]
    wrong = before > CLEARED
    return bool(np.any(wrong) and np.mean(np.log(before[wrong] / left[wrong])) >= np.log(CLEARED))


def tolerated(workspace: Workspace, added: Planned) -> bool:
    """Whether an effect is a nominal number that is off by no more than its tolerance claims."""
    if added.since is not None:
        return False
    for number in workspace.nuisance:
        name, scale = number.name, 1.0
        if name == "motor_damping":
            name, scale = "motor_viscous_friction", workspace.robot.joint(str(number.joint)).drive.D_m
        nominal = number.name in NUMBERS or number.name.endswith("_encoder_offset")
        if (name, number.joint) == added.key and nominal:
            (param,) = added.effect.nulls
            return bool(abs(added.values[param.name]) <= TOLERATED * number.spread * scale)
    return False


def exchange(
    scanner: Scanner, result: Fit, places: Sequence[Planned]
) -> tuple[Fit, tuple[tuple[Fit, ...], ...]]:
    """Try other candidates in the place of some effects; keep what scores better. Also returns, for every
    effect that stays, the fits with a rival in its place, best first."""
    rivals: dict[tuple[str, str | None], tuple[Fit, ...]] = {}
    waiting = [e.key for e in places]
    exchanges = 0  # bounded, so that two equals do not alternate for ever
    while waiting:
        key = waiting.pop(0)
        others = [e for e in result.effects if e.key != key]
        if len(others) == len(result.effects):
            continue
        without = fit(result.workspace, others)
        needed = without.energy - result.energy
        fits = [f for f in polish(without, scanner.scan(without), needed) if f.effects[-1].key != key]
        fits += [alone for f in fits for alone in containing(f, key[0])]
        swapped = choose([result, *fits])
        if swapped is not result and exchanges < MOST_EXCHANGES:
            exchanges += 1
            result = prune(at_own_level(date_onset(swapped)))
            waiting = [e.key for e in result.effects]
            continue
        rivals[key] = tuple(sorted(fits, key=score))
    return result, tuple(rivals.get(e.key, ()) for e in result.effects)


def containing(result: Fit, replaced: str) -> list[Fit]:
    """Where the last effect of a set contains the `replaced` one as a special case: the set without each
    other effect of that joint, whose part it may play too (two levels are a Coulomb level and an offset)."""
    added = result.effects[-1]
    if replaced not in added.effect.contains:
        return []
    beside = [e for e in result.effects[:-1] if e.joint == added.joint]
    return [fit(result.workspace, [e for e in result.effects if e is not other]) for other in beside]


def united(result: Fit) -> Fit:
    """The set without effects that another one of the same joint contains as a special case, where that one
    does as well alone."""
    for wide in result.effects:
        for narrow in result.effects:
            if narrow.joint != wide.joint or narrow.effect.name not in wide.effect.contains:
                continue
            others = [e for e in result.effects if e is not narrow and e is not wide]
            for since in dict.fromkeys((wide.since, narrow.since)):
                alone = date_onset(fit(result.workspace, [*others, replace(wide, since=since)]))
                if score(alone) < score(result):
                    return united(alone)
    return result


def prune(result: Fit) -> Fit:
    """Drop, one by one, the effects that are not worth keeping beside the others."""
    result = united(result)
    while len(result.effects) > 1:
        cheapest: Fit | None = None
        for dropped in result.effects:
            without = fit(result.workspace, [e for e in result.effects if e is not dropped])
            if not worthwhile(result, without, dropped) and (
                cheapest is None or score(without) < score(cheapest)
            ):
                cheapest = without
        if cheapest is None:
            return result
        result = cheapest
    return result


def date_onset(result: Fit) -> Fit:
    """Refine when the last effect set in, or find that it was always there."""
    added = result.effects[-1]
    if added.since is None:
        return result
    workspace = result.workspace
    always = fit(workspace, [*result.effects[:-1], replace(added, since=None)])
    for step in ONSET_STEPS:
        moved = _moved_onset(result, step)
        if moved != result.effects[-1].since:
            trial = fit(workspace, [*result.effects[:-1], replace(result.effects[-1], since=moved)])
            if trial.energy < result.energy:
                result = trial
    return (
        always if score(always) < score(result) + 0.01 * max(0.0, always.energy - result.energy) else result
    )


def _moved_onset(result: Fit, step: float) -> float:
    """Where, in steps from its onset, the last effect of a set would have set in best, all numbers held."""
    workspace, added = result.workspace, result.effects[-1]

    def energy(since: float) -> float:
        if not 0.0 < since < workspace.balances.chains.t[-1]:
            return np.inf
        return workspace.energy(workspace.residual([*result.effects[:-1], replace(added, since=since)]))

    best = float(added.since or 0.0)
    least, start = energy(best), best
    for sign in (-1.0, 1.0):
        if best == start:  # it is on one side
            while (there := energy(best + sign * step)) < least:
                least, best = there, best + sign * step
    return best


def torque_shares(workspace: Workspace, effects: Sequence[Planned], index: int) -> np.ndarray:
    """(rows,) RMS torque of an effect in each balance, as a share of that joint's torque."""
    without = [e for k, e in enumerate(effects) if k != index]
    balances, used = workspace.balances, workspace.readings.valid
    change = balances.change(workspace.with_nominal(without), workspace.with_nominal(effects))
    shares = np.zeros(len(balances.rows))
    for r, (row, spectrum) in enumerate(zip(balances.rows, change, strict=True)):
        if np.any(spectrum):
            torque = balances.time_series(spectrum)[used]
            shares[r] = np.sqrt(np.mean(torque**2)) / workspace.torque_scale[row.joint]
    return shares
