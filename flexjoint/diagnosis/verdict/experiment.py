"""What to record next so that what is open gets decided."""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.diagnosis.result import Finding, Unexplained
from flexjoint.diagnosis.result.wording import cause, signal_name
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot


def advice(
    robot: Robot,
    recording: Recording,
    findings: Sequence[Finding],
    left: Sequence[Unexplained],
    blind: Sequence[tuple[str, str | None]],
) -> str:
    """A sentence: the sensor, load or motion that would break a tie or show what was not excited."""
    tied = [f for f in findings if f.indistinguishable]
    lacking = [
        f"{channel}.{joint.name}"
        for joint in robot.joints
        for channel in ("q", "theta", "tau_t")
        if not recording.has(channel, joint.name) and not joint.rigid
    ]
    if tied:
        first = tied[0]
        rivals = ", ".join(cause(t.effect, t.joint) for t in first.indistinguishable)
        own = [name for name in lacking if name.endswith(f".{first.joint}")] or lacking
        planned = (
            "a motion that is made for it (flexjoint plan --diagnosis), or this one with a known payload"
        )
        extra = f"measure {own[0]} too" if own else planned
        return f"To tell {cause(first.effect, first.joint)} from {rivals}: {extra}."
    if left:
        # with a push in it, a recording shows what else there is only beside it
        rigid = all(joint.rigid for joint in robot.joints)
        worst = next((one for one in left if one.begin is not None), left[0])
        if worst.begin is not None and worst.end is not None:
            return (
                f"Find out what pushed at {worst.joint} from {worst.begin:.1f} to {worst.end:.1f} s, and"
                " record again without it; the recording without that stretch shows what else there is."
            )
        return (
            f"Record slow and fast sweeps of {worst.joint} over its whole range: what is left of its"
            f" {worst.balance} balance depends on {signal_name(worst.against, rigid)}."
            + _side_of_encoder(robot, recording, worst.joint)
        )
    if blind:
        joints = sorted({joint for _, joint in blind if joint is not None})
        where = f" of {', '.join(joints)}" if joints else ""
        return f"For what was not excited: a motion{where} with reversals, high load and full range."
    return ""


def _side_of_encoder(robot: Robot, recording: Recording, joint: str) -> str:
    """What a log with a rigid joint's `q` alone leaves open: at the link, an encoder sees no bending."""
    if not robot.joint(joint).rigid or recording.has("theta", joint):
        return ""
    return f" If a motor reads q.{joint}, name it theta.{joint}: whether the joint bends is looked for then."
