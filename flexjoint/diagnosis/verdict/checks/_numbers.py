"""Numbers of a finding as they are reported, and how many standard errors they are from none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.regression.fit import Fit
from flexjoint.diagnosis.result import Estimation, Finding, Fitted
from flexjoint.effects import Parameter
from flexjoint.model.parameters import labels


def distance(
    best: Fit, finding: Finding, param: Parameter, estimation: Estimation, shapes: Sequence[Parameter]
) -> float:
    """Distance of a number from the value at which its effect is absent, in the standard errors that it has
    with some shape parameters fixed."""
    listed = {e.key for e in best.problem.nominal}  # of these the change is reported
    null = 0.0 if finding.planned.key in listed else param.null
    if null is None or not isinstance(finding.parameters[param.name], Fitted):
        return 0.0
    value, std = fitted_number(finding, param)
    if shapes:
        tight = correlation(finding, estimation, [param, *shapes])
        own, k = np.eye(len(tight), dtype=bool)[0], param.size
        if k == 1:
            across, within = tight[own][:, ~own][0], tight[~own][:, ~own]
            std = std * np.sqrt(max(1e-6, 1.0 - float(across @ np.linalg.pinv(within) @ across)))
    return float(np.max(np.abs(value - null) / np.maximum(std, 1e-300)))


def fitted_number(finding: Finding, param: Parameter) -> tuple[np.ndarray, np.ndarray]:
    """A number, or the entries of a position, and their standard errors."""
    fitted = finding.parameters[param.name]
    assert isinstance(fitted, Fitted)
    return np.ravel(fitted.value), np.ravel(fitted.std)


def correlation(finding: Finding, estimation: Estimation, params: Sequence[Parameter]) -> np.ndarray:
    """Correlation of the errors of some of a finding's numbers."""
    names = [name for p in params for name in labels(finding.planned, p.name, p.size)]
    at = [estimation.parameters.index(name) for name in names]
    return estimation.correlation[np.ix_(at, at)]
