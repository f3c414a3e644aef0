"""A log and its mapping to a recording, with an account of what was understood, and why.

What the source, its format or the user states is taken. What nobody states is decided by evidence that is
printed, and where the evidence leaves a doubt it is asked for: the message names the option that answers it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from flexjoint.core.errors import RecordingError
from flexjoint.core.text import Block, Line, Table, plain
from flexjoint.recording.checks import all_joints, check_columns, keeps_one_sign
from flexjoint.recording.clock import without_pauses
from flexjoint.recording.logs import units
from flexjoint.recording.logs.log import ELEMENT, Documented, Log, Signal, last_part, named
from flexjoint.recording.logs.mapping import EMPTY, ChannelEntry, MappingFile, by_joint
from flexjoint.recording.messages import refusal, shown
from flexjoint.recording.readings.channels import lag_of
from flexjoint.recording.stamps import SLOWEST
from flexjoint.recording.table import UNITS, Recording, make
from flexjoint.robot.robot import Robot

ONE_TURN = 6.6  # rad within which angles without a stated unit count as radians: one turn, and 5 %
TWO_TURNS = 13.2  # rad beyond which stated radians are doubted: few joints turn so far, degrees soon do
LIKE = 0.5  # share by which the slope of theta over q may differ from 1 at the same side of the gear
LIKE_GEAR = 0.2  # ... and from a stated gear ratio; gears of one robot differ by more
MOVES = 1e-3  # rad (or m) of standard deviation, below which a slope says nothing
SAME_TICK = 1e-3  # share of a period by which stamps of two signals may differ and be one clock
BRIDGED = 2.5  # periods of a signal over which it is interpolated to another clock; beyond is a gap
GAP = 1.5  # periods, from which on a step is a gap

AT_MOTOR = {
    "q": "theta",
    "dq": "dtheta",
    "q_ref": "theta_ref",
}  # what an encoder at the motor makes of a name
MOTOR_SIDE = ("theta", "dtheta", "theta_ref", "dtheta_ref")


@dataclass(frozen=True)
class Imported:
    """A recording, and what was understood of the log that it came from."""

    recording: Recording
    account: tuple[Block, ...]

    def __str__(self) -> str:
        return plain(self.account)


@dataclass(frozen=True)
class _Source:
    """Where samples of one channel come from."""

    channel: str
    name: str
    signal: Signal
    entry: ChannelEntry | None
    documented: Documented | None
    joints: tuple[str, ...] = ()
    naming: str = ""  # why the columns are of these joints
    values: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))  # (N, k)
    unit: str = ""
    how: tuple[str, ...] = ()  # what was done to the values, and why

    def done(self, values: np.ndarray, *how: str) -> _Source:
        return replace(self, values=values, how=(*self.how, *how))

    @property
    def dimension(self) -> str:
        return units.dimension(self.channel)

    @property
    def explicit(self) -> bool:
        """Whether the mapping states the unit of this channel."""
        return self.entry is not None and self.entry.unit is not None


def converted(log: Log, mapping: MappingFile = EMPTY, robot: Robot | None = None) -> Imported:
    """The recording that a log makes with its mapping.

    Args:
        robot: names joints in its order where the log names none, leaves out those that it does not have, and
            gives gear ratios and torque constants that nobody else states.

    Raises RecordingError with the option or the key that answers a doubt.
    """
    sources = [_named(log, mapping, robot, source) for source in _sources(log, mapping, robot)]
    _refuse_twice(log, sources)
    stamps = [_stamps(log, mapping, source) for source in sources]
    log = _outline(log)
    _one_by_one(sources, lambda source: _in_unit(log, mapping, robot, source))
    _one_by_one(sources, lambda source: _velocity_in_unit(log, robot, source, sources))
    sources = _at_the_link(log, mapping, robot, sources)
    _one_by_one(sources, lambda source: _signed(log, source))
    time, clock, aligned, notes = _one_clock(log, mapping, sources, stamps)
    columns = {
        (source.channel, joint): values[:, k]
        for source, values in zip(sources, aligned, strict=True)
        for k, joint in enumerate(source.joints)
    }
    recording = make(time, columns, log.source)
    check_columns(robot, without_pauses(recording))
    return Imported(recording, tuple(_account(log, mapping, sources, recording, clock, notes)))


def _outline(log: Log) -> Log:
    """The log without its samples, which the sources hold by then: a large log is in memory once."""
    signals = {
        name: replace(signal, values=np.empty((0, signal.values.shape[1])))
        for name, signal in log.signals.items()
    }
    return replace(log, signals=signals)


def _one_by_one(sources: list[_Source], step: Callable[[_Source], _Source]) -> None:
    """Each source replaced by what a step makes of it, so that no more than one is in memory twice."""
    for k, source in enumerate(sources):
        sources[k] = step(source)


# --- which signal is which channel --------------------------------------------------------------------------
def _sources(log: Log, mapping: MappingFile, robot: Robot | None) -> list[_Source]:
    if mapping.channels:
        return [
            _Source(channel, _said(entry.source), _found(log, entry), entry, None)
            for channel, entry in mapping.channels.items()
        ]
    documented = dict(log.documented)
    for name in log.signals:
        if not log.documented and last_part(name) in UNITS:
            documented[name] = Documented(last_part(name), None, "its name is that of the channel")
    found = [
        _documented(log, mapping, robot, name, known)
        for name, known in documented.items()
        if name in log.signals
    ]
    if not found:
        raise refusal(
            log.source,
            f"which signal is which channel? Write a mapping (docs/reference/formats.md) for --mapping; it"
            f" holds {named(list(log.signals))}",
        )
    return found


def _documented(log: Log, mapping: MappingFile, robot: Robot | None, name: str, known: Documented) -> _Source:
    """The source of a signal that its format or its name explains."""
    signal = log.signals[name]
    if known.channel in AT_MOTOR and known.side is None:
        channel, why = _side_of_encoder(log, mapping, robot, name, known)
        # numbers of the joint, wherever the encoder is
        return _Source(channel, name, signal, None, replace(known, side="link"), how=(why,))
    channel = known.channel
    if channel == "current" and mapping.torque_constant is not None:
        channel = "tau_motor"
    return _Source(channel, name, signal, None, known)


def _said(source: str | tuple[str, ...]) -> str:
    return source if isinstance(source, str) else ", ".join(source)


def _found(log: Log, entry: ChannelEntry) -> Signal:
    """The signal of an entry, or its columns put side by side."""
    if isinstance(entry.source, str):
        return log.find(entry.source)
    parts = [log.find(name) for name in entry.source]
    for name, part in zip(entry.source, parts, strict=True):
        if part.values.shape[1] != 1:
            raise refusal(
                log.source,
                f"from: {shown(name)} has {part.values.shape[1]} columns; a list names single ones",
            )
        if part.values.shape != parts[0].values.shape:
            raise refusal(log.source, f"from: {shown(name)} has another number of samples than the others")
    if not parts:
        raise refusal(log.source, "from: an empty list; name a signal, or one column a joint")
    joints = tuple(part.joints[0] for part in parts) if all(part.joints for part in parts) else ()
    return Signal(np.hstack([part.values for part in parts]), entry.source, joints, parts[0].stamps)


def _side_of_encoder(
    log: Log, mapping: MappingFile, robot: Robot | None, name: str, known: Documented
) -> tuple[str, str]:
    """q or theta of a position whose encoder the format does not say; of a rigid joint both are the same."""
    if mapping.encoder == "motor":
        return AT_MOTOR[known.channel], "encoder at the motor, as stated"
    if mapping.encoder == "link":
        return known.channel, "encoder at the link, as stated"
    if robot is not None and not all(joint.rigid for joint in robot.joints):
        raise refusal(
            log.source,
            f"{shown(name)}: {log.format} does not say on which side of the springs the encoder is; give"
            " --encoder motor or --encoder link",
        )
    return known.channel, "taken as the link's: --encoder motor if it is the motor's"


def _of(source: _Source) -> str:
    """A channel and the signal that it comes from, in a message."""
    return source.channel if source.name == source.channel else f"{source.channel} ({shown(source.name)})"


# --- joints -------------------------------------------------------------------------------------------------
def _named(log: Log, mapping: MappingFile, robot: Robot | None, source: _Source) -> _Source:
    """The joints of a signal's columns."""
    count = source.signal.values.shape[1]
    own = source.entry.joints if source.entry is not None else None
    valid = all_joints(robot) if robot is not None else None
    values = source.signal.values
    if own is not None:
        names, why = own, "named by the mapping"
    elif source.signal.joints:
        names, why = tuple(mapping.rename.get(j, j) for j in source.signal.joints), "named by the log"
        if valid is not None and any(name in valid for name in names):
            keep = [k for k, name in enumerate(names) if name in valid]
            left = [name for name in names if name not in valid]
            names, values = tuple(names[k] for k in keep), values[:, keep]
            count = len(keep)
            why += f", without {named(left)}, which the robot does not have" if left else ""
    elif mapping.joints is not None:
        names, why = mapping.joints, "in the order that was stated"
    else:
        names, why = _by_order(log, mapping, robot, count)
    if not names:
        raise refusal(
            log.source,
            f"{shown(source.name)} has {count} columns and the log does not say of which joints; give"
            f" --joints"
            " NAME,NAME,... in their order, or --robot",
        )
    if len(names) != count:
        raise refusal(
            log.source,
            f"{shown(source.name)} has {count} columns, but {len(names)} joints are named: {named(names)}",
        )
    if len(set(names)) != len(names):
        raise refusal(log.source, f"{shown(source.name)}: a joint is named twice: {named(names)}")
    signal = replace(source.signal, values=np.empty((0, count)))
    return replace(
        source, signal=signal, joints=tuple(names), naming=why, values=np.asarray(values, dtype=float)
    )


def _by_order(log: Log, mapping: MappingFile, robot: Robot | None, count: int) -> tuple[tuple[str, ...], str]:
    """Names by the order of the format or of the robot, where their number fits."""
    named_by_format = tuple(mapping.rename.get(joint, joint) for joint in log.joints)
    if len(named_by_format) == count and (
        robot is None or all(joint in all_joints(robot) for joint in named_by_format)
    ):
        return named_by_format, "named by the log's format"
    if robot is not None and len(robot.joint_names) == count:
        return robot.joint_names, f"in the order of {robot.name}: the log does not name them"
    return (), ""


def _refuse_twice(log: Log, sources: Sequence[_Source]) -> None:
    seen: dict[tuple[str, str], str] = {}
    for source in sources:
        for joint in source.joints:
            other = seen.setdefault((source.channel, joint), source.name)
            if other != source.name:
                raise refusal(
                    log.source,
                    f"{source.channel}.{shown(joint)} is in {shown(other)} and in {shown(source.name)};"
                    f" name one"
                    " of them under `channels` in a mapping",
                )


# --- units --------------------------------------------------------------------------------------------------
def _in_unit(log: Log, mapping: MappingFile, robot: Robot | None, source: _Source) -> _Source:
    """The values in the unit of a recording; velocities that state none wait for their positions."""
    kind = source.dimension
    unit, why = _stated_unit(mapping, source)
    if kind == "velocity" and unit is None:
        return source
    if kind == "angle" and unit is None:
        reach = _reach(source, robot)
        if reach > ONE_TURN:
            raise _asked_unit(log, source, reach)
        unit, why = "rad", f"no joint beyond {reach:.3g}, so within one turn: --degrees if not"
    if unit is None:
        unit, why = UNITS[source.channel], "nothing else is stated"
    source = _scaled(source, robot, unit, why)
    doubtful = kind == "angle" and mapping.angles is None and not source.explicit and unit == "rad"
    if doubtful and not _of_rotor(source) and source.channel not in MOTOR_SIDE:
        reach = _reach(source, robot)
        if reach > TWO_TURNS:
            raise _asked_unit(log, source, reach)
    return source


def _velocity_in_unit(log: Log, robot: Robot | None, source: _Source, sources: Sequence[_Source]) -> _Source:
    """A velocity whose unit nobody states has that of the positions beside it."""
    if source.dimension != "velocity" or source.unit:
        return source
    beside = [o for o in sources if o.dimension == "angle" and set(o.joints) & set(source.joints)]
    found = {units.OF_ANGLE.get(other.unit, "rad/s") for other in beside}
    if len(found) > 1:
        raise refusal(
            log.source,
            f"{shown(source.name)}: is it in {' or '.join(sorted(found))}? State its unit in a mapping",
        )
    unit = found.pop() if found else "rad/s"
    return _scaled(source, robot, unit, "as the positions" if beside else "nothing else is stated")


def _stated_unit(mapping: MappingFile, source: _Source) -> tuple[str | None, str]:
    """The unit that somebody states, and who."""
    if source.entry is not None and source.entry.unit is not None:
        return source.entry.unit, "stated by the mapping"
    if mapping.angles is not None and source.dimension in ("angle", "velocity"):
        unit = mapping.angles if source.dimension == "angle" else units.OF_ANGLE[mapping.angles]
        return unit, "as stated"
    listed = source.entry.source if source.entry is not None else source.name
    names = (listed,) if isinstance(listed, str) else listed
    ends = {units.of_name(source.channel, ELEMENT.sub(r"\g<signal>", name)) for name in names}
    if len(ends) == 1 and None not in ends:
        return ends.pop(), "its name says so"
    if source.documented is not None and source.documented.unit is not None:
        return source.documented.unit, source.documented.why
    return None, ""


def _scaled(source: _Source, robot: Robot | None, unit: str, why: str) -> _Source:
    factor = np.full(len(source.joints), units.factor(source.channel, unit))
    if robot is not None and source.dimension in ("angle", "velocity") and unit not in units.LENGTHS:
        factor[[joint in robot.prismatic for joint in source.joints]] = (
            1.0  # of joints that slide: m as they are
        )
    said = f"{unit}: {why}"
    values = source.values if np.all(factor == 1.0) else source.values * factor
    return replace(source.done(values, said), unit=unit)


def _reach(source: _Source, robot: Robot | None) -> float:
    """The largest angle of any joint that turns."""
    columns = (
        np.abs(values)
        for joint, values in zip(source.joints, source.values.T, strict=True)
        if robot is None or joint not in robot.prismatic
    )
    return max((float(np.max(c, initial=0.0, where=np.isfinite(c))) for c in columns), default=0.0)


def _asked_unit(log: Log, source: _Source, reach: float) -> RecordingError:
    rotor = (
        ", or --gear RATIO if these are turns of the rotor, before the gear"
        if source.channel in MOTOR_SIDE
        else ""
    )
    return refusal(
        log.source,
        f"{_of(source)} reaches {reach:.4g}: degrees, or radians of more than a"
        f" turn?"
        f" Give --degrees or --radians{rotor}",
    )


# --- sides of the gear --------------------------------------------------------------------------------------
def _of_rotor(source: _Source) -> bool:
    """Whether somebody states that the numbers are the rotor's, before the gear."""
    if source.entry is not None and source.entry.side is not None:
        return source.entry.side == "motor"
    return source.documented is not None and source.documented.side == "motor"


def _at_the_link(
    log: Log, mapping: MappingFile, robot: Robot | None, sources: Sequence[_Source]
) -> list[_Source]:
    """All values as seen from the link."""
    out = []
    for source in sources:
        if source.unit in units.CURRENTS and source.dimension == "torque":
            out.append(_from_current(log, mapping, robot, source))
        elif source.dimension == "torque" and _of_rotor(source):
            gear, why = _gear(log, mapping, robot, source, "torques of the rotor")
            out.append(source.done(source.values * gear, f"times the gear ratio {_numbers(gear)} ({why})"))
        elif source.dimension in ("angle", "velocity"):
            out.append(_position_at_the_link(log, mapping, robot, source, sources))
        else:
            out.append(source)
    return out


def _position_at_the_link(
    log: Log, mapping: MappingFile, robot: Robot | None, source: _Source, sources: Sequence[_Source]
) -> _Source:
    of_rotor, why = _of_rotor(source), ""
    if _open(source):
        of_rotor, why = _turns_with_rotor(log, mapping, robot, source, sources)
    if not of_rotor:
        return source.done(source.values, why) if why else source
    if source.channel not in MOTOR_SIDE:
        raise refusal(
            log.source,
            f"{source.channel} is of the link, but side: motor is stated; call the channel"
            f" {AT_MOTOR[source.channel]}",
        )
    gear, said = _gear(log, mapping, robot, source, "turns of the rotor")
    how = f"divided by the gear ratio {_numbers(gear)} ({said})"
    return source.done(source.values / gear, f"{why}: {how}" if why else how)


def _open(source: _Source) -> bool:
    """Whether nobody states the side of a motor's position."""
    said = source.entry is not None and source.entry.side is not None
    known = source.documented is not None and source.documented.side is not None
    return source.channel in MOTOR_SIDE and not said and not known


def _turns_with_rotor(
    log: Log, mapping: MappingFile, robot: Robot | None, source: _Source, sources: Sequence[_Source]
) -> tuple[bool, str]:
    """Whether a motor's position without a stated side is the rotor's, by its slope over the link's, or by
    how far it turns; and the evidence."""
    position = next(
        (o for o in sources if o.channel in ("theta", "theta_ref") and set(o.joints) & set(source.joints)),
        None,
    )
    if position is None:
        return False, "taken as seen from the link: no position beside it says otherwise"
    if not _open(position):
        return _of_rotor(position), f"as {position.channel}"
    gear = mapping.gear_ratio
    slopes = _slopes(position, sources)
    turned = [_turned(log, mapping, position, joint, slope) for joint, slope in slopes.items()]
    if turned:
        sides = f"{min(slopes.values()):.4g} to {max(slopes.values()):.4g}"
        return any(turned), f"moves {sides} times as far as the link"
    reach = _reach(position, robot)
    explicit = position.explicit or mapping.angles is not None
    if gear is None and reach <= TWO_TURNS:
        return False, f"{position.channel} stays within {reach:.3g}, so seen from the link"
    if gear is None and not explicit:
        raise _asked_unit(log, position, reach)
    if gear is None:
        raise refusal(
            log.source,
            f"{_of(position)} reaches {reach:.4g} rad: turns of the rotor before the gear? Give --gear"
            f" RATIO, or"
            " state side: link in a mapping",
        )
    if reach <= TWO_TURNS:
        raise refusal(
            log.source,
            f"{_of(position)} reaches {reach:.4g} rad and a gear ratio is stated: state side: motor"
            f" (before the"
            f" gear) or side: link for {position.channel} in a mapping",
        )
    return True, f"{position.channel} reaches {reach:.4g} rad, so turns of the rotor"


def _turned(log: Log, mapping: MappingFile, position: _Source, joint: str, slope: float) -> bool:
    """Whether a joint's motor position is the rotor's, by its slope over the link's."""
    ratios = by_joint(mapping.gear_ratio, position.joints, "gear_ratio", log.source)
    stated = None if ratios is None else ratios[position.joints.index(joint)]
    theta, q = f"{position.channel}.{shown(joint)}", f"q.{shown(joint)}"
    if abs(slope - 1.0) < LIKE:
        return False
    if stated is not None and abs(slope / stated - 1.0) < LIKE_GEAR:
        return True
    if abs(slope + 1.0) < LIKE:
        raise refusal(
            log.source,
            f"{theta} turns against {q} (slope {slope:.3g}): state sign: -1 for {position.channel} in a"
            f" mapping",
        )
    raise refusal(
        log.source,
        f"{theta} moves {slope:.4g} times as far as {q}: turns of the rotor before the gear? Give --gear"
        f" {slope:.4g} (or one number a joint)",
    )


def _slopes(position: _Source, sources: Sequence[_Source]) -> dict[str, float]:
    """Slope of a motor's position over the link's, by joint that has both on one clock and moves."""
    out = {}
    for other in sources:
        if other.channel != ("q" if position.channel == "theta" else "q_ref"):
            continue
        for joint in position.joints:
            if joint not in other.joints or other.values.shape[0] != position.values.shape[0]:
                continue
            theta = position.values[:, position.joints.index(joint)]
            q = other.values[:, other.joints.index(joint)]
            both = np.isfinite(q) & np.isfinite(theta)
            if np.count_nonzero(both) > 2 and np.std(q[both]) > MOVES:
                centred = q[both] - np.mean(q[both])
                out[joint] = float(centred @ theta[both] / (centred @ centred))
    return out


def _from_current(log: Log, mapping: MappingFile, robot: Robot | None, source: _Source) -> _Source:
    """Torques at the link from currents [A]: times torque constant and gear ratio."""
    constant, said = _constant(log, mapping, robot, source)
    gear, why = _gear(log, mapping, robot, source, "torques from currents")
    return source.done(
        source.values * constant * gear,
        f"times {_numbers(constant)} N m/A ({said}) and the gear ratio {_numbers(gear)} ({why})",
    )


def _constant(log: Log, mapping: MappingFile, robot: Robot | None, source: _Source) -> tuple[np.ndarray, str]:
    missing = (
        f"{_of(source)} is a current: give --torque-constant N_M_PER_A of the rotor (its data sheet) and"
        " --gear RATIO, or map it to the channel `current`"
    )
    return _stated(log, mapping, robot, source, "torque_constant", missing)


def _gear(
    log: Log, mapping: MappingFile, robot: Robot | None, source: _Source, what: str
) -> tuple[np.ndarray, str]:
    missing = (
        f"{_of(source)} holds {what}: give --gear RATIO, rotor turns per turn of the joint (or one number a"
        " joint)"
    )
    return _stated(log, mapping, robot, source, "gear_ratio", missing)


def _stated(
    log: Log, mapping: MappingFile, robot: Robot | None, source: _Source, name: str, missing: str
) -> tuple[np.ndarray, str]:
    """A number of each joint, and who states it: the entry of its signal, the mapping or an option, the robot
    file. Raises RecordingError with what is `missing` where nobody does."""
    own = None if source.entry is None else getattr(source.entry, name)
    for given, why in ((own, "stated by the mapping"), (getattr(mapping, name), "as stated")):
        numbers = by_joint(given, source.joints, name, log.source)
        if numbers is not None:
            return np.array(numbers), why
    found = _of_robot(robot, source.joints, name)
    if found is not None:
        return found, "of the robot file"
    raise refusal(log.source, missing)


def _of_robot(robot: Robot | None, joints: Sequence[str], key: str) -> np.ndarray | None:
    if robot is None or any(joint not in robot.joint_names for joint in joints):
        return None
    values = [getattr(robot.joint(joint), key) for joint in joints]
    return None if any(value is None for value in values) else np.array(values, dtype=float)


def _signed(log: Log, source: _Source) -> _Source:
    """Signs and offsets of the mapping."""
    entry = source.entry
    if entry is None:
        return source
    sign = by_joint(entry.sign, source.joints, "sign", log.source)
    if sign is not None and min(sign) < 0.0:
        turned = named([j for j, s in zip(source.joints, sign, strict=True) if s < 0.0])
        source = source.done(source.values * np.array(sign), f"sign turned for {turned}")
    offset = by_joint(entry.offset, source.joints, "offset", log.source)
    if offset is not None:
        source = source.done(source.values + np.array(offset), f"plus {_numbers(np.array(offset))}")
    return source


def _numbers(values: np.ndarray) -> str:
    """One number where all are the same."""
    return f"{values[0]:.6g}" if np.ptp(values) == 0.0 else ", ".join(f"{value:.6g}" for value in values)


# --- clocks -------------------------------------------------------------------------------------------------
def _one_clock(
    log: Log, mapping: MappingFile, sources: Sequence[_Source], clocks: Sequence[tuple[np.ndarray, str]]
) -> tuple[np.ndarray, str, list[np.ndarray], list[str]]:
    """Stamps (N,), what they are, the values (N, k) of each source on them, and notes."""
    stamps, clock = zip(*clocks, strict=True)
    unit = mapping.time_unit or log.time_unit
    first = max(
        range(len(sources)), key=lambda i: (sources[i].channel in ("q", "theta"), sources[i].values.shape[0])
    )
    main, origin = stamps[first], stamps[first][0] if stamps[first].size else 0
    aligned, notes = [], []
    for source, own in zip(sources, stamps, strict=True):
        if own.size != source.values.shape[0]:
            raise refusal(
                log.source, f"{shown(source.name)} has {source.values.shape[0]} samples, its clock {own.size}"
            )
        if own is main or np.array_equal(own, main):
            aligned.append(source.values)
            continue
        ours, theirs = _seconds(main, origin, unit), _seconds(own, origin, unit)
        period = float(np.median(np.diff(ours))) if ours.size > 1 else 0.0
        if own.size == main.size and np.max(np.abs(ours - theirs)) <= SAME_TICK * period:
            aligned.append(source.values)
            continue
        aligned.append(_interpolated(log, source, ours, theirs))
        rate = 1.0 / float(np.median(np.diff(theirs)))
        notes.append(
            f"{source.channel} ({source.name}) has a clock of its own ({rate:.4g} Hz): interpolated"
            f" linearly onto that of"
            f" {sources[first].channel}; gaps stay empty"
        )
    if unit is None:
        return main, clock[first], aligned, notes
    return _seconds(main, origin, unit), f"{clock[first]} [{unit}]", aligned, notes


def _stamps(log: Log, mapping: MappingFile, source: _Source) -> tuple[np.ndarray, str]:
    count = source.values.shape[0]
    if mapping.time is not None:
        table = log.find(mapping.time).values
        if table.shape[1] != 1:
            raise refusal(
                log.source, f"time: {shown(mapping.time)} has {table.shape[1]} columns, expected one"
            )
        return table[:, 0], f"{mapping.time}, as the mapping states"
    if mapping.rate is not None:
        return np.arange(count) / mapping.rate, f"{mapping.rate:g} Hz, as the mapping states"
    if source.signal.stamps is not None:
        return source.signal.stamps, f"stamps of {source.name}"
    if log.time is not None:
        return log.signals[log.time].values[:, 0], log.time
    if log.rate is not None:
        return np.arange(count) / log.rate, f"{log.rate:g} Hz, as {log.format} states"
    raise refusal(
        log.source,
        "has no signal that is called time, t or timestamp: name its clock in a mapping (time: NAME), or"
        " its rate"
        " (rate: HZ)",
    )


def _seconds(stamps: np.ndarray, origin: Any, unit: str | None) -> np.ndarray:
    """Stamps in seconds; whole numbers of a unit exactly, from the origin."""
    if stamps.dtype.kind in "iu":
        since = stamps.astype(np.int64) - int(origin)
        return since / units.TIME_UNITS[unit or "s"]
    return np.asarray(stamps, dtype=float) / units.TIME_UNITS[unit or "s"]


def _interpolated(log: Log, source: _Source, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    known = np.isfinite(theirs)
    at = theirs[known]
    if at.size < 2 or np.any(np.diff(at) <= 0.0):
        raise refusal(
            log.source,
            f"the stamps of {shown(source.name)} do not increase strictly, and it has to be put on"
            f" another clock; leave"
            " it out with a mapping",
        )
    reach = BRIDGED * float(np.median(np.diff(at)))
    after = np.clip(np.searchsorted(at, ours), 1, at.size - 1)
    inside = (ours >= at[0]) & (ours <= at[-1]) & (at[after] - at[after - 1] <= reach)
    out = np.full((ours.size, source.values.shape[1]), np.nan)
    for k, column in enumerate(source.values[known].T):
        out[inside, k] = np.interp(ours[inside], at, column)
    return out


# --- the account --------------------------------------------------------------------------------------------
def _account(
    log: Log,
    mapping: MappingFile,
    sources: Sequence[_Source],
    recording: Recording,
    clock: str,
    notes: Sequence[str],
) -> list[Block]:
    blocks: list[Block] = [Line(f"{log.source}: {log.format}", whole=True), Line(_clock(recording, clock))]
    orders: dict[tuple[tuple[str, ...], str], list[str]] = {}
    for source in sources:
        orders.setdefault((source.joints, source.naming), []).append(source.channel)
    for (joints, naming), channels in orders.items():
        of = f"joints of {', '.join(channels)}" if len(orders) > 1 else "joints"
        blocks.append(Line(f"{of}: {named(joints)} ({naming})"))
    rows = tuple((s.channel, UNITS[s.channel], shown(s.name), "\n".join(s.how)) for s in sources)
    blocks.append(
        Table((("channel", False), ("unit", False), ("from", False), ("how, and why", False)), rows)
    )
    used = {source.name for source in sources} | {mapping.time or log.time or ""}
    used |= {ELEMENT.sub(r"\g<signal>", column) for source in sources for column in source.signal.columns}
    used |= {column for source in sources for column in source.signal.columns}
    left = [n for n, s in log.signals.items() if n not in used and not set(s.columns) & used]
    if left:
        blocks.append(Line(f"not used: {named(left)}"))
    said = " ".join(text for source in sources for text in source.how)
    unused = [
        f"{key} is stated, and no channel needs it"
        for key, words in (("gear_ratio", "gear ratio"), ("torque_constant", "N m/A"))
        if getattr(mapping, key) is not None and words not in said
    ]
    lines = [*log.notes, *notes, *unused, *recording.notes, *_doubts(recording)]
    return [*blocks, *(Line(line) for line in lines)]


def _clock(recording: Recording, clock: str) -> str:
    steps = np.diff(recording.time)
    gaps = steps[steps > GAP * recording.period]
    lost = f"; {gaps.size} gaps, the longest {np.max(gaps):.3g} s" if gaps.size else "; no gaps"
    return (
        f"clock: {clock}; {recording.time.size} samples in {recording.duration:.4g} s,"
        f" {1.0 / recording.period:.4g} Hz"
        f"{lost}"
    )


def _doubts(recording: Recording) -> list[str]:
    """What a diagnosis will not use, or refuse, said early."""
    out = []
    if recording.period > (1.0 + 1e-9) / SLOWEST:
        out.append(f"slower than {SLOWEST:g} Hz: a diagnosis refuses it; record faster")
    for velocity, position in (("dq", "q"), ("dtheta", "theta")):
        for joint in recording.joints:
            if recording.has(velocity, joint) and recording.has(position, joint):
                lag = lag_of(recording.time, recording.get(position, joint), recording.get(velocity, joint))
                if lag is not None:
                    out.append(
                        f"{velocity}.{joint} lags the derivative of {position}.{joint} by {1e3 * lag:.2g}"
                        f" ms: a"
                        " filtered velocity, which a diagnosis does not use"
                    )
    one = [
        f"{channel}.{joint}"
        for channel, joint in recording.columns
        if channel in ("tau_motor", "tau_m", "current") and keeps_one_sign(recording.get(channel, joint))
    ]
    if one:
        out.append(f"{named(one)} keeps one sign: as gravity may make it, or a current without its sign")
    return out
