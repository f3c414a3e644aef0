"""How far back the delays of a model look."""

from __future__ import annotations

from flexjoint.effects import SENSOR_CHANNELS
from flexjoint.model.dynamics import FlexibleJointModel


def longest_delay(model: FlexibleJointModel) -> float:
    """How far back delays of commands and readings may look, in any phase [s]."""
    flows = [flow for _, phase in model.phases for flow in phase.flows]
    command = max(flow.max_command_delay for flow in flows)
    reading = max(flow.max_reading_delay(channel) for flow in flows for channel in SENSOR_CHANNELS)
    return max(command, reading + model.robot.file.sensing_delay)
