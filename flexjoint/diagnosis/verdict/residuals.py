"""What the chosen causes leave: in which balance, how much, and on which signal it depends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.signal import periodogram

from flexjoint.diagnosis.regression.deviations import deviation_effects
from flexjoint.diagnosis.regression.fit import Fit, nominal_deviations
from flexjoint.diagnosis.result import ResidualView, Unexplained
from flexjoint.diagnosis.settings import USUAL
from flexjoint.effects import Planned, Site

FINER = 4  # times finer than the resolution of the recording, for a frequency
NEIGHBOURS = ("q", "tau_t")  # signals of a neighbour that may leave a trace: a cable over two joints
KNOTS = 8  # of the spline through which a residual is regressed on a signal


def residual_views(best: Fit, nothing: Fit) -> tuple[ResidualView, ...]:
    """Residual of every balance [N m] before and after, with the signals it may depend on. Encoder offsets
    that are free in each recording, and unknown torques between samples, are taken out of both."""
    problem = best.problem
    balances, used = problem.balances, problem.readings.valid
    first, last = nominal_deviations(nothing), nominal_deviations(best)
    offsets = [e for e in deviation_effects(nothing.problem, first) if e.effect.site is Site.SENSOR]

    def series(effects: Sequence[Planned], numbers: np.ndarray) -> np.ndarray:
        return (balances.residual_torques(effects) - problem.jumped(numbers))[:, used]

    before = series([*problem.nominal, *offsets], first)
    after = series(problem.with_nominal([*best.effects, *deviation_effects(problem, last)]), last)
    noise = problem.deviation
    out = []
    for row, old, new, expected in zip(balances.rows, before, after, noise, strict=True):
        joint = problem.robot.joints[row.joint]
        signals = problem.signals(joint.name)
        axes = {
            "dtheta": signals.dtheta,
            "q": signals.q,
            "tau_t": signals.tau_t,
            "phi": signals.phi,
            "tau_m": signals.tau_m,
            "tau_m_before": signals.tau_m_before,
            "tau_m_after": signals.tau_m_after,
            "t": signals.t,
        }
        for k in (row.joint - 1, row.joint + 1):  # a cable over two joints
            if 0 <= k < len(problem.robot.joints):
                other = problem.robot.joints[k].name
                axes |= {f"{name}.{other}": getattr(problem.signals(other), name) for name in NEIGHBOURS}
        axes = {name: x for name, x in axes.items() if name == "t" or np.ptp(x) > 0.0}
        out.append(ResidualView(joint.name, row.balance, signals.t, old, new, float(expected), axes))
    return tuple(out)


def explained_share(best: Fit, residuals: tuple[ResidualView, ...]) -> float:
    """Share of the squared error above noise that is gone, averaged over the balances that had one; 1 where
    none had."""
    problem, shares = best.problem, []
    for row, view in zip(problem.balances.rows, residuals, strict=True):
        first, left = (float(np.mean(x**2)) - view.noise**2 for x in (view.before, view.after))
        floor = problem.robot.tolerance.torque * float(problem.torque_scale[row.joint])
        if first > max(
            (problem.settings.verdict.clear * floor) ** 2, view.noise**2
        ):  # a balance that was clearly wrong
            shares.append(1.0 - float(np.clip(left / first, 0.0, 1.0)))
    return float(np.mean(shares)) if shares else 1.0


def unexplained_balances(best: Fit, residuals: tuple[ResidualView, ...]) -> tuple[Unexplained, ...]:
    """Balances whose residual exceeds the noise and the robot's torque tolerance. Where no cause was found
    and only implausible nominal numbers would explain the error, all of it counts as unexplained."""
    problem = best.problem
    implausible = not best.effects and problem.level.implausible > problem.settings.robust_search.begins
    found = []
    for row, seen in zip(problem.balances.rows, residuals, strict=True):
        view = replace(seen, after=seen.before) if implausible else seen
        left, first = float(np.sqrt(np.mean(view.after**2))), float(np.sqrt(np.mean(view.before**2)))
        # a mean is what offset-free recordings leave; what varies counts
        floor = problem.robot.tolerance.torque * float(problem.torque_scale[row.joint])
        beyond = np.sqrt(max(0.0, left**2 - view.noise**2))
        if beyond > floor and left > problem.settings.verdict.above_noise * view.noise:
            against = depends_on(view.after, view.signals, problem.settings.verdict.oscillation)
            share = float(min(1.0, (beyond / max(first, 1e-300)) ** 2))
            found.append(Unexplained(view.joint, view.balance, share, against))
    return tuple(sorted(found, key=lambda u: -u.share))


def depends_on(
    residual: np.ndarray, signals: Mapping[str, np.ndarray], oscillation: float = USUAL.verdict.oscillation
) -> str:
    """The signal on which a smooth curve explains most of the residual (R^2 of a spline regression); of time,
    a curve and an oscillation, which must explain a share `oscillation` more than any signal."""
    best, most = "t", -1.0
    for name, x in signals.items():
        if float(np.ptp(x)) <= 0.0:
            continue
        design = smooth_curve(x)
        share = explained_by(residual, design)
        if name == "t":
            # a motion that repeats itself oscillates, too: time must explain clearly more than its signals
            share = max(share, explained_by(residual, np.hstack([design, _line(residual, x)])) - oscillation)
        if share > most:
            best, most = name, share
    return best


def explained_by(residual: np.ndarray, design: np.ndarray) -> float:
    """R^2 of a regression of the residual on columns (N, k)."""
    fitted = design @ np.linalg.lstsq(design, residual, rcond=1e-9)[0]
    return 1.0 - float(np.sum((residual - fitted) ** 2)) / max(float(np.sum(residual**2)), 1e-300)


def _line(residual: np.ndarray, t: np.ndarray) -> np.ndarray:
    """(N, 2) cosine and sine of the residual's strongest frequency."""
    centred = residual - np.mean(residual)
    step = float(np.median(np.diff(t)))
    frequency, power = periodogram(centred, 1.0 / step, window="hann", nfft=FINER * residual.size)
    angle = 2.0 * np.pi * frequency[int(np.argmax(power))] * t
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def smooth_curve(x: np.ndarray) -> np.ndarray:
    """(N, k) B-splines of a signal (N,), knots at its quantiles: columns of a smooth law of it."""
    inner = np.unique(np.quantile(x, np.linspace(0.0, 1.0, KNOTS)))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return BSpline.design_matrix(np.clip(x, inner[0], inner[-1]), knots, 3).toarray()
