"""A push: what is left of a joint is a torque that acts for some time, and nothing of the robot explains it.

The times are those between which a constant explains most of what is left (least squares of a change that
begins and ends, Bai and Perron 1998); a smooth push has its half height there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from flexjoint.diagnosis.result import ResidualView, Unexplained
from flexjoint.diagnosis.settings import VerdictSettings
from flexjoint.diagnosis.verdict.residuals import explained_by, smooth_curve

GRID = 0.02  # s, of the times that are tried, or ...
MOST = 1000  # ... as many of them


def with_pushes(
    left: Sequence[Unexplained],
    residuals: Sequence[ResidualView],
    start: float,
    settings: VerdictSettings,
) -> tuple[Unexplained, ...]:
    """What is left of balances, with begin, end and torque where it is a push on the joint's link; `start` is
    the time of the recording at which that of the residuals counts from [s]."""
    found = pushes(residuals, settings)
    out = []
    for one in left:
        push = found.get((one.joint, one.balance))
        if push is None:
            out.append(one)
            continue
        begin, end, torque = push
        out.append(replace(one, against="t", begin=start + begin, end=start + end, torque=torque))
    return tuple(out)


def pushes(
    residuals: Sequence[ResidualView], settings: VerdictSettings
) -> dict[tuple[str, str], tuple[float, float, float]]:
    """`push_of` the balances, by joint and balance, that are left a push on the joint's link."""
    links = {view.joint for view in residuals if view.balance == "link"}
    found = {}
    for view in residuals:
        # what acts on the link is in the balance of the link; a rigid joint has the motor's only
        if view.balance == ("link" if view.joint in links else "motor"):
            push = push_of(view, settings)
            if push is not None:
                found[view.joint, view.balance] = push
    return found


def push_of(view: ResidualView, settings: VerdictSettings) -> tuple[float, float, float] | None:
    """(begin, end, torque) [s, s, N m] of a push that is nearly all that is left of a balance; None where
    there is none."""
    time, rest = view.time, view.after - np.median(view.after)
    power = float(np.sum(rest**2))
    if power <= 0.0:
        return None
    first, last = _interval(time, rest, settings.push_least, settings.push_most)
    inside = slice(first, last)
    outside = np.concatenate([rest[:first], rest[last:]])
    # what is there from the start, or to the end, is no push: it drifts, or it has set in
    if min(time[first] - time[0], time[-1] - time[last - 1]) < settings.push_least:
        return None
    level = float(np.mean(rest[inside]) - np.mean(outside))
    # a push has one sign and is strong beside all that is left at other times
    steady = float(np.std(rest[inside])) < settings.push_quiet * abs(level)
    quiet = float(np.std(outside)) < settings.push_quiet * abs(level)
    kept = np.concatenate([rest[inside] - np.mean(rest[inside]), outside - np.mean(outside)])
    gone = 1.0 - float(np.sum(kept**2)) / power
    if not (steady and quiet and gone > settings.push_share):
        return None
    others = max(
        (explained_by(rest, smooth_curve(x)) for name, x in view.signals.items() if name != "t"), default=0.0
    )
    if gone < others + settings.push_clear:
        return None
    if _rubs(rest[inside] - np.mean(outside), view.signals.get("dtheta"), inside):
        return None
    # in the middle of its readings: dry friction of a joint that rests takes some of the push
    torque = float(np.median(rest[inside]) - np.median(outside))
    return float(time[first]), float(time[last - 1]), -torque  # the motors have to give less


def _rubs(force: np.ndarray, speed: np.ndarray | None, inside: slice) -> bool:
    """Whether a torque that is proportional to the joint's speed is more like what is left than one that is
    constant: a stroke of which the friction was higher, and no push."""
    if speed is None or not np.any(speed[inside]):
        return False
    v = speed[inside]
    along = force - float(force @ v) / float(v @ v) * v
    return float(along @ along) < float(np.sum((force - np.mean(force)) ** 2))


def _interval(time: np.ndarray, rest: np.ndarray, least: float, most: float) -> tuple[int, int]:
    """First sample, and the one after the last, between which a constant explains most of the rest; as long
    as `least` [s], no longer than a share `most` of all samples, and anywhere."""
    step = max(1, int(GRID / float(np.median(np.diff(time)))), time.size // MOST)
    edges = np.append(np.arange(0, time.size, step), time.size)
    sums = np.concatenate([[0.0], np.cumsum(rest)])[edges]
    counts = edges[None, :] - edges[:, None]
    inside = sums[None, :] - sums[:, None]
    total = sums[-1]
    lasts = np.append(time, time[-1])[edges]
    allowed = (lasts[None, :] - lasts[:, None] >= least) & (counts <= most * time.size) & (counts > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        # energy between two means: that of the interval and that of the rest
        gained = np.where(allowed, inside**2 / counts + (total - inside) ** 2 / (time.size - counts), -np.inf)
    first, last = np.unravel_index(int(np.argmax(gained)), gained.shape)
    return int(edges[first]), int(edges[last])
