"""Where the energy of a simulated motion comes from and where it goes.

    E = kinetic + potential of the bodies + kinetic of the motors + springs + springs of the ground
    E(t) - E(0) = work of the motors + work of effects on motors and links - losses of the dampers - rest

The rest is 0 for linear springs, and what dry friction and the ground take where there are some: never less
than 0. Work and losses are summed step by step as the linearly implicit midpoint scheme does them: the torque
is held, rates are differences over the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.effects import Drive, Signals, Site
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.joint import JointFlow
from flexjoint.simulation.sensors import true_signals
from flexjoint.simulation.trajectory import Trajectory

SAMPLES = 2000  # of a motion at which the stored energy is computed


@dataclass(frozen=True, kw_only=True)
class EnergyBalance:
    """At times (N,) [s], (N,) each [J]: stored in bodies, motors, springs and the ground; since the start:
    work of the motors' torque, of effects, lost in motor and spring damping; `missing`, what these leave of
    the balance: > 0 has gone elsewhere (dry friction, ground), < 0 came from nowhere."""

    time: np.ndarray
    bodies: np.ndarray
    motors: np.ndarray
    springs: np.ndarray
    ground: np.ndarray
    work: np.ndarray
    effects: np.ndarray
    lost: np.ndarray

    @property
    def stored(self) -> np.ndarray:
        return self.bodies + self.motors + self.springs + self.ground

    @property
    def missing(self) -> np.ndarray:
        return self.work + self.effects - self.lost - (self.stored - self.stored[0])

    @property
    def exchanged(self) -> float:
        """What the balance is measured by: the largest of the sums, and of the changes of what is stored."""
        sums = [np.ptp(part) for part in (self.bodies, self.motors, self.springs, self.ground)]
        turned = [np.max(np.abs(part)) for part in (self.work, self.effects, self.lost)]
        return float(max(*sums, *turned))


def energy_balance(model: FlexibleJointModel, trajectory: Trajectory) -> EnergyBalance:
    """The balance of a motion.

    Raises FlexJointError for what it does not know the energy of: effects on the command, in deflections and
    springs, effects with an onset, commanded stiffness.
    """
    _check(model)
    steps = len(trajectory.time) - trajectory.first
    rows = trajectory.first + np.unique(np.linspace(0, steps - 1, min(steps, SAMPLES)).round().astype(int))
    h = float(trajectory.time[1] - trajectory.time[0])
    true = true_signals(model, trajectory)
    after = slice(trajectory.first, None)
    motors, springs = np.zeros(len(rows)), np.zeros(len(rows))
    work, effects, lost = (np.zeros(steps) for _ in range(3))
    of: dict[int, Signals] = {}
    for i, flow in enumerate(model.flows):
        drive, name = flow.drive, flow.joint.name
        q, dq, theta, dtheta = (true[c, name][after] for c in ("q", "dq", "theta", "dtheta"))
        turn, twist = np.diff(theta), np.diff(theta - q)
        work[1:] += trajectory.tau_m[after, i][:-1] * turn
        if not flow.joint.rigid:
            lost[1:] += drive.D * twist**2 / h
            springs += 0.5 * drive.K * (theta - q)[rows - trajectory.first] ** 2
        s = Signals(
            trajectory.time[after], q, dq, theta, dtheta, theta - q, dtheta - dq, true["tau_t", name][after]
        )
        s.tau_m = trajectory.tau_m[after, i]
        of[i] = s
        effects[1:] += _done(flow.torques(s, trajectory.z[after].T)[1], q)
    for flow, drive, s in _motors(model, of):
        lost[1:] += drive.D_m * np.diff(s.theta) ** 2 / h
        motors += 0.5 * drive.B * s.dtheta[rows - trajectory.first] ** 2
        effects[1:] += _done(flow.torques(s, trajectory.z[after].T)[0], s.theta)
    at = rows - trajectory.first
    bodies = np.array([model.body.energy(trajectory.q[k], trajectory.v[k]) for k in rows])
    ground = np.array([_ground(model, trajectory, k) for k in rows])
    sums = [np.cumsum(part)[at] for part in (work, effects, lost)]
    return EnergyBalance(
        time=trajectory.time[rows],
        bodies=bodies,
        motors=motors,
        springs=springs,
        ground=ground,
        work=sums[0],
        effects=sums[1],
        lost=sums[2],
    )


def _motors(model: FlexibleJointModel, of: dict[int, Signals]) -> list[tuple[JointFlow, Drive, Signals]]:
    """Each motor, or shaft, with its drive's numbers and signals."""
    alone = [(flow, flow.drive, of[i]) for i, flow in enumerate(model.flows) if i not in model.grouped]
    shafts = [
        (shaft.flow, Drive(0.0, 0.0, shaft.B, shaft.D_m), shaft.signals({i: of[i] for i in group.joints}))
        for group in model.groups
        for shaft in group.shafts
    ]
    return alone + shafts


def _done(torque: np.ndarray | float, angle: np.ndarray) -> np.ndarray:
    """(R - 1,) work of a torque along an angle (R,), step by step."""
    full = np.broadcast_to(torque, angle.shape)
    return np.asarray(0.5 * (full[1:] + full[:-1]) * np.diff(angle))


def assert_energy_balance(
    model: FlexibleJointModel, trajectory: Trajectory, tolerance: float = 1e-3
) -> EnergyBalance:
    """Fail where energy comes from nowhere, or, without dry friction and contacts, goes there.

    Args:
        tolerance: as a share of what is exchanged (`EnergyBalance.exchanged`). What a scheme's steps leave
            falls with their square or, of the schemes of order 1, with them.

    Raises:
        AssertionError: when, how much, and the whole account at that time.
        FlexJointError: see `energy_balance`.
    """
    __tracebackhide__ = True
    balance = energy_balance(model, trajectory)
    allowed = tolerance * balance.exchanged
    takes = model.ground is not None or model.rubs
    missing = balance.missing
    gained = np.max(np.maximum.accumulate(missing) - missing) if takes else np.max(np.abs(missing))
    if gained <= allowed:
        return balance
    k = int(np.argmax(np.maximum.accumulate(missing) - missing if takes else np.abs(missing)))
    where = "dry friction and ground only take energy, but it grew" if takes else "energy is not kept"
    account = {name: getattr(balance, name) for name in ("bodies", "motors", "springs", "ground")}
    account |= {"work of motors": balance.work, "work of effects": balance.effects, "dampers": -balance.lost}
    raise AssertionError(
        "\n".join(
            [
                f"{where} by {gained:.3g} J at {balance.time[k]:g} s, {allowed:.3g} J are allowed"
                f" ({tolerance:g} of {balance.exchanged:.4g} J exchanged). Since the start:",
                *(f"  {name}: {values[k] - values[0]:+.6g} J" for name, values in account.items()),
                "Look for a scheme or step that is too coarse, or for a law that makes energy",
            ]
        )
    )


def _check(model: FlexibleJointModel) -> None:
    for planned in model.effects:
        effect = planned.effect
        counted = effect.site not in (Site.COMMAND, Site.DEFLECTION, Site.SPRING)
        if not (counted or effect.overrides("edit_drive")):
            raise FlexJointError(f"energy balance: {planned} moves energy that is not counted; test without")
        if planned.since is not None:
            raise FlexJointError(f"energy balance: {planned} sets in later; test before and after")
    for name in model.springs:
        raise FlexJointError(f"energy balance: the stiffness of {name} is commanded; test without")


def _ground(model: FlexibleJointModel, trajectory: Trajectory, row: int) -> float:
    """Energy in the springs of the contacts [J]."""
    if model.ground is None:
        return 0.0
    z = trajectory.z[row]
    touch = model.ground.touch(model.body, trajectory.q[row], trajectory.v[row], z)
    anchors = np.reshape(z[model.ground.slots], (-1, 2))
    total = 0.0
    for item, point, anchor in zip(model.ground.contacts, touch.points, anchors, strict=True):
        if point[2] < 0.0:
            total += 0.5 * item.stiffness * point[2] ** 2
            total += 0.5 * item.tangential_stiffness * float(np.sum((np.array(point[:2]) - anchor) ** 2))
    return total
