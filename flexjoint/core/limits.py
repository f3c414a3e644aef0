"""Every limit on what is read, with its unit and its reason; `make docs` writes docs/reference/limits.md.

What lies beyond is refused in one line before any work grows with it. A robot, a log or a machine that needs
more has not been seen; who has one raises the number here.
"""

from __future__ import annotations

from dataclasses import Field, dataclass, field, fields
from typing import Any


def limit(value: Any, unit: str, reason: str) -> Any:
    """A field of limits: its value, its unit, and why there."""
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class RecordingLimits:
    """A recording, and a table of poses."""

    rows: int = limit(50, "rows, least", "fewer decide nothing")
    columns: int = limit(2000, "columns", "the 13 channels of 150 joints")
    cells: int = limit(100_000_000, "cells", "0.8 GB as numbers: an hour of 27 columns at 1 kHz")
    csv_bytes: int = limit(2_000_000_000, "bytes", "of a CSV, whose cells are not known before it is read")
    header_bytes: int = limit(200_000, "bytes", "of a CSV's first line: 2000 names of 100")
    value: float = limit(1e9, "unit of the channel", "no sensor shows more, and fourth powers stay finite")
    time: float = limit(1e10, "s", "seconds since 1970 are 2e9; float64 resolves 2 us here")
    ticks_per_row: float = limit(
        10.0, "periods", "beyond it a recording, or a reference to simulate, is more gaps than samples"
    )
    held: float = limit(100.0, "s", "a reference of few samples may hold one so long before that is a gap")
    poses: int = limit(1_000_000, "rows", "of a table of poses: each costs an equilibrium")


@dataclass(frozen=True)
class RobotFileLimits:
    """A robot file, and the mapping of a log (YAML)."""

    file_bytes: int = limit(1_000_000, "bytes", "a hundred times the largest shipped one")
    nodes: int = limit(20_000, "values", "aliases counted as what they stand for: 400 joints of 50 values")
    depth: int = limit(30, "levels", "the form has six; `sources` is free")
    number: float = limit(1e12, "SI units", "squares of numbers stay finite; .inf where a limit is none")
    positive: float = limit(1e-9, "SI units", "of what must be above zero: its inverse stays finite")
    slowest_rate: float = limit(1.0, "Hz", "of physics and control: a tick a second controls nothing")
    fastest_rate: float = limit(1e6, "Hz", "of physics and control: a microsecond a step")


@dataclass(frozen=True)
class DescriptionLimits:
    """A description (URDF, MJCF, SDF)."""

    file_bytes: int = limit(20_000_000, "bytes", "forty times that of a robot with 130 links")
    elements: int = limit(100_000, "elements", "25 times those of a robot with 130 links")
    depth: int = limit(200, "levels", "parsers recurse on it; an MJCF nests its bodies")
    attributes: int = limit(100, "attributes of an element", "the formats know thirty")
    bodies: int = limit(
        1000, "links or bodies", "eight times those of the largest humanoid of example-robot-data"
    )
    chain: int = limit(200, "joints in a row", "parsers recurse on it; a hand on a humanoid has 15")
    text: int = limit(10_000, "characters of an attribute", "a mesh's path, or a row of numbers")
    number: float = limit(1e12, "SI units", "of masses, inertias, places and axes")
    mesh_bytes: int = limit(
        30_000_000,
        "bytes of a mesh",
        "the largest of example-robot-data has 28.8e6; one of 200e6 held `view` for two minutes",
    )
    mesh_triangles: int = limit(
        400_000,
        "triangles of a mesh",
        "the largest of example-robot-data has 351394, read in 4 s; 3.4e6, as many as 30e6 bytes hold, took"
        " 100 s and 2.4 GB",
    )


@dataclass(frozen=True)
class DiagnosisFileLimits:
    """A diagnosis as JSON, which `plan` reads."""

    file_bytes: int = limit(20_000_000, "bytes", "a diagnosis of 40 joints with its trace has 1e6")
    findings: int = limit(1000, "causes", "an effect for each of 30 joints is 40")


@dataclass(frozen=True)
class PlanningLimits:
    """Reach and speed of a planned motion."""

    least: float = limit(1e-3, "rad, rad/s", "no sensor sees less")
    most: float = limit(1e3, "rad, rad/s", "no joint goes further, or faster")


@dataclass(frozen=True)
class SimulationLimits:
    """A simulation along a reference."""

    joint_steps: float = limit(3e7, "steps times joints", "an hour of 8 joints at 1 kHz; each is 250 bytes")


@dataclass(frozen=True)
class CompilingLimits:
    """Compiling, and the cache of compiled models."""

    note: float = limit(20.0, "s", "of compiling, after which a line says what is waited for")
    longest: float = limit(120.0, "s", "of compiling; the largest shipped robot takes 6 s on an idle core")
    asked: float = limit(20.0, "s", "for a compiler to say its version")
    stale_build: float = limit(3600.0, "s", "after which a build in the cache was killed, and is removed")
    libraries: int = limit(
        500, "libraries", "kept in the cache: some tens of kilobytes each, up to 1e6 bytes"
    )


RECORDING, ROBOT_FILE, DESCRIPTION = RecordingLimits(), RobotFileLimits(), DescriptionLimits()
DIAGNOSIS_FILE, PLANNING = DiagnosisFileLimits(), PlanningLimits()
SIMULATION, COMPILING = SimulationLimits(), CompilingLimits()
ALL = (RECORDING, ROBOT_FILE, DESCRIPTION, DIAGNOSIS_FILE, PLANNING, SIMULATION, COMPILING)


def limits_page() -> str:
    """docs/reference/limits.md: every limit with its value, unit and reason."""
    lines = [
        "# Limits of what is read",
        "",
        "<!-- written by `make docs` from flexjoint/core/limits.py; do not edit -->",
        "",
        "What lies beyond is refused in one line of at most 300 characters with exit code 2, before any work",
        "grows with it. What is repaired of a recording stands in [formats.md](formats.md).",
    ]
    for group in ALL:
        title = (type(group).__doc__ or "").rstrip(".")
        lines += ["", f"## {title}", "", "| limit | value | unit | why |", "|---|---|---|---|"]
        lines += [_line(one) for one in fields(group)]
    return "\n".join(lines) + "\n"


def _line(one: Field[Any]) -> str:
    return f"| `{one.name}` | {one.default:g} | {one.metadata['unit']} | {one.metadata['reason']} |"
