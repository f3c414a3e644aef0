"""A fleet watched: 200 planted recordings of 20 robots, one a week for ten weeks, 4 of which wear.

PYTHONPATH=tests:. python -m study.fleet FOLDER

Recordings lie in FOLDER/logs, results in FOLDER/results; what is there is not made again. One process does
all checks and diagnoses, so that their seconds are those of one core, and its memory that of one worker.
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pyarrow.parquet
from planting import Planted, plant, robot_file
from support.diagnose_cases import SENSORS

WEEKS = 10
SECONDS, RATE = 10.0, 500.0
OFF = 0.02  # of the nominal numbers, which the robot files claim to know as well as that
FIRST_SEED = 52_000  # of motions and noise: another one for each recording; machines from FIRST_SEED - 1 down
BEGIN = datetime(2026, 3, 2, tzinfo=UTC)
JOINTS = {"lever": "swing", "turret": "turn"}
PER_DEGREE = -0.02  # of the friction of a machine whose temperature is told, as of grease
COLD, WARM = 15.0, 35.0  # deg C


@dataclass(frozen=True)
class Machine:
    """A robot of the fleet: what it has from the first week on, and what grows or comes."""

    name: str
    robot: str
    friction: float = 0.0  # N m
    gap: float = 0.0  # rad
    growth: float = 0.0  # of the friction, of what it was, each week after `week`
    later_gap: float = 0.0  # rad, from `week` on
    week: int = WEEKS  # the first with more than there was
    warms: bool = False  # whether its temperature changes, and its friction with it

    @property
    def wears(self) -> bool:
        return self.week < WEEKS

    def causes(self, week: int, temperature: float) -> list[Planted]:
        joint = JOINTS[self.robot]
        level = self.friction * (1.0 + self.growth * max(0, week - self.week + 1))
        level *= 1.0 + PER_DEGREE * (temperature - 0.5 * (COLD + WARM)) if self.warms else 1.0
        gap = self.later_gap if self.later_gap and week >= self.week else self.gap
        found = [Planted("motor_coulomb_friction", joint, {"level": level})] if level else []
        return found + ([Planted("backlash", joint, {"gap": gap})] if gap else [])


FLEET = (
    Machine("w1", "lever", friction=1.2, growth=0.15, week=3),  # grows by 0.18 N m a week
    Machine("w2", "lever", friction=0.8, gap=0.004, later_gap=0.006, week=5),
    Machine("w3", "turret", later_gap=0.005, week=6),  # play where none was
    Machine("w4", "turret", friction=1.0, growth=0.6, week=7),
    *(Machine(f"h{k}", "lever") for k in range(5)),
    *(Machine(f"f{k}", "lever", friction=0.6 + 0.3 * k) for k in range(3)),
    *(Machine(f"g{k}", "lever", gap=0.004 + 0.002 * k) for k in range(2)),
    *(Machine(f"t{k}", "lever", friction=1.0 + 0.4 * k, warms=True) for k in range(2)),
    *(Machine(f"hh{k}", "turret") for k in range(3)),
    Machine("tt", "turret", friction=1.2, warms=True),
)


def planted(folder: Path) -> Path:
    """All recordings, and their roster. Raises ValueError where the folder holds another fleet."""
    logs = folder / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    told = logs / "fleet.json"
    content = json.dumps([repr(machine) for machine in FLEET])
    if told.exists() and told.read_text() != content:
        raise ValueError(f"{logs} holds another fleet; use another folder")
    told.write_text(content)
    rows = []
    for k, machine in enumerate(FLEET):
        for week in range(WEEKS):
            seed = FIRST_SEED + WEEKS * k + week
            temperature = float(np.random.default_rng(seed).uniform(COLD, WARM)) if machine.warms else 22.0
            path = logs / f"{machine.name}_{week}.parquet"
            if not path.exists():
                one = plant(
                    robot_file(machine.robot), machine.causes(week, temperature), "rich", SECONDS, seed,
                    SENSORS["full"], RATE, inexact=OFF, plant_seed=FIRST_SEED - 1 - k,
                )  # fmt: skip
                pyarrow.parquet.write_table(one.table(), path)
            when = (BEGIN + timedelta(weeks=week)).isoformat()
            warmth = f"{temperature:.1f}" if machine.warms else ""
            rows.append((path.name, machine.name, str(robot_file(machine.robot)), when, warmth))
    with (logs / "roster.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("recording", "machine", "robot", "time", "temperature"), *rows])
    return logs


def watched(folder: Path) -> str:
    """Watch the fleet, and say what was found."""
    from flexjoint.report.fleet.watch import watch

    fleet = watch(folder / "logs", folder / "results", workers=1)
    lines = {line.period.machine: line for line in fleet.lines}
    out = []
    for machine in FLEET:
        line = lines[machine.name]
        alarms = len(line.period.alarms)
        what = "; ".join(
            f"{t.what}, since week {(t.since - BEGIN.timestamp()) / 604800.0:.1f}" for t in line.troubles
        )
        true = f"wears from week {machine.week}" if machine.wears else "unchanged"
        out.append(f"{machine.name:4} {true:20} {line.state:9} {alarms} alarms  {what}")
    unchanged = [m for m in FLEET if not m.wears]
    steady = [m for m in unchanged if not m.warms]
    called = [m for m in unchanged if lines[m.name].state != "green"]
    checks = sum(len(lines[m.name].period.readings) - 1 for m in steady)
    alarms = sum(len(lines[m.name].period.alarms) for m in steady)
    found = sum(lines[m.name].state == "needs" for m in FLEET if m.wears)
    units = [json.loads(path.read_text()) for path in (folder / "results" / "units").glob("*.json")]
    seconds = {k: [u["seconds"] for u in units if u["kind"] == k] for k in ("check", "diagnosis")}
    total = sum(map(sum, seconds.values()))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # kB on Linux
    out += [
        f"found {found} of {sum(m.wears for m in FLEET)}",
        f"called for nothing: {len(called)} of {len(unchanged)}",
        f"alarms of checks of unchanged machines at one temperature: {alarms} of {checks}",
        *(
            f"{len(s)} units of {kind}: {np.median(s):.2f} s (median), {np.max(s):.2f} s (most)"
            for kind, s in seconds.items()
        ),
        f"{3600.0 * WEEKS * len(FLEET) / total:.0f} recordings an hour of one core; {memory:.2f} GB",
    ]
    return "\n".join(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    with ProcessPoolExecutor(1, get_context("spawn")) as child:  # whose memory is not a worker's
        try:
            child.submit(planted, folder).result()
        except ValueError as error:
            parser.exit(2, f"fleet: {error}\n")
    print(watched(folder))


if __name__ == "__main__":
    main()
