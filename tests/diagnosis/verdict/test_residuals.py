"""On which signal a leftover depends."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from flexjoint.diagnosis.verdict.residuals import depends_on

T = np.arange(0.0, 12.0, 0.002)
Signals = Mapping[str, np.ndarray]


def motion(*lines: tuple[float, float]) -> Signals:
    """A joint's signals along a sum of sines (amplitude [rad], frequency [Hz])."""
    omega = [2.0 * np.pi * f for _, f in lines]
    q = sum(a * np.sin(w * T + k) for k, ((a, _), w) in enumerate(zip(lines, omega, strict=True)))
    dq = sum(a * w * np.cos(w * T + k) for k, ((a, _), w) in enumerate(zip(lines, omega, strict=True)))
    return {"q": np.asarray(q), "dtheta": np.asarray(dq), "t": T}


RICH = motion((0.5, 0.31), (0.3, 0.83), (0.1, 1.97))
REPEATED = motion((0.5, 0.5))


@pytest.mark.parametrize("signals", [RICH, REPEATED], ids=["rich", "repeated"])
@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (lambda s: np.tanh(s["dtheta"] / 0.1), "dtheta"),
        (lambda s: s["q"] ** 2 - 0.3 * s["q"], "q"),
        (lambda s: 0.8 * np.exp(-s["t"] / 4.0), "t"),
        (lambda s: 0.4 * np.sin(2.0 * np.pi * 7.31 * s["t"] + 0.4), "t"),  # something else turns nearby
    ],
    ids=["friction", "position", "warming", "oscillation"],
)
def test_the_signal_of_a_leftover_is_told(
    law: Callable[[Signals], np.ndarray], expected: str, signals: Signals
) -> None:
    noise = 0.05 * np.random.default_rng(3).standard_normal(T.size)
    assert depends_on(law(signals) + noise, signals) == expected
