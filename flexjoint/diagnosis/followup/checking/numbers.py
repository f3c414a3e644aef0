"""Whether the numbers of known causes have moved: a refit of them against what they were, in the standard
errors of both, with as many chances counted as there are numbers.

Of a recording of few blocks of time a standard error is itself known poorly, so distances are judged by
Student's t with as many degrees of freedom as blocks. `false_discovery_control` (Benjamini and Hochberg 1995)
holds the chance that any of the numbers of an unchanged machine counts as moved.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import false_discovery_control
from scipy.stats import t as student

from flexjoint.diagnosis.followup.checking.values import CheckedCause, CheckedNumber, State
from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.regression.uncertainty import Errors, certainty, standard_errors
from flexjoint.diagnosis.result.known import Known
from flexjoint.diagnosis.settings import CheckSettings
from flexjoint.effects import Planned

UNSEEN = 1e100  # what a pseudo-inverse makes of a number without a trace is larger


def checked(known: Known, best: Fit) -> tuple[CheckedCause, ...]:
    """The known causes, each with its numbers before and now; `best` is the refit of those of which the
    recording shows something."""
    limits, errors = best.settings.check, _errors(best)
    freedom = _freedom(best)
    refit = {now.key: (now, spread) for now, spread in zip(best.effects, errors, strict=True)}
    found = [(was, *refit.get(was.key, (was, _endless(was)))) for was in known.causes]
    numbers = [_numbers(best, was, now, spread, limits) for was, now, spread in found]
    named = [was.key in known.named for was in known.causes]
    chances = [_chance(n, freedom) for own, there in zip(numbers, named, strict=True) if there for n in own]
    far = iter(false_discovery_control(chances) <= limits.chance if chances else ())
    out = []
    for (was, now, spread), own, there in zip(found, numbers, named, strict=True):
        marked = tuple(_marked(n, bool(next(far)), limits) for n in own) if there else own
        moved = any(n.moved for n in marked) and _back_costs(best, was) >= best.settings.verdict.sure**2
        if not moved:
            marked = tuple(n.as_moved(False) for n in marked)
        state = _state(best, was, now, spread, moved)
        out.append(CheckedCause(was.effect.name, was.joint, state if there else "not tested", marked))
    return tuple(out)


def _back_costs(best: Fit, was: Planned) -> float:
    """Energy by which a cause's old numbers explain the recording worse than the refitted ones, the other
    causes' kept. It is more than the squared distance in standard errors where all is linear; where a law is
    bent, or the refit stopped beside a flat place, it may be nothing."""
    problem = best.problem
    back = [was if e.key == was.key else e for e in best.effects]
    old, new = (problem.energy(problem.residual(effects)) for effects in (back, best.effects))
    return old - new


def _endless(cause: Planned) -> Errors:
    """The standard errors of what a recording does not show."""
    return {p.name: [np.inf] * p.size for p in cause.effect.params}


def _numbers(
    best: Fit, was: Planned, now: Planned, spread: Errors, limits: CheckSettings
) -> tuple[CheckedNumber, ...]:
    sliding = was.joint in best.problem.robot.prismatic
    out = []
    for param in was.effect.params:
        before, after = (np.ravel(e.values[param.name]).astype(float) for e in (was, now))
        std = np.array(spread[param.name])
        known = was.std.get(param.name)
        # a source without errors: as if a recording like this one had told
        before_std = limits.unknown_error * std if known is None else np.array(known)
        for k in range(param.size):
            change = after[k] - before[k]
            if param.wraps:
                change = float(np.angle(np.exp(1j * change)))
            joined = float(np.hypot(std[k], before_std[k]))
            out.append(
                CheckedNumber(
                    param.name if param.size == 1 else f"{param.name}[{k}]",
                    float(before[k]),
                    float(before_std[k]),
                    float(before[k] + change),
                    float(std[k]),
                    param.unit_at(sliding),
                    float(abs(change) / max(joined, 1e-300)) if np.isfinite(joined) else 0.0,
                )
            )
    return tuple(out)


def _errors(best: Fit) -> list[Errors]:
    """Standard errors of the refit; infinite where it leaves no trace of a number."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors = standard_errors(best)
    return [
        {name: [x if 0.0 < x < UNSEEN else np.inf for x in std] for name, std in own.items()}
        for own in errors
    ]


def _freedom(best: Fit) -> float:
    """Degrees of freedom of the standard errors: blocks of time."""
    time = best.problem.time
    blocks = int((time[-1] - time[0]) / best.settings.regression.time_block)
    return max(best.settings.check.freedom, blocks - 1.0)


def _chance(number: CheckedNumber, freedom: float) -> float:
    """Probability that an unchanged number is that far off."""
    return float(2.0 * student.sf(number.distance, freedom))


def _marked(number: CheckedNumber, moved: bool, limits: CheckSettings) -> CheckedNumber:
    """The number with whether it has moved, beyond chance and beyond what two ways of fitting differ by."""
    change = abs(number.now - number.was)
    matters = change > limits.least_move * max(abs(number.was), abs(number.now))
    return number.as_moved(moved and matters)


def _state(best: Fit, was: Planned, now: Planned, spread: Errors, moved: bool) -> State:
    """Whether a cause is there, has moved or is gone, or whether this recording cannot tell."""
    sure = best.settings.verdict.sure
    if moved:
        return "gone" if certainty(best, now, spread) < sure else "moved"
    shown = max(certainty(best, e, spread) for e in (was, now)) >= sure
    return "there" if shown else "not seen"


def unseen(causes: Sequence[CheckedCause]) -> tuple[CheckedCause, ...]:
    """Causes whose size this recording could not tell from none."""
    return tuple(c for c in causes if c.state == "not seen")
