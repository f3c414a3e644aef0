"""The model of a set of causes with its numbers left open: what windows of any length share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.diagnosis.comparison.estimate import StateEstimator
from flexjoint.diagnosis.refinement.open_numbers import open_numbers
from flexjoint.diagnosis.refinement.sensitivities import Delays, StepDerivatives, link_load
from flexjoint.diagnosis.regression.fit import Slot
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.effects import Planned, effect
from flexjoint.model.dynamics import FlexibleJointModel
from flexjoint.model.parameters import labels
from flexjoint.model.symbolic import SymbolicModel
from flexjoint.robot.robot import Robot
from flexjoint.simulation.loop import physics_rate

CHANNELS = ("q", "theta", "tau_t")  # the balances' sensors
PASSES = 3  # linearisations to be expected


class OpenModel:
    """A problem's robot with a set of effects, whose free numbers (slots) and nominal numbers may move.

    Derivatives of a step are made once a phase (of effects that set in) and kept: they cost seconds.
    """

    def __init__(self, problem: Problem, effects: Sequence[Planned], slots: Sequence[Slot]) -> None:
        self.problem = problem
        robot, recording = problem.robot, problem.readings.recording
        self.rate = physics_rate(robot)  # Hz
        free_offsets = _offsets(robot, effects)
        at_work = [*problem.with_nominal(effects), *free_offsets]
        self.model = FlexibleJointModel(robot, at_work)
        self.estimator = StateEstimator(recording, self.model)
        self.phases = [time for time, _ in self.model.phases]
        loads = [link_load(joint.name) for joint in robot.joints]

        def symbolic(time: float) -> SymbolicModel:
            return SymbolicModel(robot, [*at_work, *loads], free=("drives",), at=max(time, -1.0))

        self._symbolic = [model for _, model in self.model.by_phase(symbolic)]
        self._parameters = self._symbolic[0].parameters
        self.nominal = open_numbers(robot, problem, free_offsets)
        self.slot_labels = [slot_label(effects, slot) for slot in slots]
        self._values = self._symbolic[0].values.copy()
        for joint, offset in self.estimator.offsets.items():
            self._values[self._parameters.index(f"motor_encoder_offset.{joint}.offset")] = offset
        named = {number.name for number in self.nominal if not number.direction}
        self.varied = list(dict.fromkeys([*self.slot_labels, *sorted(named)]))
        self.keys = [
            (channel, joint.name)
            for joint in robot.joints
            for channel in CHANNELS
            if recording.has(channel, joint.name) and not (joint.rigid and channel == "tau_t")
        ]
        self.noise = np.array([self._noise(*key) for key in self.keys])
        self.measured = np.stack([recording.get(*key) for key in self.keys], axis=1)
        self.delays = Delays(self._symbolic[0], self.keys, self.varied)
        self.by_common = self._by_common()  # (varied, common numbers)
        self._derivatives: dict[int, StepDerivatives] = {}  # by the first phase in which the same effects act

    @property
    def common(self) -> int:
        """Numbers common to all windows: the slots, then the nominal ones."""
        return len(self.slot_labels) + len(self.nominal)

    def derivatives(self, phase: int) -> StepDerivatives:
        """Of one step in a phase."""
        phase = self._symbolic.index(self._symbolic[phase])
        if phase not in self._derivatives:
            seconds = float(np.ptp(self.problem.readings.recording.time))
            names = [".".join(key) for key in self.keys]
            self._derivatives[phase] = StepDerivatives(
                self._symbolic[phase], self.varied, names, round(PASSES * seconds * self.rate)
            )
        return self._derivatives[phase]

    def numbers(self, slots: np.ndarray, deviations: np.ndarray) -> np.ndarray:
        """(np,) parameters for slot values and deviations of the nominal numbers."""
        out = self._values.copy()
        for label, value in zip(self.slot_labels, slots, strict=True):
            out[self._parameters.index(label)] = value
        for number, deviation in zip(self.nominal, deviations, strict=True):
            if not number.direction:
                out[self._parameters.index(number.name)] += deviation * number.std
        return out

    def _by_common(self) -> np.ndarray:
        out = np.zeros((len(self.varied), self.common))
        for k, label in enumerate(self.slot_labels):
            out[self.varied.index(label), k] = 1.0
        for k, number in enumerate(self.nominal, start=len(self.slot_labels)):
            if not number.direction:
                out[self.varied.index(number.name), k] = number.std
        return out

    def _noise(self, channel: str, joint: str) -> float:
        readings = self.problem.readings
        i = self.problem.robot.joint_names.index(joint)
        spread = float(np.nanstd(readings.recording.get(channel, joint)))
        return max(float(readings.noise[channel][i]), 1e-7 * spread, 1e-12)


def slot_label(effects: Sequence[Planned], slot: Slot) -> str:
    """The name effect.joint.parameter of a free number."""
    return labels(effects[slot.effect], slot.param.name, slot.param.size)[slot.component]


def _offsets(robot: Robot, effects: Sequence[Planned]) -> list[Planned]:
    """Encoder offsets that are free in each recording, as effects of the model."""
    if robot.file.offsets != "per_recording":
        return []
    taken = {e.key for e in (*robot.effects, *effects)}
    names = ("link_encoder_offset", "motor_encoder_offset")
    wanted = [(name, j.name) for j in robot.joints for name in names[j.rigid :]]
    return [effect(name, joint, offset=0.0) for name, joint in wanted if (name, joint) not in taken]
