"""Findings that are not to be named as they are: a rival fits better, the simulation does not tell them from
none, or their law is finer than its numbers are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnose.fit import Fit
from flexjoint.diagnose.verdict import SURE
from flexjoint.diagnosis import Estimation, Finding, Fitted
from flexjoint.effect import Param, numbers_beyond
from flexjoint.parameters import labels

PROBABLE = 0.1  # probability, ties together, below which a cause is not named


def improbable(found: Sequence[Finding]) -> tuple[Finding, ...]:
    """Findings that a rival fits better than: the set explains something, but not by this name."""
    return tuple(
        f for f in found if f.probability / f.reliability * (1 + len(f.indistinguishable)) < PROBABLE
    )


def vanishing(best: Fit, found: Sequence[Finding], estimation: Estimation | None) -> tuple[Finding, ...]:
    """Findings, where they were refined on the simulation, of which no number, as it is reported, differs
    from its absence by SURE standard errors: where friction rests, the curvature of a balance can promise
    what a simulation does not keep. A law's shape is held: it means nothing where the law is absent."""
    if estimation is None or estimation.method != "output_error":
        return ()
    out = []
    for f in found:
        shapes = [p for p in f.planned.effect.params if p.null is None]
        distance = [_distance(best, f, param, estimation, shapes) for param in f.planned.effect.nulls]
        if max(distance, default=SURE) < SURE:
            out.append(f)
    return tuple(out)


def finer(best: Fit, found: Sequence[Finding], estimation: Estimation | None) -> tuple[Finding, ...]:
    """Findings that are a simpler law with numbers added of which none is known to be there, or the numbers
    added without that law (a static friction where nothing rubs), or with numbers apart that are not known to
    differ."""
    return tuple(f for f in found if estimation is not None and _finer(best, f, estimation))


def _finer(best: Fit, finding: Finding, estimation: Estimation) -> bool:
    effect = finding.planned.effect
    if effect.alike:
        one, other = (param for param in effect.params if param.name in effect.alike)
        (x, std), (y, other_std) = (_fitted(finding, param) for param in (one, other))
        correlation = _correlation(finding, estimation, [one, other])[0, 1]
        spread = std**2 + other_std**2 - 2.0 * correlation * std * other_std
        return bool((x - y)[0] ** 2 < SURE**2 * spread[0])
    shapes = [p for p in effect.params if p.null is None and p.size == 1 and not p.wraps]
    if effect.contains and any(_any_shape(finding, p) for p in shapes):
        return True
    for name in effect.contains:
        added = numbers_beyond(effect, name)
        parts = [added, [p for p in effect.nulls if p not in added]] if added else []
        if any(all(_distance(best, finding, p, estimation, ()) < SURE for p in part) for part in parts):
            return True
    return False


def _any_shape(finding: Finding, shape: Param) -> bool:
    """Whether a law's shape may as well be at its bound, where the law is a simpler one."""
    value, std = _fitted(finding, shape)
    return bool(value[0] - std[0] <= shape.low or value[0] + std[0] >= shape.high)


def _distance(
    best: Fit, finding: Finding, param: Param, estimation: Estimation, shapes: Sequence[Param]
) -> float:
    """Distance of a number from its absence, in standard errors that it has where some shapes are held."""
    listed = {e.key for e in best.workspace.nominal}  # of these the change is reported
    null = 0.0 if finding.planned.key in listed else param.null
    if null is None or not isinstance(finding.parameters[param.name], Fitted):
        return 0.0
    value, std = _fitted(finding, param)
    if shapes:
        tight = _correlation(finding, estimation, [param, *shapes])
        own, k = np.eye(len(tight), dtype=bool)[0], param.size
        if k == 1:
            across, within = tight[own][:, ~own][0], tight[~own][:, ~own]
            std = std * np.sqrt(max(1e-6, 1.0 - float(across @ np.linalg.pinv(within) @ across)))
    return float(np.max(np.abs(value - null) / np.maximum(std, 1e-300)))


def _fitted(finding: Finding, param: Param) -> tuple[np.ndarray, np.ndarray]:
    fitted = finding.parameters[param.name]
    assert isinstance(fitted, Fitted)
    return np.ravel(fitted.value), np.ravel(fitted.std)


def _correlation(finding: Finding, estimation: Estimation, params: Sequence[Param]) -> np.ndarray:
    """Correlation of the errors of some of a finding's numbers."""
    names = [name for p in params for name in labels(finding.planned, p.name, p.size)]
    at = [estimation.parameters.index(name) for name in names]
    return estimation.correlation[np.ix_(at, at)]
