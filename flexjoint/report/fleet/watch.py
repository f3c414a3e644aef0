"""A fleet watched: recordings in, one table and one page out, the page as JSON, too."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import all_or_none, check_folder, write_bytes, write_json, write_text
from flexjoint.core.running.worker_pool import workers_of
from flexjoint.diagnosis.followup.fleet import roster as rosters
from flexjoint.diagnosis.followup.fleet.assess import assessed, of_types
from flexjoint.diagnosis.followup.fleet.campaign import campaign
from flexjoint.diagnosis.followup.fleet.fleet import Fleet
from flexjoint.diagnosis.followup.fleet.units import Store
from flexjoint.diagnosis.followup.fleet.workers import cluster, local
from flexjoint.diagnosis.settings import USUAL, FleetSettings
from flexjoint.report.fleet import page
from flexjoint.robot.robot import load

UNITS, TABLE, PAGE, FOUND = "units", "fleet.parquet", "fleet.html", "fleet.json"

Progress = Callable[[float, str], None]


def watch(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    robot: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
    settings: FleetSettings = USUAL.fleet,
) -> Fleet:
    """Check every recording of a fleet, diagnose what has changed, write a table, a page and its JSON.

    Args:
        source: a folder with one folder a robot, or a list (docs/howto/fleets.md).
        out: the folder of the results; work that lies there is not done again.
        robot: the robot file of all robots that name none.
        workers: local processes, FLEXJOINT_WORKERS or one per core by default.
        scheduler: of a Dask cluster that does the work instead, tcp://host:8786.
        progress: called with a share in [0, 1] and what is being done.
        settings: the numbers that decide who needs somebody.

    Raises FlexJointError where there is nothing to watch, a robot file cannot be used, or the scheduler does
    not answer; MissingExtraError without the extra `fleet`. A recording that cannot be used is a result.
    """
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise FlexJointError(f"cannot write results into {folder}: it is a file; give a folder")
    check_folder(folder, folder)
    roster = rosters.read(Path(source), None if robot is None else Path(robot))
    robots = {path: load(path) for path in dict.fromkeys(entry.robot for entry in roster.entries)}
    runner = (
        local(workers_of(workers), settings.restarts)
        if scheduler is None
        else cluster(scheduler, settings.restarts)
    )
    report: Progress = progress or (lambda _share, _what: None)
    periods, units, seconds = campaign(roster, Store(folder / UNITS), runner, settings, report)
    fleet = Fleet(
        assessed(periods, robots, settings),
        periods,
        roster.events,
        robots,
        of_types(periods, settings),
        units,
        seconds,
    )
    sink = pa.BufferOutputStream()
    parquet.write_table(fleet.table(), sink)
    with all_or_none():
        write_bytes(folder / TABLE, sink.getvalue().to_pybytes())
        write_text(folder / PAGE, page.html(fleet))
        write_json(folder / FOUND, fleet.to_json())
    return fleet
