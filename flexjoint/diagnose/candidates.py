"""Every effect on every joint it can sit on, and the first-order trace that each would leave."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexjoint.diagnose.balances import LINK, MOTOR, SPRING
from flexjoint.diagnose.workspace import Workspace
from flexjoint.effect import Effect, Param, Planned, Signals, Site, catalogue

TRIAL_SHARE = 0.05  # of the joint's torque: size at which a trace is taken


@dataclass(frozen=True)
class Candidate:
    """An effect on a joint (None: the robot), with its words chosen."""

    effect: Effect
    joint: str | None
    words: tuple[tuple[str, str | None], ...] = ()

    @property
    def key(self) -> tuple[str, str | None]:
        return self.effect.name, self.joint

    def planned(self, values: Mapping[str, Any], since: float | None = None) -> Planned:
        full = {p.name: p.value if p.size == 1 else (p.value,) * p.size for p in self.effect.params}
        return Planned(self.effect, self.joint, {**full, **dict(self.words), **values}, since)


@dataclass(frozen=True)
class Trace:
    """A candidate at one start: whitened columns (k, samples), and how amplitudes become values."""

    candidate: Candidate
    start: Mapping[str, Any]
    columns: np.ndarray
    kind: str  # amplitudes | whole | phase | inertial
    trial: Mapping[str, float]

    def values(self, amplitude: np.ndarray) -> dict[str, Any]:
        """Parameter values for fitted amplitudes of the columns, clipped into the bounds."""
        effect = self.candidate.effect
        out: dict[str, Any] = dict(self.start)
        if self.kind == "whole":
            for param in effect.nulls:
                null = 0.0 if param.null is None or not np.isfinite(param.null) else param.null
                if np.isfinite(param.null or 0.0):
                    scale = float(np.clip(amplitude[0], 0.1, 10.0))
                    out[param.name] = null + scale * (self.trial[param.name] - null)
        elif self.kind == "phase":
            size, angle = np.hypot(*amplitude), np.arctan2(amplitude[1], amplitude[0])
            for param in effect.params:
                if param.wraps:
                    out[param.name] = float(angle)
                elif param.name in self.trial:
                    out[param.name] = float(size) * self.trial[param.name]
        elif self.kind == "inertial":
            mass, moment = float(amplitude[0]), amplitude[1:4]
            out[effect.params[0].name] = mass
            position = moment / mass if abs(mass) > 1e-9 else np.zeros(3)
            out[effect.params[1].name] = tuple(float(x) for x in np.clip(position, -3.0, 3.0))
        else:
            for name, size in zip(self.trial, amplitude, strict=True):
                out[name] = float(size) * self.trial[name]
        return {p.name: _clip(p, out[p.name]) for p in effect.params if p.name in out}


def _clip(param: Param, value: Any) -> Any:
    if param.size > 1:
        return tuple(float(np.clip(v, param.low, param.high)) for v in value)
    return float(np.clip(value, param.low, param.high))


def enumerate_candidates(workspace: Workspace, excluded: frozenset[str] = frozenset()) -> list[Candidate]:
    """All candidates that the sensors of this recording could show; `excluded` effects are left out."""
    out = []
    for effect in catalogue().values():
        if effect.name in excluded:
            continue
        choices = [[(w.name, c) for c in w.choices] for w in effect.words]
        joints: Sequence[str | None] = [None] if effect.whole_robot else workspace.robot.joint_names
        for joint in joints:
            for words in itertools.product(*choices):
                candidate = Candidate(effect, joint, tuple(words))
                if visible(workspace, candidate):
                    out.append(candidate)
    return out


def visible(workspace: Workspace, candidate: Candidate) -> bool:
    """Whether the effect acts on something that this recording balances or measures."""
    effect, joint = candidate.effect, candidate.joint
    balances = workspace.balances
    if joint is None:
        return True
    i = workspace.robot.joint_names.index(joint)
    rigid = workspace.robot.joints[i].rigid
    rows = {row.balance for row in balances.rows if row.joint == i}
    if effect.needs_spring and rigid:
        return False
    if effect.site is Site.COMMAND:
        return MOTOR in rows
    if effect.site is Site.MOTOR:
        return MOTOR in rows
    if effect.site in (Site.DEFLECTION, Site.SPRING):
        return not rigid
    if effect.site in (Site.LINK, Site.BODY):
        return LINK in rows or (rigid and MOTOR in rows)
    readings = {
        "q": bool(np.isfinite(workspace.readings.q[i, 0])),
        "theta": bool(np.isfinite(workspace.readings.theta[i, 0])),
        "tau_t": SPRING in rows,
    }
    wanted = effect.channels(candidate.planned({}).p)
    concerned = [c for c in wanted if c in readings]
    if candidate.words and len(concerned) > 1:  # "all of the joint" needs more than one sensor to differ
        return sum(readings[c] for c in concerned) > 1
    return any(readings[c] for c in concerned)


def signals_of(workspace: Workspace, joint: str | None) -> Signals:
    """What `Effect.starts` sees: measured signals of the joint on usable samples."""
    balances, used = workspace.balances, workspace.readings.valid
    t = balances.t[used]
    if joint is None:
        return Signals(t=t)
    i = workspace.robot.joint_names.index(joint)
    q, theta = balances.q[i], balances.theta[i]
    torque = workspace.readings.torque[i]
    smooth = balances.filter.smooth
    return Signals(
        t=t,
        q=q[used],
        dq=smooth(q, 1)[used],
        theta=theta[used],
        dtheta=smooth(theta, 1)[used],
        phi=(theta - q)[used],
        dphi=smooth(theta - q, 1)[used],
        tau_t=balances.rigid.tau[i][used],
        tau_m=np.where(np.isfinite(torque), torque, 0.0)[used],
    )


def traces(workspace: Workspace, candidate: Candidate, base: Sequence[Planned]) -> list[Trace]:
    """First-order traces of a candidate on top of `base`, one per start."""
    effect = candidate.effect
    if effect.site is Site.BODY and effect.overrides("edit_inertial"):
        return [_inertial_trace(workspace, candidate)]
    phase = [p.name for p in effect.params if p.wraps]
    out = []
    seen: set[tuple[tuple[str, Any], ...]] = set()
    for start in effect.starts(signals_of(workspace, candidate.joint)):
        kept = {k: v for k, v in start.items() if k not in phase}
        key = tuple(sorted(kept.items()))
        if key in seen:
            continue
        seen.add(key)
        out.append(_trace(workspace, candidate, base, kept, phase))
    return out


def _trace(
    workspace: Workspace, candidate: Candidate, base: Sequence[Planned], start: dict[str, Any], phase: list[str]
) -> Trace:
    effect = candidate.effect
    given = [p.name for p in effect.nulls if p.name in start]
    without = [e for e in base if e.key != candidate.key]

    def column(values: Mapping[str, Any]) -> np.ndarray:
        return workspace.change(base, [*without, candidate.planned(values)])

    if given:
        columns = column(start)[None]
        return Trace(candidate, start, columns, "whole", {name: start[name] for name in given})
    trial = {p.name: trial_size(workspace, candidate, p) for p in effect.nulls if p.name not in phase}
    if phase:
        columns = np.stack([column({**start, **trial, phase[0]: a}) for a in (0.0, 0.5 * np.pi)])
        return Trace(candidate, start, columns, "phase", trial)
    rows = []
    for name in trial:
        values = {p.name: p.null for p in effect.nulls}
        values[name] = trial[name]
        rows.append(column({**start, **values}))
    return Trace(candidate, start, np.array(rows), "amplitudes", trial)


def trial_size(workspace: Workspace, candidate: Candidate, param: Param) -> float:
    """A size at which the effect is well visible and still small: by the unit of its parameter."""
    scale = 1.0
    if candidate.joint is not None:
        i = workspace.robot.joint_names.index(candidate.joint)
        scale = float(workspace.torque_scale[i])
        signals = signals_of(workspace, candidate.joint)
        travel, speed = float(np.std(signals.q)) + 1e-6, float(np.std(signals.dtheta)) + 1e-6
    else:
        travel = speed = 1.0
    stiff = 1.0
    if candidate.joint is not None and np.isfinite(workspace.robot.joints[i].drive.K):
        stiff = workspace.robot.joints[i].drive.K
    by_unit = {
        "N m": TRIAL_SHARE * scale,
        "N m s/rad": TRIAL_SHARE * scale / speed,
        "N m s^2/rad^2": TRIAL_SHARE * scale / speed**2,
        "N m/rad": TRIAL_SHARE * scale / travel,
        "N m/rad^3": TRIAL_SHARE * scale / (scale / stiff) ** 3,
        "rad": TRIAL_SHARE * scale / stiff if candidate.joint is not None else 0.01,
        "s": 1e-3,
        "": TRIAL_SHARE,
        "1": TRIAL_SHARE,
    }
    return float(np.clip(by_unit.get(param.unit, param.value), param.low, param.high))


def _inertial_trace(workspace: Workspace, candidate: Candidate) -> Trace:
    """Mass and first moments through the joint-torque regressor, linear; second moments follow in the fit."""
    assert candidate.joint is not None
    i = workspace.robot.joint_names.index(candidate.joint)
    regressor = workspace.balances.rigid.regressor[:, :, 10 * i : 10 * i + 10]
    columns = np.stack([workspace.load_column(regressor[:, :, k].T) for k in range(4)])
    return Trace(candidate, {}, columns, "inertial", {})
