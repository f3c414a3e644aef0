"""Internal states of effects along a recording."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from flexjoint.core.compiled import compiled
from flexjoint.effects import Planned, Signals

SMALL = 1e-4  # decay over a step below which a series is taken: quotients of small numbers lose their digits
MOST = 300.0  # decay over a step that leaves nothing, short of underflow


def state_along(e: Planned, signals: Signals, period: float, begin: int) -> np.ndarray:
    """(N,) an effect's state on signals (N,) sampled every `period` seconds, usable from sample `begin` on.

    Rates are affine in the state, so that each step is exact for a drive that changes linearly over it, with
    the mean decay of both its ends. Until the effect sets in its state rests, but for one that follows."""
    one, steady = np.ones_like(signals.t), {}
    for name in ("dq", "dtheta", "dphi"):
        # near the edge of the recording the filter distorts a signal, and a state would keep that
        steady[name] = getattr(signals, name) * one
        steady[name][:begin] = steady[name][begin]
    signals, p = replace(signals, **steady), e.p
    offset = e.effect.rate(signals, p, 0.0 * one) * one
    decay = offset - e.effect.rate(signals, p, one)
    first = Signals(**{f.name: float(np.ravel(getattr(signals, f.name))[0]) for f in fields(Signals)})
    x = np.maximum(_mean_of_ends(decay) * period, 0.0)
    keep, divisor = np.exp(-np.minimum(x, MOST)), np.maximum(x, SMALL)
    mean = np.where(x < SMALL, 1.0 - 0.5 * x, (1.0 - keep) / divisor)  # of exp(-x) over the step
    late = np.where(x < SMALL, 0.5 - x / 6.0, (1.0 - mean) / divisor)  # share of the drive at the step's end
    add = period * ((mean - late) * offset + late * np.append(offset[1:], offset[-1:]))
    if e.since is not None and not e.effect.overrides("steady_state"):
        asleep = ~e.acts(signals.t)
        keep, add = np.where(asleep, 1.0, keep), np.where(asleep, 0.0, add)
    return stepped(float(e.effect.steady_state(first, p)), keep, add)


@compiled
def stepped(first: float, keep: np.ndarray, add: np.ndarray) -> np.ndarray:
    """(N,) z[k] of z[k + 1] = keep[k] z[k] + add[k] from z[0] = `first`, where keep (N,) is 0 to 1."""
    z = np.empty(keep.size)
    z[0] = first
    for k in range(keep.size - 1):
        z[k + 1] = keep[k] * z[k] + add[k]
    return z


def _mean_of_ends(x: np.ndarray) -> np.ndarray:
    """(N,) mean of each sample and its next, from (N,)."""
    return np.append(0.5 * (x[:-1] + x[1:]), x[-1:])


@compiled
def play(x: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(N,) a position x behind a play of `width` (N,) to either side (Prandtl 1928): it stands while x goes
    to and fro by less. A state that adds up the way of a body would add up that of its sensor's noise, too,
    which has no end."""
    behind = np.empty(x.size)
    here = x[0]
    for k in range(x.size):
        here = min(max(here, x[k] - width[k]), x[k] + width[k])
        behind[k] = here
    return behind
