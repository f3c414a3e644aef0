"""Laws without a name: what the likely causes leave, followed by a smooth law of one signal.

A finished diagnosis is taken as it is, and never changed. At joints at which an error is left, laws of one
signal compete (splines.py) on every second block of time, each foretelling blocks that were left out of its
own fit; the best of them also over a half, a quarter and an eighth of its range at either end. It is judged
on the other blocks, and kept where it removes enough there, where it adds no error at any place of its
signal (places.py), and where the simulation on them is not worse. Its numbers then come from the whole
recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexjoint.core.errors import FlexJointError, RecordingError
from flexjoint.core.running.budget import UNLIMITED, Budget
from flexjoint.core.running.progress import Report, silent
from flexjoint.core.running.worker_pool import one_thread
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.comparison.compare import HORIZON, compared
from flexjoint.diagnosis.followup.learning.advice import advice
from flexjoint.diagnosis.followup.learning.likeness import likenesses
from flexjoint.diagnosis.followup.learning.places import worst_place
from flexjoint.diagnosis.followup.learning.splines import (
    PARTS,
    POINTS,
    Choice,
    Fitted,
    Shape,
    chosen,
    coefficients_of,
    fitted,
    part_of,
    shape_of,
)
from flexjoint.diagnosis.regression.deviations import converged_deviations, deviation_effects
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import LEAST, Diagnosis, Gain, Learned, LearnedLaw, Likeness, Removed
from flexjoint.diagnosis.result.merit import root_mean_square
from flexjoint.diagnosis.search.candidates import Candidate, visible
from flexjoint.diagnosis.settings import USUAL, Settings
from flexjoint.diagnosis.signals.excerpt import excerpts
from flexjoint.diagnosis.verdict.held_out import errors, held_out_blocks, noise_floor
from flexjoint.effects import Planned, catalogue
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.recording.currents import with_torques
from flexjoint.recording.table import Recording
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot, expect

UNITS = {"tau_t": "N m", "dtheta": "rad/s", "dq": "rad/s"}  # of signals; rad else


@one_thread
def learn(
    robot: Robot,
    recording: Recording,
    diagnosis: Diagnosis,
    *,
    payload: KnownPayload | None = None,
    settings: Settings = USUAL,
    budget: Budget = UNLIMITED,
    progress: Report = silent,
) -> Diagnosis:
    """The diagnosis with what was `learned`: laws of one signal of a joint through what its likely causes
    leave, each kept only where it holds on data that it did not see. Nothing else of it changes;
    `Diagnosis.extend` then puts the laws into the model, too.

    Args:
        robot: the nominal model.
        recording: the one that was diagnosed; of several, the first.
        diagnosis: what `diagnose` said of it.
        payload: what was added to the robot in it and is known.
        settings: the numbers that decide (docs/reference/settings.md).
        budget: the time that it may take; joints that are not looked at in it are named in the notes.
        progress: called with a share in [0, 1] and what is being done.

    Raises:
        RecordingError: the recording cannot be used with this robot.
        FlexJointError: the diagnosis is of another robot.
    """
    robot = expect(robot, "learn")
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"learn: expected the recording that was diagnosed, got a {type(recording).__name__}"
        )
    if not isinstance(diagnosis, Diagnosis):
        raise FlexJointError(
            f"learn: expected what diagnose returns, got a {type(diagnosis).__name__}; diagnose first"
        )
    joints = _left(robot, diagnosis, settings)
    if not joints:
        return replace(diagnosis, learned=Learned())
    base = replace(diagnosis, learned=None).extend(robot)  # which checks the names
    nominal = robot if payload is None else payload.on(robot)
    causes = [e for e in base.effects if e not in robot.effects]
    (part,), _ = excerpts(nominal, [with_torques(nominal, recording)], budget.seconds)
    task = _Task.of(nominal, part, causes, settings)
    found, notes = task.learned(joints, budget, progress)
    kept, simulation = task.simulated(found)
    notes += tuple(
        f"a law of {one.choice.shape.law} was dropped: the simulation was worse with it"
        for one in found
        if one not in kept
    )
    return replace(diagnosis, learned=Learned(task.stated(kept), simulation, notes))


def _left(robot: Robot, diagnosis: Diagnosis, settings: Settings) -> list[str]:
    """Joints at which the model with the likely causes leaves an error beyond noise and tolerance, and those
    of causes that are not likely enough to be in the model; none of a healthy machine."""
    if diagnosis.verdict in ("healthy", "refused"):
        return []
    likely, limits = diagnosis.likely(LEAST), settings.verdict
    names = [u.joint for u in diagnosis.unexplained]
    floor = settings.learn.size * robot.tolerance.torque
    for left in diagnosis.remaining:
        if left.after > max(limits.above_noise * left.noise, floor * left.torque):
            names.append(left.joint)
    for finding in diagnosis.findings:
        if finding not in likely:
            names += [one.joint for one in finding.members or (finding.planned,) if one.joint is not None]
            names += [finding.removed.joint] if finding.removed is not None else []
    return list(dict.fromkeys(names))


@dataclass(frozen=True)
class _Judged:
    """A law from the blocks that were fitted, and what it removes on the others."""

    choice: Choice
    law: Planned
    removed: Removed
    share: float


@dataclass(frozen=True)
class _Task:
    """A recording's problem with the likely causes at work, and its blocks of time."""

    robot: Robot
    recording: Recording
    causes: tuple[Planned, ...]
    problem: Problem
    length: float  # s, of the blocks of time
    block: np.ndarray  # (N,) number of each sample's block; odd ones are not fitted

    @classmethod
    def of(cls, robot: Robot, recording: Recording, causes: Sequence[Planned], settings: Settings) -> _Task:
        problem = Problem(balances_of(robot, recording, settings)).about(causes)
        problem = problem.at(problem.plausible_level(problem.residual(causes)))
        time = problem.balances.chains.t[0] + problem.time
        shorter = float(np.ptp(time)) / (2 * settings.learn.least_blocks)
        length = max(min(settings.verdict.held_out_block, shorter), settings.learn.shortest_block)
        block = np.floor(time / length).astype(int)
        return cls(robot, recording, tuple(causes), problem, length, block)

    @property
    def away(self) -> np.ndarray:
        """(N,) bool: samples that no fit sees before a law is judged."""
        return self.block % 2 == 1

    def learned(
        self, joints: Sequence[str], budget: Budget, progress: Report
    ) -> tuple[list[_Judged], tuple[str, ...]]:
        limits = self.problem.settings.learn
        counts = [np.unique(self.block[x]).size for x in (self.away, ~self.away)]
        if min(counts) < limits.least_blocks:
            seconds = 2 * limits.least_blocks * limits.shortest_block
            return [], (f"no law was learned: that takes {seconds:g} s of motion",)
        found: list[_Judged] = []
        late = []
        for k, joint in enumerate(joints):
            if budget.spent:
                late.append(joint)
                continue
            progress(k / len(joints), f"learning what is left of {joint}")
            for _ in range(limits.most):
                law = self._law(joint, [one.law for one in found])
                if law is None:
                    break
                found.append(law)
        notes = (f"the time allowed was over before {', '.join(late)} could be learned",) if late else ()
        return found, notes

    def _law(self, joint: str, laws: Sequence[Planned]) -> _Judged | None:
        """The best law of a joint beside those that there are, if it is good enough."""
        base = [*self.causes, *laws]
        taken = {e.key for e in self.problem.with_nominal(base)}
        seen = self.problem.only(~self.away)
        y = self.problem.residual(base)
        folds = self._folds()
        choices = []
        for candidate in _candidates(self.problem, joint):
            shape = None if candidate.key in taken else self._shape(candidate, base)
            if shape is not None:
                choices.append(chosen(seen, shape, y, folds))
        best = min(choices, key=lambda choice: choice.foretold, default=None)
        if best is None:
            return None
        nearer = [part_of(self.problem, best.shape, part, base) for part in PARTS]
        choices = [chosen(seen, shape, y, folds) for shape in nearer if shape is not None]
        near = min(choices, key=lambda choice: choice.foretold, default=best)
        if near.foretold <= self.problem.settings.learn.part * best.foretold:
            best = near
        if best.foretold >= 1.0:
            return None
        centred, other = (self._tried(base, replace(best, centred=c), y) for c in (True, False))
        if centred is None or other is None:
            return centred or other
        limit = self.problem.settings.learn.worse_place
        return centred if centred.removed.left <= limit * other.removed.left else other

    def _tried(self, base: Sequence[Planned], choice: Choice, y: np.ndarray) -> _Judged | None:
        trial = fitted(self.problem.only(~self.away), choice, y)
        if trial.certainty < self.problem.settings.learn.sure:
            return None
        return self._judged(base, choice, trial.law, y)

    def _shape(self, candidate: Candidate, base: Sequence[Planned]) -> Shape | None:
        return shape_of(self.problem, candidate, base, self.problem.settings.learn)

    def _folds(self) -> np.ndarray:
        """(N,) which part of the fitted blocks a sample belongs to: neighbours lie together."""
        count = self.problem.settings.learn.folds
        pairs = self.block // 2 - self.block[0] // 2
        whole = int(pairs.max()) + 1
        return np.asarray(pairs * min(count, whole) // whole)

    def _judged(self, base: Sequence[Planned], choice: Choice, law: Planned, y: np.ndarray) -> _Judged | None:
        limits, problem = self.problem.settings.learn, self.problem
        seen, unseen = problem.only(~self.away), problem.only(self.away)
        rows = np.array([problem.robot.joints[r.joint].name == law.joint for r in problem.balances.rows])

        def squares(residual: np.ndarray) -> np.ndarray:
            """(pieces,) squared error of the joint's balances by piece of the blocks that were not fitted."""
            rest = (seen.rest(residual) * unseen.weights).reshape(rows.size, -1)[rows]
            return np.bincount(piece, np.sum(rest**2, axis=0)[self.away])

        time = (problem.time - problem.time[0])[self.away]
        _, piece = np.unique((time / problem.settings.regression.time_block).astype(int), return_inverse=True)

        without, left = squares(y), squares(problem.residual([*base, law]))
        gained = without - left
        noise = float(np.sum(1.0 / problem.level.inflation[rows])) * float(np.sum(self.away))
        noise *= problem.whitening.freedom / rows.size
        above = max(float(np.sum(without)) - noise, 1e-300)
        share = float(np.sum(gained)) / above
        # the standard error of a ratio of sums over pieces that differ in size (Cochran 1977, section 2.11)
        ratio = float(np.sum(gained)) / max(float(np.sum(without)), 1e-300)
        spread = np.sqrt(gained.size / (gained.size - 1.0) * np.sum((gained - ratio * without) ** 2))
        sure = float(np.sum(gained)) >= limits.sure * float(spread)
        removed, worst = self._removed(base, law, y)
        size = np.sqrt(max(0.0, removed.without**2 - removed.left**2))
        at = problem.robot.joint_names.index(law.joint or "")
        floor = limits.size * problem.robot.tolerance.torque * float(problem.torque_scale[at])
        if share < limits.share or not sure or size < floor or worst > limits.worse_place:
            return None
        return _Judged(choice, law, removed, min(share, 1.0))

    def _removed(self, base: Sequence[Planned], law: Planned, y: np.ndarray) -> tuple[Removed, float]:
        """RMS [N m] of the joint's balance that a law clears most, without it and with it, on the blocks that
        were not fitted; nominal numbers as they are fitted beside it on the others. Beside it, how many times
        as large the joint's error is with the law, at the place of its signal where that is most."""
        problem = self.problem.only(~self.away)
        away = held_out_blocks(problem.balances.chains.t, self.length)[problem.readings.valid]

        def series(effects: Sequence[Planned], residual: np.ndarray) -> np.ndarray:
            numbers = converged_deviations(problem, effects, residual)
            every = [*problem.with_nominal(effects), *deviation_effects(problem, numbers)]
            left = problem.balances.time_series(problem.balances.residual(every)) - problem.jumped(numbers)
            return np.asarray(left[:, problem.readings.valid][:, away])

        without, left = series(base, y), series([*base, law], problem.residual([*base, law]))
        first, last = (np.asarray(np.mean(r**2, axis=1)) for r in (without, left))
        own = [
            k
            for k, row in enumerate(problem.balances.rows)
            if problem.robot.joints[row.joint].name == law.joint
        ]
        at = max(own, key=lambda k: (first[k] - last[k]) / max(last[k], problem.deviation[k] ** 2, 1e-300))
        signal = np.asarray(getattr(problem.signals(law.joint or ""), dict(law.values)["signal"]))[away]
        worst = worst_place(signal, without[own], left[own], problem.deviation[own])
        where = problem.balances.rows[at]
        removed = Removed(
            law.joint or "", where.balance, float(np.sqrt(first[at])), float(np.sqrt(last[at])), 0.0,
            dict(law.values)["signal"],
        )  # fmt: skip
        return removed, worst

    # ------------------------------------------------------------------ simulation
    def simulated(self, found: Sequence[_Judged]) -> tuple[list[_Judged], Gain | None]:
        """The laws with which the simulation is not worse on the blocks that were not fitted, and how it is
        without them and with them."""
        if not found:
            return [], None
        rows = held_out_blocks(self.recording.time - self.recording.time[0], self.length)

        def measured(laws: Sequence[Planned]) -> dict[str, Mapping[str, float]]:
            model = FlexibleJointModel(self.robot.extended([*self.causes, *laws]))
            run = compared(model, self.problem.readings.recording)
            return errors(self.recording, run, rows)

        try:
            before = measured([])
        except FlexJointError:  # it lacks what a simulation needs
            return list(found), None
        kept = list(found)
        while kept:
            try:
                after = measured([one.law for one in kept])
                worst = self._worst(before, after, kept)
            except FlexJointError:  # it diverges
                worst = kept[-1]
            if worst is None:
                floor = {"rms": noise_floor(self.robot, self.recording)}
                return kept, Gain(True, HORIZON, before, after, floor)
            kept.remove(worst)
        return [], None

    def _worst(
        self,
        before: Mapping[str, Mapping[str, float]],
        after: Mapping[str, Mapping[str, float]],
        kept: Sequence[_Judged],
    ) -> _Judged | None:
        """The law to drop where the simulation of its joint, or of the robot, is worse."""
        limit = self.problem.settings.learn.worse

        def grown(joint: str | None) -> float:
            names = [
                name
                for name in before["nrmse"]
                if joint is None or name.split(".", 1)[1] == joint
                if joint is not None or not name.startswith("phi.")
            ]
            first, last = (
                root_mean_square(of["nrmse"][name] for name in names if name in of["nrmse"])
                for of in (before, after)
            )
            return last / first if first > 0.0 else 1.0

        worst = max(reversed(kept), key=lambda one: grown(one.law.joint))
        return worst if grown(worst.law.joint) > limit or grown(None) > limit else None

    # ------------------------------------------------------------------ what is said
    def stated(self, kept: Sequence[_Judged]) -> tuple[LearnedLaw, ...]:
        """The laws with their numbers from the whole recording."""
        out: list[LearnedLaw] = []
        for one in kept:
            base = [*self.causes, *(law.planned for law in out)]
            y = self.problem.residual(base)
            final = fitted(self.problem, one.choice, y)
            alike = likenesses(self.problem, base, final.law)
            out.append(self._stated(one, final, alike))
        return tuple(out)

    def _stated(self, one: _Judged, final: Fitted, alike: tuple[Likeness, ...]) -> LearnedLaw:
        law = final.law
        joint, signal = law.joint or "", dict(law.values)["signal"]
        at, value, std = final.curve(POINTS)
        size = coefficients_of(law)
        sliding = joint in self.robot.prismatic
        return LearnedLaw(
            law.effect.name,
            joint,
            signal,
            law,
            tuple(at.tolist()),
            replace(size, unit=UNITS.get(signal, "rad")).unit_at(sliding),
            tuple(value.tolist()),
            tuple(std.tolist()),
            size.unit_at(sliding),
            final.freedom,
            one.removed,
            one.share,
            alike,
            advice(law.effect.name, signal),
        )


def _candidates(problem: Problem, joint: str) -> list[Candidate]:
    """Every learned law, of every signal, that the sensors of this recording could show at a joint."""
    rigid = problem.robot.joint(joint).rigid
    return [
        candidate
        for effect in catalogue().values()
        if not effect.is_cause
        for word in effect.words
        for signal in word.choices
        if not (rigid and signal == "tau_t")  # a rigid joint's model has no spring that tells it
        if visible(problem, candidate := Candidate(effect, joint, ((word.name, signal),)))
    ]
