"""What a set of causes gains on data that its fit did not see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexjoint.compare import Comparison, compare
from flexjoint.diagnose.fit import Fit, fit, shifts
from flexjoint.diagnose.selection import Selection
from flexjoint.diagnose.verdict import SURE, certainty, given_way, standard_errors, without
from flexjoint.diagnose.workspace import Workspace
from flexjoint.diagnose.worth import at_own_level, degenerate, score
from flexjoint.diagnosis import Gain
from flexjoint.effect import Planned
from flexjoint.errors import FlexJointError
from flexjoint.model import FlexibleJointModel
from flexjoint.noise import white_noise
from flexjoint.recording import MEASURED, Recording
from flexjoint.robot import Robot

BLOCK = 2.0  # s; every second block is held out
HORIZON = 0.5  # s
RIVALS_TRIED = 3  # in the place of a cause that the simulation speaks against
WORSE = 1.2  # times the nominal error, from which a simulation counts as made worse


def held_out_blocks(time: np.ndarray) -> np.ndarray:
    """(N,) bool: samples that a fit does not see (time from the recording's start)."""
    return np.floor(time / BLOCK).astype(int) % 2 == 1


def gains(workspace: Workspace, best: Fit) -> list[float]:
    """Share of the nominal model's held-out error that each cause removes: refitted on the other blocks,
    with it and without it."""
    away = held_out_blocks(workspace.balances.chains.t[0] + workspace.time)
    if not np.any(away) or np.all(away):
        away = np.arange(workspace.time.size) % 2 == 1
    level = best.workspace.temper
    seen, unseen = workspace.at(level).only(~away), workspace.at(level).only(away)
    noise = float(np.sum(1.0 / level)) * float(np.sum(away)) * workspace.whitening.freedom / len(level)

    def error(effects: Sequence[Planned]) -> float:
        fitted = fit(seen, effects)
        rest = fitted.workspace.rest(fitted.y) * unseen.weights
        return float(rest @ rest)

    everything, none = error(best.effects), error([])
    whole = max(none - min(noise, everything), 1e-300)
    out = []
    for k in range(len(best.effects)):
        without = none if len(best.effects) == 1 else error([e for i, e in enumerate(best.effects) if i != k])
        out.append(float(np.clip((without - everything) / whole, 0.0, 1.0)))
    return out


def confirmed(
    robot: Robot, recording: Recording, workspace: Workspace, selection: Selection
) -> tuple[Selection, Gain | None, tuple[str, ...]]:
    """The selection without causes that make the simulation of their own joint worse on held-out data: a
    balance can be made smaller by a wrong cause, a simulation hardly. The nominal numbers' tolerances have
    their say: a small true cause need not help a simulation that suffers from a spring 2 % off."""
    notes: list[str] = []
    measured = comparison(robot, recording, workspace, selection.best)
    while measured is not None and selection.best.effects:
        worse = [e for e in selection.best.effects if e.joint is not None and _worsened(measured, e.joint)]
        if worse:
            fair = comparison(robot, recording, workspace, selection.best, nothing=selection.nothing)
            worse = [e for e in worse if fair is not None and _worsened(fair, str(e.joint))]
        if not worse:
            break
        dropped = worse[-1]
        instead = _instead(robot, recording, workspace, selection, dropped, measured)
        if instead is not None:
            selection, measured = instead
            notes.append(
                f"{dropped} would make the balance smaller but the simulation worse: its rival is named"
            )
            continue
        trial = without(selection, dropped)
        again = comparison(robot, recording, workspace, trial.best, measured)
        if again is None or _size(again, dropped.joint) > 0.95 * _size(measured, dropped.joint):
            break
        notes.append(f"{dropped} would make the balance smaller but the simulation worse: not named")
        selection, measured = trial, again
    return selection, measured, tuple(notes)


def _instead(
    robot: Robot,
    recording: Recording,
    workspace: Workspace,
    selection: Selection,
    dropped: Planned,
    measured: Gain,
) -> tuple[Selection, Gain] | None:
    """The selection with the best rival of a cause in its place that the simulation does not speak against: a
    finer law may follow what a filter makes of a simpler one."""
    best = selection.best
    k = best.effects.index(dropped)
    others = [e for e in best.effects if e is not dropped]
    bare = score(fit(best.workspace, others))
    for rival in selection.rivals[k][:RIVALS_TRIED]:
        joints = {j for j in (dropped.joint, rival.effects[-1].joint) if j is not None}
        if score(rival) >= bare or len(rival.effects) > len(best.effects):
            continue
        settled = at_own_level(rival)
        named = settled.effects[-1]
        if (
            degenerate(settled.workspace, named)
            or certainty(settled, named, standard_errors(settled)[-1]) < SURE
        ):
            continue
        fair = comparison(robot, recording, workspace, settled, nothing=selection.nothing)
        if fair is not None and not any(_worsened(fair, joint) for joint in joints):
            again = comparison(robot, recording, workspace, settled, measured)
            return None if again is None else (given_way(selection, k, rival, settled), again)
    return None


def _worsened(gain: Gain, joint: str) -> bool:
    return _size(gain, joint) > WORSE * _size(gain, joint, "before")


def _size(gain: Gain, joint: str | None, when: str = "after") -> float:
    """Mean NRMSE of the positions of a joint."""
    table = (gain.after if when == "after" else gain.before)["nrmse"]
    sizes = [table[key] for key in (f"q.{joint}", f"theta.{joint}") if key in table]
    return float(np.mean(sizes)) if sizes else 0.0


def comparison(
    robot: Robot,
    recording: Recording,
    workspace: Workspace,
    best: Fit,
    known: Gain | None = None,
    nothing: Fit | None = None,
) -> Gain | None:
    """Simulation against the held-out blocks, before and after; the parameters come from the other blocks.
    None where the recording cannot drive a simulation. Of `known`, an earlier comparison, the nominal model's
    part is taken. With `nothing`, the fit without causes, each of the two has its nominal numbers where it
    would have them by their tolerances."""
    away = held_out_blocks(workspace.balances.chains.t[0] + workspace.time)
    held_out = bool(np.any(away) and not np.all(away))
    if held_out:
        best = fit(workspace.at(best.workspace.temper).only(~away), best.effects)
    first, last = robot, robot.extended(best.effects)
    if nothing is not None:
        if held_out:
            nothing = fit(workspace.at(nothing.workspace.temper).only(~away), [])
        first, last = robot.extended(shifts(nothing)), last.extended(shifts(best))
    rows = (
        held_out_blocks(recording.time - recording.time[0])
        if held_out
        else np.ones(len(recording.time), bool)
    )

    def measured(model: Robot) -> dict[str, Mapping[str, float]]:
        return errors(recording, compare(recording, FlexibleJointModel(model), HORIZON), rows)

    try:
        before = measured(first) if known is None else known.before
        after = measured(last) if best.effects else before
    except FlexJointError:
        return None
    return Gain(held_out, HORIZON, before, after, {"rms": noise_floor(robot, recording)})


def errors(recording: Recording, run: Comparison, rows: np.ndarray) -> dict[str, Mapping[str, float]]:
    """RMS and NRMSE per channel over some rows; phi about its mean where both encoders are measured."""
    rms: dict[str, float] = {}
    nrmse: dict[str, float] = {}
    for (channel, joint), simulated in run.simulated.items():
        _add(rms, nrmse, f"{channel}.{joint}", recording.get(channel, joint), simulated, rows)
    for joint in dict.fromkeys(joint for _, joint in run.simulated):
        if ("q", joint) in run.simulated and ("theta", joint) in run.simulated:
            measured = recording.get("theta", joint) - recording.get("q", joint)
            phi = run.simulated["theta", joint] - run.simulated["q", joint]
            both = np.isfinite(measured) & np.isfinite(phi)
            _add(
                rms, nrmse, f"phi.{joint}", measured - np.mean(measured[both]), phi - np.mean(phi[both]), rows
            )
    return {"rms": rms, "nrmse": nrmse}


def _add(
    rms: dict[str, float],
    nrmse: dict[str, float],
    name: str,
    measured: np.ndarray,
    simulated: np.ndarray,
    rows: np.ndarray,
) -> None:
    error = (simulated - measured)[rows]
    error = error[np.isfinite(error)]
    if error.size:
        rms[name] = float(np.sqrt(np.mean(error**2)))
        spread = float(np.nanstd(measured))
        if spread > 0.0:
            nrmse[name] = rms[name] / spread


def noise_floor(robot: Robot, recording: Recording) -> dict[str, float]:
    """Predicted sensor noise per channel: no model can come below it."""
    return {
        f"{channel}.{joint}": white_noise(values)
        for (channel, joint), values in recording.columns.items()
        if channel in MEASURED and joint in robot.joint_names
    }
