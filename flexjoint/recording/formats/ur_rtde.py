"""Universal Robots RTDE: the CSV that its Python client's record.py and ur_rtde's recording write.

Universal Robots, "Real-Time Data Exchange (RTDE) Guide": names, units and order of the output fields. A
vector of six is written as six columns, `actual_q_0` to `actual_q_5`, base first.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from flexjoint.recording.logs.log import Documented, Log, Signal

KIND = "Universal Robots RTDE"
GUIDE = "the RTDE guide says so"
JOINTS = (  # as ur_description calls base, shoulder, elbow and the wrists
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
FIELDS = {
    "actual_q": Documented("q", "rad", GUIDE),
    "actual_qd": Documented("dq", "rad/s", GUIDE),
    "target_q": Documented("q_ref", "rad", GUIDE),
    "actual_current": Documented("current", "A", GUIDE),
    "joint_temperatures": Documented("temperature", "deg C", GUIDE),
}


def is_one(names: Collection[str]) -> bool:
    """Whether columns of these names are those of RTDE."""
    return (
        any(f"{name}_0" in names for name in ("actual_q", "actual_qd", "target_q")) and "timestamp" in names
    )


def of_columns(source: str, signals: Mapping[str, Signal], notes: tuple[str, ...] = ()) -> Log:
    """The log of its columns, grouped."""
    notes = (
        (*notes, "target_moment is computed by the controller, not measured: not used")
        if "target_moment" in signals
        else notes
    )
    return Log(source, KIND, signals, FIELDS, "timestamp", "s", None, JOINTS, notes)
