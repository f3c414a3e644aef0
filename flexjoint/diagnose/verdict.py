"""From a selected set of effects to a diagnosis: verdict, findings, ties, tolerances, what was not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from flexjoint.diagnose.candidates import Candidate
from flexjoint.diagnose.fit import Fit, covariance, fit
from flexjoint.diagnose.reliability import left_by, reliability
from flexjoint.diagnose.selection import Key, Selection, choose
from flexjoint.diagnose.ties import preferred, ties
from flexjoint.diagnose.worth import at_own_level, contradicted, degenerate, score, strained, worthwhile
from flexjoint.diagnosis import Finding, Fitted, Ranked, WithinTolerance
from flexjoint.effect import Kind, Param, Planned

SCORE_BLOCK = 1.0  # s, of the time blocks behind the standard errors
SEEN_SHARE = 0.2  # of a joint's torque: an effect that must be larger to be seen was not excited
DETECTABLE = 20.0  # energy that makes an effect seen
SAME = 3.0  # deviations within which joints share one value
SURE = 3.0  # standard errors by which a cause must differ from none
NOTABLE = 2.0  # standard errors by which a nominal number must be off to be worth a line
BELIEVED = 3.0  # prior deviations beyond which a nominal number stands for something else that is wrong


Errors = dict[str, list[float]]  # standard errors of the components of each parameter


def sure(selection: Selection) -> tuple[Selection, tuple[str, ...]]:
    """The selection without causes whose own size is hardly known, the least certain first: where the
    residual is not white, the curvature of a fit promises more than its scores keep."""
    notes: list[str] = []
    while selection.best.effects:
        best = selection.best
        errors = standard_errors(best)
        pairs = list(zip(best.effects, errors, strict=True))
        shrunk = next((e for e in best.effects if degenerate(best.workspace, e)), None)
        if shrunk is not None:
            why = "its law has shrunk to a simpler one or none"
            notes.append(f"{shrunk} would make the balance smaller, but {why}: not named")
            selection = plainer(selection, shrunk)
            continue
        denied = next((e for e in best.effects if contradicted(best, _without(best, e))), None)
        if denied is not None:
            why = "another balance larger, which shows no such error"
            notes.append(f"{denied} would make a balance smaller, but {why}: not named")
            selection = without(selection, denied)
            continue
        certain = [certainty(best, e, std) for e, std in pairs]
        worst = int(np.argmin(certain))
        if certain[worst] >= SURE:
            break
        notes.append(
            f"{best.effects[worst]} would make the balance smaller, but its size is known to"
            f" {certain[worst]:.1f} standard errors only: not named"
        )
        selection = without(selection, best.effects[worst])
    return _by_known_names(selection), tuple(notes)


def _by_known_names(selection: Selection) -> Selection:
    """The selection with effects named as those that they are known as, where these fit as well."""
    best = selection.best
    for k, planned in enumerate(best.effects):
        for rival in selection.rivals[k] if planned.effect.known_as else ():
            other = rival.effects[-1]
            known = other.joint == planned.joint and other.effect.name in planned.effect.known_as
            alone = len(rival.effects) == len(best.effects)
            if known and alone and ties(best, planned, [rival], selection.explains.get(planned.key)):
                named = given_way(selection, k, rival, at_own_level(rival))
                own = fit(named.best.workspace, [*named.best.effects[:-1], planned])
                last = tuple(sorted((*named.rivals[-1], own), key=score))
                return replace(named, rivals=(*named.rivals[:-1], last))
    return selection


def plainer(selection: Selection, shrunk: Planned) -> Selection:
    """The selection with its best rival in the place of a law that has shrunk, or without that law where no
    rival is worth its price."""
    best = selection.best
    k = next(k for k, e in enumerate(best.effects) if e.key == shrunk.key)
    bare = _without(best, best.effects[k])
    fits = [
        r
        for r in selection.rivals[k]
        if len(r.effects) == len(best.effects) and worthwhile(r, bare, r.effects[-1])
    ]
    if not fits:
        return without(selection, shrunk)
    rival = choose(fits)
    settled = at_own_level(rival)
    if degenerate(settled.workspace, settled.effects[-1]):
        return without(selection, shrunk)
    return given_way(selection, k, rival, settled)


def given_way(selection: Selection, k: int, rival: Fit, settled: Fit) -> Selection:
    """The selection with a rival, at its own level, in the place of effect k, with rivals of its own."""
    kept = tuple(r for i, r in enumerate(selection.rivals) if i != k)
    left = [fit(settled.workspace, r.effects) for r in selection.rivals[k] if r is not rival]
    return replace(selection, best=settled, rivals=(*kept, tuple(sorted(left, key=score))))


def without(selection: Selection, effect: Planned) -> Selection:
    """The selection with one of its causes taken out, the others and their rivals fitted again."""
    best = selection.best
    keep = [k for k, e in enumerate(best.effects) if e.key != effect.key]
    left = at_own_level(fit(best.workspace, [best.effects[k] for k in keep]))

    def again(rivals: tuple[Fit, ...]) -> tuple[Fit, ...]:
        sets = [[e for e in rival.effects if e.key != effect.key] for rival in rivals]
        return tuple(sorted((fit(left.workspace, effects) for effects in sets), key=score))

    return replace(selection, best=left, rivals=tuple(again(selection.rivals[k]) for k in keep))


def _without(best: Fit, effect: Planned) -> Fit:
    return fit(best.workspace, [e for e in best.effects if e is not effect])


def certainty(
    best: Fit, planned: Planned, spread: dict[str, list[float]], params: Sequence[Param] | None = None
) -> float:
    """Distance of an effect, or of some of its numbers, from its absence, in standard errors of the number
    that is furthest from it."""
    params = planned.effect.nulls if params is None else params
    return max([_distance(best, planned, param, spread) for param in params], default=0.0)


def _distance(best: Fit, planned: Planned, param: Param, spread: dict[str, list[float]]) -> float:
    """Distance of a number from its absence, in standard errors."""
    listed = next((e for e in best.workspace.nominal if e.key == planned.key), None)
    value = np.ravel(planned.values[param.name])
    null = param.null if listed is None else np.ravel(listed.values[param.name])
    std = np.array(spread.get(param.name, [0.0]))
    return float(np.max(np.abs(value - null) / np.maximum(std, 1e-300)))


def findings(
    selection: Selection,
    gains: Sequence[float],
    explained: float,
    spread: Mapping[Key, Errors] | None = None,
) -> tuple[Finding, ...]:
    """The chosen effects as findings, the largest gain first; `spread` replaces their standard errors."""
    best = selection.best
    if not best.effects:
        return ()
    errors = standard_errors(best)
    completeness = min(1.0, explained + 0.02)
    sliding = best.workspace.robot.prismatic
    out: list[Finding] = []
    for k, planned in enumerate(best.effects):
        listed = next((e for e in best.workspace.nominal if e.key == planned.key), None)
        rivals = selection.rivals[k] if k < len(selection.rivals) else ()
        rivals = tuple(rival for rival in rivals if not strained(rival, best))
        tied = ties(best, planned, rivals, selection.explains.get(planned.key))
        left, share = left_by(best, selection.nothing, k)
        believed = reliability(best, left, share, k)
        out.append(
            Finding(
                planned.effect.name,
                planned.joint,
                preferred(best, planned, rivals, tied) * completeness * believed,
                _parameters(
                    planned, (spread or {}).get(planned.key, errors[k]), listed, planned.joint in sliding
                ),
                None if planned.since is None else planned.since + best.workspace.readings.start,
                gains[k],
                str(planned.effect.kind),
                planned,
                tied,
                hidden_by_refit=_hidden_by_refit(selection, k),
                note="change against the nominal model's own entry" if listed is not None else "",
                left=left,
                reliability=believed,
            )
        )
    return tuple(sorted(out, key=lambda f: -f.gain))


def merged(found: Sequence[Finding], candidates: Sequence[Candidate]) -> tuple[Finding, ...]:
    """Timing causes that every joint with the sensor shares, with one value, as one finding of the robot."""
    out = list(found)
    groups: dict[object, list[Finding]] = {}
    for f in found:
        if f.kind == Kind.TIMING and f.joint is not None:
            words = tuple(f.planned.values.get(w.name) for w in f.planned.effect.words)
            groups.setdefault((f.effect, words), []).append(f)
    for group in groups.values():
        effect, words = group[0].effect, tuple(v for v in group[0].parameters.values() if isinstance(v, str))
        joints = {
            c.joint for c in candidates if c.effect.name == effect and tuple(v for _, v in c.words) == words
        }
        if len(group) < 2 or {f.joint for f in group} != joints or any(f.since is not None for f in group):
            continue
        name = group[0].planned.effect.nulls[0].name
        fitted = [p for p in (f.parameters[name] for f in group) if isinstance(p, Fitted)]
        values = np.array([np.ravel(p.value)[0] for p in fitted])
        weights = np.array([max(float(np.ravel(p.std)[0]), 1e-12) ** -2.0 for p in fitted])
        mean = float(np.sum(weights * values) / np.sum(weights))
        if np.any(np.abs(values - mean) * np.sqrt(weights) > SAME):
            continue
        shared = {**group[0].parameters, name: Fitted(mean, float(np.sum(weights) ** -0.5), "s")}
        one = replace(
            group[0],
            joint=None,
            parameters=shared,
            gain=min(1.0, sum(f.gain for f in group)),
            probability=max(f.probability for f in group),
            members=tuple(f.planned.with_values({name: mean}) for f in group),
            indistinguishable=(),
            note=f"shared by {', '.join(str(f.joint) for f in group)}",
        )
        out = [f for f in out if f not in group] + [one]
    return tuple(sorted(out, key=lambda f: -f.gain))


def standard_errors(best: Fit) -> list[Errors]:
    """Per effect: standard errors of each parameter's components."""
    rows = len(best.workspace.balances.rows)
    time = best.workspace.time
    blocks = np.tile(((time - time[0]) / SCORE_BLOCK).astype(int), rows)
    deviation = np.sqrt(np.maximum(np.diag(covariance(best, blocks)), 0.0))
    out: list[Errors] = [{} for _ in best.effects]
    for slot, std in zip(best.slots, deviation, strict=True):
        out[slot.effect].setdefault(slot.param.name, []).append(float(std))
    return out


def _parameters(
    planned: Planned, spread: dict[str, list[float]], listed: Planned | None, prismatic: bool
) -> dict[str, Fitted | str]:
    out: dict[str, Fitted | str] = {}
    for param in planned.effect.params:
        value: Any = planned.values[param.name]
        unit = param.unit_at(prismatic)
        if listed is not None and param.size == 1:
            value = value - listed.values[param.name]
        std = spread.get(param.name, [0.0])
        numbers = [value] if param.size == 1 else list(value)
        at_bound = any(np.isclose(v, (param.low, param.high), rtol=1e-9).any() for v in numbers)
        if param.size == 1:
            out[param.name] = Fitted(float(value), std[0], unit, at_bound)
        else:
            out[param.name] = Fitted(tuple(float(v) for v in value), tuple(std), unit, at_bound)
    for word in planned.effect.words:
        chosen = planned.values.get(word.name)
        if chosen is not None:
            out[word.name] = str(chosen)
    return out


def _hidden_by_refit(selection: Selection, k: int) -> bool:
    """Whether freeing the nominal numbers altogether would absorb most of what the effect explains."""
    best = selection.best
    workspace = best.workspace
    without = [e for i, e in enumerate(best.effects) if i != k]
    free = len(workspace.nuisance)
    if not free:
        return False
    rest = workspace.residual(without)
    freed = np.array([number.of_the_robot for number in workspace.nuisance], dtype=float)
    y, normal = rest * workspace.weights, workspace.gram - np.diag(freed)
    ridge = 1e-6 * np.trace(normal) / free * np.eye(free)
    pull = np.linalg.solve(normal + ridge, workspace.pull(rest))
    absorbed = y - workspace.along(pull) * workspace.weights
    own = best.y * workspace.weights
    here, refit = float(y @ y - own @ own), float(y @ y - absorbed @ absorbed)
    return refit > 0.9 * here > 0.0


def within_tolerance(best: Fit) -> tuple[WithinTolerance, ...]:
    """Nominal numbers that the data show to be off by less than would make them a cause."""
    return tuple(shown for shown, deviations in _off(best) if abs(deviations) <= BELIEVED)


def not_believed(best: Fit) -> tuple[str, ...]:
    """Notes on nominal numbers that would have to be far off: something else is wrong there."""
    return tuple(
        f"{shown.effect} on {shown.joint} would have to be {deviations:+.1f} times its tolerance off to make"
        " the balances smaller: not believed, something else is wrong there"
        for shown, deviations in _off(best)
        if abs(deviations) > BELIEVED
    )


def _off(best: Fit) -> list[tuple[WithinTolerance, float]]:
    """Actuators' numbers that the data show to be off, and by how many prior deviations."""
    workspace = best.workspace
    pull, error = -workspace.deviations(best.y), workspace.deviation_errors()
    found = {e.key for e in best.effects}
    out = []
    for number, value, std in zip(workspace.nuisance, pull, error, strict=True):
        if (
            number.joint is None
            or abs(value) < max(NOTABLE * std, 0.25)
            or (number.name, number.joint) in found
        ):
            continue
        change = float(value) * number.spread
        name = number.name
        if name == "motor_damping":
            name, change = "motor_viscous_friction", change * workspace.robot.joint(number.joint).drive.D_m
        elif name not in ("spring_stiffness", "spring_damping", "motor_inertia"):
            continue
        out.append((WithinTolerance(name, number.joint, change), float(value)))
    return out


def not_excited(selection: Selection, candidates: Sequence[Candidate]) -> tuple[tuple[str, str | None], ...]:
    """Effects that this recording could not have shown unless they were large."""
    seen: set[tuple[str, str | None]] = set()
    for scored in (*selection.scan, *selection.last_scan):
        needed = np.sqrt(DETECTABLE) / max(scored.sight, 1e-9)
        limit = 1.5 if scored.trace.kind == "whole" else SEEN_SHARE / 0.05
        if needed <= limit:
            seen.add(scored.candidate.key)
    named = {e.key for e in selection.best.effects}
    return tuple(dict.fromkeys(c.key for c in candidates if c.key not in seen and c.key not in named))


def ranking(selection: Selection) -> tuple[Ranked, ...]:
    """Every candidate alone on the nominal model: share of its energy that it removes, to first order."""
    whole = max(selection.nothing.energy, 1e-300)
    out: list[Ranked] = []
    for scored in selection.scan:
        planned = scored.planned()
        out.append(
            Ranked(
                planned.effect.name,
                planned.joint,
                float(np.clip(scored.removes / whole, 0.0, 1.0)),
                planned.values,
            )
        )
    return tuple(out)
