"""From a selected set of effects to a diagnosis: verdict, findings, ties, tolerances, what was not seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.regression.nuisance import NominalNumber
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.regression.uncertainty import Errors, standard_errors
from flexjoint.diagnosis.result import Finding, Fitted, Ranked, WithinTolerance
from flexjoint.diagnosis.result.wording import cause
from flexjoint.diagnosis.search.candidates import Candidate, jump_times
from flexjoint.diagnosis.search.criteria import (
    needs_implausible,
)
from flexjoint.diagnosis.search.selection import Key, Selection
from flexjoint.diagnosis.signals.signals import Readings
from flexjoint.diagnosis.verdict.instead import paired
from flexjoint.diagnosis.verdict.reliability import left_by, on_background, reliability, where_held
from flexjoint.diagnosis.verdict.ties import preferred, special_cases, ties
from flexjoint.diagnosis.verdict.unseen.torques import Unseen, friction, remaining, removed, spoils
from flexjoint.effects import Kind, Planned, Site


def findings(
    selection: Selection,
    gains: Sequence[float],
    data: Unseen,
    simulated: Callable[[int, int], float],
    spread: Mapping[Key, Errors] | None = None,
) -> tuple[Finding, ...]:
    """The chosen effects as findings, the largest gain first; `spread` replaces their standard errors.
    `simulated` tells how far the simulation supports effect k, beside so many convincing ones on its joint:
    it takes long, and is asked where the balances do not convince."""
    best = selection.best
    if not best.effects:
        return ()
    errors = standard_errors(best)
    joints, limits = remaining(data), best.settings.verdict
    sliding = best.problem.robot.prismatic
    out: list[Finding] = []
    cleared = [removed(data, k) for k in range(len(best.effects))]
    rubbing = [friction(data, e.joint) if _rubs_more(best, e) else None for e in best.effects]
    convincing = [
        on_background(one, joints, limits, friction=together) >= limits.likely
        for one, together in zip(cleared, rubbing, strict=True)
    ]
    for k, planned in enumerate(best.effects):
        # what every machine has, or a sensor adds to its reading, is no rival of what moves the joint
        beside = sum(
            there and e.joint == planned.joint and not e.effect.ordinary and e.effect.site is not Site.SENSOR
            for e, there in zip(best.effects, convincing, strict=True)
        )
        listed = next((e for e in best.problem.nominal if e.key == planned.key), None)
        rivals = selection.rivals[k] if k < len(selection.rivals) else ()
        rivals = tuple(rival for rival in rivals if not needs_implausible(rival, best))
        tied = ties(best, planned, rivals, selection.explains.get(planned.key))
        own = next((one for one in joints if one.joint == planned.joint), None)
        simpler = special_cases(best, planned, own)
        known = {(tie.effect, tie.joint) for tie in simpler}
        tied = (*simpler, *(tie for tie in tied if (tie.effect, tie.joint) not in known))
        left, share = left_by(best, k)
        believed = reliability(best, left, share, k)
        if not spoils(data, k):
            believed = max(believed, on_background(cleared[k], joints, limits, beside, rubbing[k]))
        believed = where_held(believed, cleared[k], limits)
        if believed < limits.likely:
            believed = max(believed, simulated(k, beside))
        if _jumped(best.problem, planned):
            believed = max(believed, limits.jumped)
        out.append(
            Finding(
                planned.effect.name,
                planned.joint,
                preferred(best, planned, rivals, tied) * believed,
                _parameters(
                    planned, (spread or {}).get(planned.key, errors[k]), listed, planned.joint in sliding
                ),
                _since(planned, best.problem.readings),
                gains[k],
                str(planned.effect.kind),
                planned,
                tied[: limits.most_ties],
                hidden_by_refit=_hidden_by_refit(selection, k),
                note="change against the nominal model's own entry" if listed is not None else "",
                left=left,
                reliability=believed,
                removed=cleared[k],
                during=_during(planned, best.problem.readings),
            )
        )
    return tuple(sorted(out, key=lambda f: -f.gain))


def _jumped(problem: Problem, planned: Planned) -> bool:
    """Whether an effect sets in where its channel's reading jumps: what it does to torques may be small."""
    if not planned.effect.jumps or planned.joint is None or planned.since is None:
        return False
    period = problem.readings.period
    return any(abs(at - planned.since) <= period for at in jump_times(problem, planned.effect, planned.joint))


def _since(planned: Planned, readings: Readings) -> float | None:
    """[s] when an effect set in, on the recording's clock; None where it was always there."""
    return None if planned.since is None else readings.start + max(planned.since, 0.0)


def _during(planned: Planned, readings: Readings) -> tuple[tuple[float, float | None], ...]:
    """[s] when an effect acts that ceases during the recording, on that recording's clock."""
    if not planned.switches:
        return ()
    start = readings.start
    return tuple((start + max(a, 0.0), start + b if math.isfinite(b) else None) for a, b in planned.during)


def _rubs_more(best: Fit, planned: Planned) -> bool:
    """Whether an effect is ordinary friction, or a rotor, beyond the nominal model's, which every drive has;
    that of a machine with less friction is as remarkable as any other cause."""
    listed = next((e for e in best.problem.nominal if e.key == planned.key), None)
    known = {} if listed is None else listed.values
    return planned.effect.ordinary and all(
        planned.values[p.name] > known.get(p.name, 0.0) for p in planned.effect.nulls
    )


def merged(found: Sequence[Finding], candidates: Sequence[Candidate], best: Fit) -> tuple[Finding, ...]:
    """The findings, with a timing cause that several joints have, with equal values, as one finding of the
    robot where no joint that can have it speaks against that value, and a law that takes the place of a
    nominal one as one finding of the joint."""
    settings = best.settings.verdict
    out = list(paired(found, best.problem.nominal))
    groups: dict[object, list[Finding]] = {}
    for f in found:
        if f.kind == Kind.TIMING and f.joint is not None:
            words = tuple(f.planned.values.get(w.name) for w in f.planned.effect.words)
            groups.setdefault((f.effect, words), []).append(f)
    for group in groups.values():
        effect, words = group[0].effect, tuple(v for v in group[0].parameters.values() if isinstance(v, str))
        if len(group) == 1 or any(f.since is not None for f in group):
            continue
        name = group[0].planned.effect.nulls[0].name
        fitted = [p for p in (f.parameters[name] for f in group) if isinstance(p, Fitted)]
        values = np.array([np.ravel(p.value)[0] for p in fitted])
        weights = np.array([max(float(np.ravel(p.std)[0]), 1e-12) ** -2.0 for p in fitted])
        mean = float(np.sum(weights * values) / np.sum(weights))
        if np.any(np.abs(values - mean) * np.sqrt(weights) > settings.same):
            continue
        have = {f.joint for f in group}
        others = [
            c.planned({name: mean})
            for c in candidates
            if c.effect.name == effect and tuple(v for _, v in c.words) == words and c.joint not in have
        ]
        if not all(_may_be(best, one) for one in others):
            continue
        silent = f"; nothing speaks against it at {', '.join(str(e.joint) for e in others)}" if others else ""
        shared = {**group[0].parameters, name: Fitted(mean, float(np.sum(weights) ** -0.5), "s")}
        one = replace(
            group[0],
            joint=None,
            parameters=shared,
            gain=min(1.0, sum(f.gain for f in group)),
            # what each joint tells of it is told by itself
            probability=1.0 - math.prod(1.0 - f.probability for f in group),
            members=(*(f.planned.with_values({name: mean}) for f in group), *others),
            indistinguishable=(),
            note=f"shared by {', '.join(str(f.joint) for f in group)}{silent}",
        )
        out = [f for f in out if f not in group] + [one]
    return tuple(sorted(out, key=lambda f: -f.gain))


def _may_be(best: Fit, added: Planned) -> bool:
    """Whether an effect of this size beside a set contradicts the data by no more than chance."""
    effects = [*best.effects, added]
    there = fit(best.problem, effects, held=[added], changed=added)
    return there.energy - best.energy <= best.settings.verdict.same**2


def _parameters(
    planned: Planned, spread: dict[str, list[float]], listed: Planned | None, prismatic: bool
) -> dict[str, Fitted | str]:
    out: dict[str, Fitted | str] = {}
    for param in planned.effect.params:
        value: Any = planned.values[param.name]
        unit = param.unit_at(prismatic)
        std = spread.get(param.name, [0.0])
        bounds = param.bounds(listed is not None)
        at_bound = any(np.isclose(v, bounds, rtol=1e-9).any() for v in np.ravel(value))
        if listed is not None and param.size == 1:
            value = value - listed.values[param.name]
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
    """Whether nominal numbers without any tolerance would explain most of what the effect explains."""
    best = selection.best
    problem = best.problem
    without = [e for i, e in enumerate(best.effects) if i != k]
    free = len(problem.nuisance)
    if not free:
        return False
    rest = problem.residual(without)
    freed = np.array([number.of_the_robot for number in problem.nuisance], dtype=float)
    y, normal = rest * problem.weights, problem.gram - np.diag(freed)
    ridge = 1e-6 * np.trace(normal) / free * np.eye(free)
    pull = np.linalg.solve(normal + ridge, problem.pull(rest))
    absorbed = y - problem.along(pull) * problem.weights
    own = best.y * problem.weights
    here, refit = float(y @ y - own @ own), float(y @ y - absorbed @ absorbed)
    return refit > best.settings.verdict.hidden * here > 0.0


def within_tolerance(best: Fit) -> tuple[WithinTolerance, ...]:
    """Nominal numbers that the data show to deviate by less than would make them a cause."""
    return tuple(off.shown for off in _off(best) if off.believed)


def not_believed(best: Fit) -> tuple[str, ...]:
    """Notes on nominal numbers that would have to deviate implausibly far: something else is wrong there. Of
    friction that the model claims any deviation is plausible."""
    return tuple(
        f"{cause(off.shown.effect, off.shown.joint)} would have to be off by {off.deviations:+.1f} times its"
        " tolerance to make the balances smaller: this is not plausible, so something else is wrong there"
        for off in _off(best)
        if not (off.believed or off.number.claims_friction)
    )


def to_state(best: Fit, found: Sequence[Finding]) -> tuple[str, ...]:
    """Notes on motors that turn with two joints, and how a robot file states it: their inertia acts on both
    joints, too, which no friction says. What the file says of a joint's motor is then that of the motor."""
    robot, notes = best.problem.robot, []
    for finding in found:
        if not finding.planned.effect.reaches_before or finding.probability < best.settings.verdict.likely:
            continue
        own = robot.joint_names.index(str(finding.joint))
        if any(own in coupling.joints for coupling in robot.couplings):
            continue
        shares = [part.effect.shares(part.p) for part in finding.planned.parts]
        rows = [f"[{before:g}, {share:g}]" for share, before in shares]
        matrix = ", ".join(rows if len(rows) > 1 else ["[1, 0]", *rows])
        before = robot.joint_names[own - 1]
        notes.append(
            f"{cause(finding.effect, finding.joint)}: what turns with {before}, too, has inertia on both"
            " joints as well; state that in the robot file and diagnose again:"
            f" `couplings: [{{joints: [{before}, {finding.joint}], matrix: [{matrix}]}}]`. motor_inertia,"
            " motor_damping and torque_limit of these joints are then those of the motors: restate them"
        )
    return tuple(notes)


@dataclass(frozen=True)
class _Off:
    """A nominal number that the data show to deviate, and by how many prior deviations."""

    number: NominalNumber
    shown: WithinTolerance
    deviations: float
    believed: bool


def _off(best: Fit) -> list[_Off]:
    """Those of actuators and of the ordinary friction that the model claims."""
    problem = best.problem
    pull, error = -problem.deviations(best.y), problem.deviation_errors()
    found, limits = {e.key for e in best.effects}, best.settings.verdict
    claimed = {e.key: e for e in problem.robot.effects}
    out = []
    for number, value, std in zip(problem.nuisance, pull, error, strict=True):
        if (
            number.joint is None
            or abs(value) < max(limits.notable * std, limits.least_off)
            or (number.name, number.joint) in found
        ):
            continue
        change = float(value) * number.std
        name, parameter, claim = number.name, "scale", None
        if name == "motor_damping":
            name, parameter = "motor_viscous_friction", "coefficient"
            claim = problem.robot.joint(number.joint).drive.D_m
        elif number.claims_friction:
            parameter, claim = number.of, claimed[name, number.joint].values[number.of]
        elif name not in ("spring_stiffness", "spring_damping", "motor_inertia"):
            continue
        if claim is not None:  # of a friction, which is not less than none
            change = max(change, -1.0) * claim
        shown = WithinTolerance(name, number.joint, parameter, change)
        out.append(_Off(number, shown, float(value), abs(value) <= limits.believed))
    return out


def not_excited(selection: Selection, candidates: Sequence[Candidate]) -> tuple[tuple[str, str | None], ...]:
    """Effects that this recording would show only if they were large; none where no scan came to its end."""
    if selection.left_out and not selection.scan:
        return ()
    limits, search = selection.best.settings.verdict, selection.best.settings.search
    seen: set[tuple[str, str | None]] = set()
    for scored in (*selection.scan, *selection.last_scan):
        needed = np.sqrt(limits.detectable) / max(scored.sight, 1e-9)
        limit = (
            search.most_amplitude if scored.trace.kind == "whole" else limits.seen_share / search.trial_share
        )
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
