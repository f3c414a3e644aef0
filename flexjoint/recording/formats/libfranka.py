"""libfranka: the CSV of `franka::logToCSV`, of the log that a ControlException carries.

libfranka, include/franka/robot_state.h: names, units and sides; time is written in milliseconds.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from flexjoint.recording.logs.log import Documented, Log, Signal

KIND = "libfranka log"
GUIDE = "libfranka's robot_state.h says so"
FIELDS = {
    "state.q": Documented("q", "rad", GUIDE, "link"),
    "state.dq": Documented("dq", "rad/s", GUIDE, "link"),
    "state.theta": Documented("theta", "rad", GUIDE, "link"),
    "state.dtheta": Documented("dtheta", "rad/s", GUIDE, "link"),
    "state.q_d": Documented("q_ref", "rad", GUIDE, "link"),
    "state.tau_J": Documented("tau_t", "N m", "the torque sensors at the link side, by robot_state.h"),
}


def is_one(names: Collection[str]) -> bool:
    """Whether columns of these names are those of libfranka."""
    return {"time", "state.q[0]", "success_rate"} <= set(names)


def of_columns(source: str, signals: Mapping[str, Signal], notes: tuple[str, ...] = ()) -> Log:
    """The log of its columns, grouped."""
    if "cmd.tau_J_d" in signals:
        notes = (*notes, "cmd.tau_J_d is without gravity and friction, so no motor torque: not used")
    return Log(source, KIND, signals, FIELDS, "time", "ms", notes=notes)
