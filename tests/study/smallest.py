"""The smallest size of each effect that is still found, among halves of the usual one.

PYTHONPATH=tests:. python -m study smallest [--table docs/site/smallest_sizes.json]

The power of 1/2 is bisected: what is larger than a size that is found is taken as found, too. One recording a
size, of one machine under one motion and one draw of the noise: a figure for a feeling of what
can be seen, good to a factor of two. The robots' numbers are exact, and their files trust them to 2 %. Rows
that the file holds already are kept, so that a run that was stopped goes on.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from planting.cases import single_case, truth_of
from planting.catalogue import BEYOND, CATALOGUE, LATER, TWO_JOINTS

from .cases import StudyCase
from .run import diagnosed, version
from .score import outcome

ROBOTS = ("lever", "crane")
WITH_NEIGHBOURS = ("crane", "gimbal")  # for effects that take a joint and one beside it
HALVINGS = 8  # 1/256 of the usual size is far below what any of them showed
SECONDS = 10.0
SEED = 34
FOUND = ("exact", "tied")


def pairs() -> Iterator[tuple[str, str]]:
    """Each effect with each of its two robots."""
    for effect in (*CATALOGUE, *BEYOND, *LATER):
        for robot in WITH_NEIGHBOURS if effect in TWO_JOINTS else ROBOTS:
            yield effect, robot


def smallest(effect: str, robot: str) -> dict[str, Any]:
    """The row of an effect on a robot: `found` holds what was planted when it was last found, None where the
    usual size was not; `missed` the outcome at half of that."""
    found, missed = None, None
    small, large = -1, HALVINGS + 1  # so many halvings were found, and were not
    while large - small > 1:
        halvings = (small + large) // 2
        size = 0.5**halvings
        case = single_case(f"smallest {effect} {robot}", effect, SEED, robot=robot, size=size)
        case = replace(case, seconds=SECONDS)
        record = diagnosed(StudyCase("smallest", 0, case, "full", size))
        said = outcome(record)
        if said not in FOUND:
            missed, large = said, halvings
            continue
        small = halvings
        (planted,) = case.effects
        told = truth_of(planted)
        values = {**told["parameters"], **told.get("words", {})}  # type: ignore[dict-item]
        found = {"size": size, "joint": planted.joint, "parameters": values, "excess": record["excess"]}
    return {"effect": effect, "robot": robot, "found": found, "missed": missed}


def write(table_file: Path) -> None:
    """Fill the table; it appears whole after each row."""
    table = json.loads(table_file.read_text(encoding="utf-8")) if table_file.exists() else {"rows": []}
    there = {(row["effect"], row["robot"]) for row in table["rows"]}
    for effect, robot in pairs():
        if (effect, robot) in there:
            continue
        started = time.process_time()
        table["rows"].append(smallest(effect, robot))
        table |= {"version": version(), "seconds": SECONDS, "seed": SEED}
        temporary = table_file.with_suffix(".new")
        temporary.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
        temporary.replace(table_file)
        row = table["rows"][-1]
        size = row["found"] and row["found"]["size"]
        print(f"{effect} {robot}: {size}, {row['missed']}; {time.process_time() - started:.0f} s", flush=True)
