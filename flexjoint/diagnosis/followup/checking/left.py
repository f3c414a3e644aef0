"""Whether what the known causes leave is still as small, and as free of a shape, as it was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.deviations import deviation_effects
from flexjoint.diagnosis.regression.fit import Fit, fit
from flexjoint.diagnosis.result import Remaining
from flexjoint.diagnosis.result.known import Known
from flexjoint.diagnosis.settings import Settings
from flexjoint.diagnosis.verdict.unseen.torques import View, away, in_views, remaining, standing_out


def left_by(best: Fit, nothing: Fit | None = None) -> tuple[Remaining, ...]:
    """The torque error of each joint with the causes at work. `nothing`, the fit without any, gives the
    error before them; without it that is not told apart."""
    problem = best.problem
    after = _series(best)
    before = after if nothing is None else _series(nothing)
    return remaining(in_views(View(problem, away(problem), before, after), best.effects, singly=False))


def _series(best: Fit) -> np.ndarray:
    """(rows, N) residual of all balances [N m] on usable samples, nominal numbers where their tolerances let
    them be."""
    problem = best.problem
    numbers = problem.deviations(best.y)  # to first order: their products are small where a machine is known
    effects = problem.with_nominal([*best.effects, *deviation_effects(problem, numbers)])
    series = problem.balances.residual_torques(effects) - problem.jumped(numbers)
    return np.asarray(series[:, problem.readings.valid])


def without(best: Fit) -> Fit:
    """The nominal model alone, at the same noise level."""
    return fit(best.problem, ())


def levels(best: Fit, together: bool = False) -> dict[str, float]:
    """By joint: the whitened variance that is left of its balances, in that of the sensors' noise, where
    nominal numbers are plausible; `together`: the mean of all."""
    problem = best.problem
    if together:
        return dict.fromkeys(problem.robot.joint_names, float(np.mean(problem.level.inflation)))
    own: dict[str, list[float]] = {}
    for row, variance in zip(problem.balances.rows, problem.level.inflation, strict=True):
        own.setdefault(problem.robot.joint_names[row.joint], []).append(float(variance))
    return {joint: float(np.mean(variances)) for joint, variances in own.items()}


def grown(known: Known, best: Fit, now: Sequence[Remaining]) -> dict[str, str]:
    """Joints of which more is left than was, each with the reason in words. Where it is not known what was
    left, joints at which a cause without a name is at work (`standing_out`)."""
    settings = best.settings
    if not known.measured:
        return {
            joint.joint: f"leaves a shape of {joint.against} that its causes do not explain"
            for joint in standing_out(now, settings.verdict)
        }
    out = {}
    if known.level is not None:
        most = settings.check.level * max(1.0, known.level)
        # where each joint has a level of its own, a joint's own may be far above the mean that is known
        for joint, level in levels(best, together=known.robust).items():
            if level > most:
                out[joint] = (
                    f"what is left has {level:.3g} times the variance of its sensors' noise,"
                    f" {known.level:.3g} had been left"
                )
    for left in now:
        before = known.remaining.get(left.joint)
        why = "" if before is None else _more(left, before, known.robot.tolerance.torque, settings)
        if why:
            out[left.joint] = why
    return out


def _more(now: Remaining, was: Remaining, tolerance: float, settings: Settings) -> str:
    limits = settings.check
    # errors grow with the load, or do not: neither is a change of the machine
    scale = max(1.0, now.torque / max(was.torque, 1e-300))
    usual = limits.grown * scale * beyond_noise(was)
    size, shape = (max(usual, share * tolerance * now.torque) for share in (limits.size, limits.shape))
    if beyond_noise(now) > size and now.after > settings.verdict.above_noise * now.noise:
        return f"{now.after:.3g} are left of its torque of {now.torque:.3g}, at most {size:.3g} were expected"
    known_shape = limits.grown * scale * was.structured
    if now.structured > max(shape, limits.shape_noise * now.noise, known_shape):
        return f"what is left has a shape of {now.against} that was not there"
    return ""


def beyond_noise(left: Remaining) -> float:
    """What is left of a joint without what its sensors' noise makes."""
    return float(np.sqrt(max(0.0, left.after**2 - left.noise**2)))
