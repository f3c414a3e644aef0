"""Does a designed feedback do in the nonlinear simulation what its linear model promised?"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from flexjoint.core.errors import ModelError, SimulationError
from flexjoint.design.feedback import Gains
from flexjoint.effects import Planned
from flexjoint.model.delays import longest_delay
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.statics.equilibrium import equilibrium
from flexjoint.simulation.loop import physics_rate
from flexjoint.simulation.options import RunOptions
from flexjoint.simulation.rollout import closed_loop
from flexjoint.simulation.sensors import true_signals
from flexjoint.simulation.trajectory import Past


@dataclass(frozen=True)
class StepTest:
    """A step of every joint at once: size [rad], (n,) or one for all; horizon [s]; `band`, the share of the
    step within which a joint counts as settled at its reference; `overshoot`, the largest allowed share of
    the step."""

    size: float | tuple[float, ...] = 0.05
    horizon: float = 2.0
    band: float = 0.05
    overshoot: float = 0.5


@dataclass(frozen=True, kw_only=True)
class Verification:
    """What the simulation showed. settling (n,) [s], infinite where a joint does not settle; overshoot (n,),
    share of the step; error (n,) [rad] of the link at the end; saturated (n,), share of the time at the
    torque limit. time (R,), q and q_ref (R, n) of the run, empty where it diverged."""

    verified: bool
    reason: str
    settling: np.ndarray
    overshoot: np.ndarray
    error: np.ndarray
    saturated: np.ndarray
    time: np.ndarray = field(repr=False)
    q: np.ndarray = field(repr=False)
    q_ref: np.ndarray = field(repr=False)


def verify(
    model: FlexibleJointModel,
    gains: Gains,
    at: np.ndarray | None = None,
    test: StepTest | None = None,
    delay: float = 0.0,
) -> Verification:
    """Step the whole robot from rest at `at` (nq,) under the sampled law, with all effects of the model at
    work, torque limits included, and commands `delay` [s] later than those effects say. References are those
    of the nominal robot: theta_ref = q_d + g(q_d)/K, tau_ff = g(q_d).

    Raises ModelError for gains designed at another rate than the robot's control rate.
    """
    test = test or StepTest()
    model = _later(model, delay)
    robot = model.robot
    control = robot.rates.control
    if gains.rate is not None and abs(gains.rate - control) > 1e-9 * control:
        raise ModelError(
            f"the gains are for {gains.rate:g} Hz, but the robot's controller ticks at {control:g} Hz"
        )
    start = np.array(model.body.neutral if at is None else at, dtype=float)
    goal = start.copy()
    places = [joint.idx_q for joint in robot.joints]
    size = np.broadcast_to(np.asarray(test.size, dtype=float), len(places))
    goal[places] += size
    nominal = FlexibleJointModel(robot, [e for e in robot.effects if e.nominal])
    rest = equilibrium(nominal, goal)
    ticks = round(test.horizon * control)
    rows = {
        "q_ref": goal[places],
        "theta_ref": rest.theta[0],
        "dtheta_ref": 0.0 * size,
        "tau_ff": rest.tau[0],
    }
    references = {name: np.tile(row, (ticks, 1)) for name, row in rows.items()}
    state = model.rest(start)
    rest = equilibrium(model, start)
    state.theta, state.z = rest.theta[0, list(model.flexible)], rest.z[0]
    rate = physics_rate(robot)
    options = RunOptions(rate=rate, engine="pin")
    before = math.ceil(longest_delay(model) * rate) + 1
    kept = (rest.tau[0], state.q, state.v, state.theta, state.dtheta)
    past = Past(*(np.tile(row, (before, 1)) for row in kept))
    n, names = len(places), robot.joint_names
    try:
        tape = closed_loop(model, state, gains.law(robot), references, options, past=past)
    except SimulationError as error:
        never, empty = np.full(n, np.inf), np.zeros((0, n))
        return Verification(
            verified=False,
            reason=str(error),
            settling=never,
            overshoot=never,
            error=never,
            saturated=never,
            time=np.zeros(0),
            q=empty,
            q_ref=empty,
        )
    true = true_signals(model, tape)
    q = np.stack([true["q", name] for name in names], axis=1)[tape.first :]
    time = tape.time[tape.first :] - tape.time[tape.first]
    away = (q - goal[places]) / size
    outside = np.abs(away) > test.band
    last = np.where(outside.any(axis=0), len(time) - 1 - np.argmax(outside[::-1], axis=0), -1)
    settling = np.where(outside[-1], np.inf, time[np.minimum(last + 1, len(time) - 1)])
    overshoot = np.maximum(np.max(away, axis=0), 0.0)
    limit = np.array([joint.torque_limit for joint in robot.joints])
    saturated = np.mean(np.abs(tape.tau_m[tape.first :]) >= limit * (1.0 - 1e-12), axis=0)
    off = q[-1] - goal[places]
    verified, reason = _verdict(test, names, settling, overshoot, off)
    return Verification(
        verified=verified,
        reason=reason,
        settling=settling,
        overshoot=overshoot,
        error=off,
        saturated=saturated,
        time=time,
        q=q,
        q_ref=np.tile(goal[places], (len(time), 1)),
    )


def _later(model: FlexibleJointModel, delay: float) -> FlexibleJointModel:
    """The model with later commands on every joint, as an effect: the simulator's own."""
    if delay == 0.0:
        return model
    effects = {planned.key: planned for planned in model.effects}
    for name in model.robot.joint_names:
        key = ("torque_delay", name)
        own = float(effects[key].p.delay) if key in effects else 0.0
        effects[key] = Planned.of(*key, {"delay": own + delay})
    return FlexibleJointModel(model.robot, effects.values())


def _verdict(
    test: StepTest, names: tuple[str, ...], settling: np.ndarray, overshoot: np.ndarray, error: np.ndarray
) -> tuple[bool, str]:
    if not np.all(np.isfinite(settling)):
        i = int(np.argmax(np.where(np.isfinite(settling), 0.0, np.abs(error))))
        return False, f"{names[i]} has not settled after {test.horizon:g} s: it is {error[i]:.2g} rad off"
    i = int(np.argmax(overshoot))
    if overshoot[i] > test.overshoot:
        return (
            False,
            f"{names[i]} overshoots by {100 * overshoot[i]:.0f} %, more than {100 * test.overshoot:.0f} %",
        )
    k = int(np.argmax(settling))
    return True, (
        f"all joints settle to {100 * test.band:g} % within {settling[k]:.3g} s ({names[k]}), overshoot up to"
        f" {100 * overshoot[i]:.0f} %"
    )
