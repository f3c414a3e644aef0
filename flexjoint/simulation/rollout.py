"""Rollouts: a model under given motor torques, or under a control law."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexjoint.model.dynamics import FlexibleJointModel, State
from flexjoint.simulation.compiled import CompiledModel
from flexjoint.simulation.compiled.engine import adaptive, choose, job_of
from flexjoint.simulation.controllers import Law
from flexjoint.simulation.loop import REFERENCES, Runner, Ticks, check_references, check_torque
from flexjoint.simulation.options import DEFAULTS, RunOptions
from flexjoint.simulation.schemes import find
from flexjoint.simulation.schemes.stability import check_stability
from flexjoint.simulation.trajectory import Past, Trajectory


def rollout(
    model: FlexibleJointModel,
    start: State,
    torque: np.ndarray,
    options: RunOptions = DEFAULTS,
    *,
    past: Past | None = None,
    runs: int = 1,
) -> Trajectory:
    """Simulate under given motor torques.

    Args:
        torque: (N, n) commanded motor torque of each step [N m], before the effects on the command.
        past: what delays look up before the start; default: the start state and the first torque, held.
        runs: how many runs of this length the caller is about to make: the engine `auto` counts their steps.

    Raises:
        SimulationError: wrong shapes, numbers that are not finite.
        CompilerError: the engine is `compiled` and there is no compiler.

    Warns (StabilityWarning) when an explicit scheme is unstable on a spring.
    """
    torque = check_torque(model, torque)
    steps = runs * len(torque)
    if find(options.scheme).adaptive:
        model = adaptive(model, steps, options)
    elif (compiled := choose(model, steps, options)) is not None:
        return _compiled(compiled, model, start, None, torque, past)
    return Runner(model, start, len(torque), options, past).all(lambda now: torque[now.done])


def closed_loop(
    model: FlexibleJointModel,
    start: State,
    law: Law,
    references: Mapping[str, np.ndarray],
    options: RunOptions = DEFAULTS,
    *,
    past: Past | None = None,
    runs: int = 1,
) -> Trajectory:
    """Simulate under a control law sampled at f_c, the robot's `rates.control`.

    Args:
        references: q_ref, theta_ref, dtheta_ref, tau_ff, each (T, n): one row per control tick, T ticks.
            Where a reference jumps at a tick, the row holds what the controller shall see there: the value
            from the left, as `flexjoint.simulation.references` samples it, or the one from the right.
        past, runs: as for `rollout`. The physics rate may be any; see `flexjoint.simulation.loop.Ticks`.

    Raises and warns as `rollout`.
    """
    count = check_references(references, len(model.joints))
    ticks = Ticks(options.rate_for(model.robot), model.robot.rates.control)
    steps = ticks.steps(count)
    if find(options.scheme).adaptive:
        model = adaptive(model, runs * steps, options)
    elif (compiled := choose(model, runs * steps, options, law, REFERENCES)) is not None:
        return _compiled(compiled, model, start, law, compiled.references(references), past)
    tables = {name: np.asarray(references[name], dtype=float) for name in REFERENCES}

    def command(now: Runner) -> np.ndarray:
        if not ticks.acts(now.done):
            return now.last_command
        tick = ticks.last(now.done)
        return law.torque({name: values[tick] for name, values in tables.items()}, now.readings(law))

    return Runner(model, start, steps, options, past).all(command)


def _compiled(
    compiled: CompiledModel,
    model: FlexibleJointModel,
    start: State,
    law: Law | None,
    drive: np.ndarray,
    past: Past | None,
) -> Trajectory:
    check_stability(model, start, 1.0 / compiled.rate, compiled.options.scheme)
    job = job_of(compiled, model, start, law, drive, past)
    return compiled.trajectory(job, compiled.run(job))
