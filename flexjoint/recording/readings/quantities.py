"""A recording in the quantities of its robot, with what is no reading left out: what all else begins with."""

from __future__ import annotations

from flexjoint.recording.readings.brakes import without_brakes
from flexjoint.recording.readings.currents import with_torques
from flexjoint.recording.readings.glitches import without_glitches
from flexjoint.recording.readings.turns import unwrapped
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot


def of_robot(robot: Robot, recording: Recording) -> Recording:
    """The recording with torques made of currents, without single readings that failed, with angles that do
    not jump by a turn, and without the torques of motors that are off while brakes hold the robot; the
    recording itself where there is none of that. Notes say what was done.

    Raises RecordingError for currents without constants (`currents.with_torques`)."""
    torques = with_torques(robot, recording)
    return without_brakes(robot, unwrapped(robot, without_glitches(robot, torques)))
