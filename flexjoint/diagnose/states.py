"""Internal states of effects along a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flexjoint.effect import Planned, Signals


def state_along(e: Planned, signals: Signals, period: float, begin: int) -> np.ndarray:
    """(N,) an effect's state on signals (N,) sampled every `period` seconds, usable from sample `begin` on.

    Rates are affine in the state, so that each step is exact for signals held over it; a step sees the mean
    of both its ends, as a state would otherwise lag by half a sample."""
    one, held = np.ones_like(signals.phi), {}
    for name in ("dq", "dtheta", "dphi"):
        # before it the filter sees the record's edge, and a state would keep what that does
        held[name] = getattr(signals, name) * one
        held[name][:begin] = held[name][begin]
    signals, p = replace(signals, **held), e.p
    offset = e.effect.rate(signals, p, 0.0 * one) * one
    decay = offset - e.effect.rate(signals, p, one)
    offset, decay = _mean_of_ends(offset), _mean_of_ends(decay)
    keep = np.exp(-np.clip(decay, 0.0, 1e5) * period)
    gain = np.where(decay * period < 1e-6, period, (1.0 - keep) / np.maximum(decay, 1e-12))
    z, out = float(e.effect.states[0]), []
    for k, a in zip(keep.tolist(), (gain * offset).tolist(), strict=True):
        out.append(z)
        z = k * z + a
    return np.array(out)


def _mean_of_ends(x: np.ndarray) -> np.ndarray:
    """(N,) mean of each sample and its next, from (N,)."""
    return np.append(0.5 * (x[:-1] + x[1:]), x[-1:])
