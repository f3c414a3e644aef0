"""What the residual of each balance depends on, before and after the named causes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flexjoint.diagnosis.result import Diagnosis, ResidualView
from flexjoint.diagnosis.result.wording import Joints, clean, number, percent, unit_of
from flexjoint.report import plots, series
from flexjoint.report.material import Material

VIEWS, AXES = 4, 4
NOISE_ONLY = 1.2  # mean square over the predicted noise's up to which a residual shows nothing
# Signals of one group look alike (a stiff joint's q and theta): the most telling one of each is drawn.
GROUPS: Mapping[str, str] = {
    "dq": "velocity",
    "dtheta": "velocity",
    "q": "position",
    "theta": "position",
    "tau_t": "load",
    "tau_m": "load",
    "tau_motor": "load",
    "phi": "load",
}
BALANCES: Mapping[str, str] = {
    "motor": "torque command minus motor inertia, motor damping and spring torque",
    "link": "spring torque minus the rigid body's inverse dynamics",
    "spring": "measured spring torque minus K (theta - q) + D (dtheta - dq)",
}
RIGID = "torque command minus inertia, friction and load of the model"  # the one balance of such a joint


@dataclass(frozen=True)
class AxisPlot:
    signal: str
    image: plots.Image
    share: str  # "83% → 2%" of the residual's variance follows this signal


@dataclass(frozen=True)
class View:
    joint: str
    balance: str
    meaning: str
    before: str
    after: str
    noise: str
    unit: str
    axes: tuple[AxisPlot, ...]


@dataclass(frozen=True)
class ResidualsSection:
    views: tuple[View, ...]
    two: bool  # before and after are both drawn


def build(material: Material) -> ResidualsSection | None:
    diagnosis = material.diagnosis
    chosen = _chosen(diagnosis)
    if not chosen:
        return None
    two = bool(diagnosis.findings)
    sliding = material.robot.prismatic
    views = (
        _view(view, _preferred(view, diagnosis), two, view.joint in sliding, material.joints)
        for view in chosen
    )
    return ResidualsSection(tuple(views), two)


def _chosen(diagnosis: Diagnosis) -> list[ResidualView]:
    """For each named joint the balance that gains most, then what is unexplained; else the two worst."""
    views = [view for view in diagnosis.residuals if view.time.size]
    by_gain = sorted(views, key=lambda view: _excess(view, view.after) - _excess(view, view.before))
    by_gain = [view for view in by_gain if _excess(view, view.before) > NOISE_ONLY]
    chosen: list[ResidualView] = []
    for finding in diagnosis.findings:
        chosen += [view for view in by_gain if finding.joint in (view.joint, None)][:1]
    open_ends = {(u.joint, u.balance) for u in diagnosis.unexplained}
    chosen += [view for view in views if (view.joint, view.balance) in open_ends]
    chosen = list({(view.joint, view.balance): view for view in chosen}.values())
    if not chosen:
        chosen = sorted(views, key=lambda view: -_excess(view, view.before))[:2]
    return chosen[:VIEWS]


def _excess(view: ResidualView, residual: np.ndarray) -> float:
    """Mean square in units of the predicted noise."""
    return _rms(residual) ** 2 / view.noise**2 if view.noise > 0 else _rms(residual) ** 2


def _rms(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else 0.0


def _preferred(view: ResidualView, diagnosis: Diagnosis) -> list[str]:
    """The signals that the causes of this joint, or what is left unexplained, should show on."""
    left = [u.against for u in diagnosis.unexplained if (u.joint, u.balance) == (view.joint, view.balance)]
    named = [f.planned.effect.against for f in diagnosis.findings if f.joint in (view.joint, None)]
    return list(dict.fromkeys([*left, *named]))


def _view(view: ResidualView, preferred: list[str], two: bool, prismatic: bool, joints: Joints) -> View:
    signals = {**view.signals, "t": view.time}
    shares = {name: series.dependence(values, view.before) for name, values in signals.items()}
    telling = sorted(signals, key=lambda name: (-shares[name], name))
    by_group: dict[str, str] = {}
    for name in [*(name for name in preferred if name in signals), *telling]:
        by_group.setdefault(GROUPS.get(name, name), name)
    order = list(by_group.values())[:AXES]
    plotted = []
    for name in order:
        share = percent(shares[name])
        if two:
            share += f" → {percent(series.dependence(signals[name], view.after))}"
        image = plots.dependence(
            signals[name],
            view.before,
            view.after if two else None,
            name,
            joints.signal(name),
            view.noise,
            prismatic,
            f"Residual of the {clean(view.balance)} balance of {clean(view.joint)} over"
            f" {joints.signal(name)}",
        )
        plotted.append(AxisPlot(joints.signal(name), image, share))
    return View(
        clean(view.joint),
        clean(view.balance),
        RIGID if joints.rigid else BALANCES.get(view.balance, ""),
        number(_rms(view.before)),
        number(_rms(view.after)),
        number(view.noise),
        unit_of("tau_t", prismatic),
        tuple(plotted),
    )
