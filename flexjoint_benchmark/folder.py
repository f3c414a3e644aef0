"""The folder of a benchmark: recordings and nominal models in the open, the truth under a seal.

The seal keeps nobody from the truth who wants it; it keeps a tool, and who tunes one, from reading it by
chance.
"""

from __future__ import annotations

import base64
import json
import shutil
import zlib
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import yaml

from flexjoint_benchmark import SCHEMA, BenchmarkError
from flexjoint_benchmark.cases import EVERY, PARTS, drawn
from flexjoint_benchmark.planting.catalogue import law
from flexjoint_benchmark.planting.robots import robot_file

LARGEST = 100_000_000  # bytes of a JSON: answers to ten thousand cases
CASES, TRUTH = "cases.json", "truth.sealed"
SEAL = "flexjoint benchmark truth: read it to score answers, and not before\n"
README = """# A benchmark of diagnoses

Every folder holds `recording.parquet` of a machine and `robot.yaml` with its URDF, the nominal model: what
its maker says of it, with `tolerance`, the relative standard deviation of its numbers. `cases.json` lists the
folders, and the effects that may be missing in the nominal model, with their parameters (SI, referred to the
link). Which ones are, if any, is in `truth.sealed`. Formats: docs/reference/formats.md, laws:
docs/reference/effects.md, answers and what they are worth: docs/studies/benchmark.md of flexjoint.
"""


def make(
    folder: Path,
    count: int = 10,
    seed: int = 1,
    parts: tuple[str, ...] = tuple(PARTS),
    real: Path | None = None,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> int:
    """Write a benchmark of `count` cases for each part into a new folder; returns the number of cases.

    `real` is a folder of robots with recordings of real machines (kr300, tx40), whose data licences are
    copied with them. Raises BenchmarkError where the folder holds something, or for unknown parts.
    """
    if count < 1 or seed < 0:
        raise BenchmarkError(f"at least one case for each part and a seed from 0 on, got {count} and {seed}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BenchmarkError(f"{folder} is not empty; give the name of a new folder")
    tasks = drawn(parts, count, seed)
    first = next(tasks)  # complains of unknown parts before a folder is made
    folder.mkdir(parents=True, exist_ok=True)
    listed: dict[str, Any] = {}
    truth: dict[str, Any] = {}
    total = count * len(parts)
    for k, task in enumerate(chain([first], tasks), start=1):
        name = f"c{k:04d}"
        recorded, truth[name] = task.made()
        (folder / name).mkdir()
        recorded.write(folder / name / "recording.parquet")
        _robot(robot_file(task.case.robot), folder / name)
        listed[name] = {"robot": f"{name}/robot.yaml", "recording": f"{name}/recording.parquet"}
        listed[name]["joints"] = truth[name]["joints"]
        progress(k, total)
    for name, robot, recording in _machines(real):
        (folder / name).mkdir()
        for path in robot.parent.iterdir():
            if path.suffix in (".yaml", ".urdf") or path.name.startswith("LICENSE"):
                shutil.copyfile(path, folder / name / path.name)
        shutil.copyfile(recording, folder / name / "recording.parquet")
        listed[name] = {"robot": f"{name}/{robot.name}", "recording": f"{name}/recording.parquet"}
        listed[name]["joints"] = list(yaml.safe_load(robot.read_text())["joints"])
        truth[name] = {"part": "real", "joints": listed[name]["joints"], "machine": robot.stem}
    effects = {name: {"parameters": [*law(name).required, *law(name).defaults]} for name in EVERY}
    _write(folder / CASES, {"schema": SCHEMA, "seed": seed, "cases": listed, "effects": effects})
    packed = base64.b64encode(zlib.compress(json.dumps({"schema": SCHEMA, "cases": truth}).encode()))
    (folder / TRUTH).write_text(SEAL + packed.decode() + "\n")
    (folder / "README.md").write_text(README)
    return len(listed)


def cases(folder: Path) -> dict[str, Any]:
    """What cases.json says; raises BenchmarkError where it is no benchmark."""
    content = read_json(folder / CASES)
    if content.get("schema") != SCHEMA or not isinstance(content.get("cases"), dict):
        raise BenchmarkError(f"{folder / CASES} is no list of cases of schema {SCHEMA}; make the folder anew")
    whole = isinstance(content.get("effects"), dict) and all(map(_is_case, content["cases"].values()))
    if not whole:
        raise BenchmarkError(
            f"{folder / CASES} lacks effects, or a robot, recording or joints of a case; make it anew"
        )
    return content


def _is_case(entry: Any) -> bool:
    if not isinstance(entry, dict) or not isinstance(entry.get("joints"), list):
        return False
    return all(
        isinstance(text, str) for text in (entry.get("robot"), entry.get("recording"), *entry["joints"])
    )


def truth(folder: Path) -> dict[str, Any]:
    """What is true, by case; breaks the seal."""
    path = folder / TRUTH
    try:
        packed = base64.b64decode(path.read_text().removeprefix(SEAL))
        content = json.loads(zlib.decompressobj().decompress(packed, LARGEST))
        true: dict[str, Any] = content["cases"]
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, LookupError, TypeError, RecursionError, zlib.error):
        raise BenchmarkError(f"{path} is damaged; make the folder anew") from None
    return true


def read_json(path: Path) -> dict[str, Any]:
    """An object in a JSON file; raises BenchmarkError."""
    try:
        if path.stat().st_size > LARGEST:
            raise BenchmarkError(f"{path} has more than {LARGEST} bytes; expected a list of cases or answers")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror}") from None
    except RecursionError:
        raise BenchmarkError(f"{path} is nested too deeply; docs/studies/benchmark.md has its form") from None
    except ValueError as error:
        raise BenchmarkError(f"{path} is no JSON: {error}") from None
    if not isinstance(content, dict):
        raise BenchmarkError(f"{path}: expected an object, got {type(content).__name__}")
    return content


def _robot(path: Path, folder: Path) -> None:
    """The nominal model, under a name that tells nothing."""
    data = yaml.safe_load(path.read_text())
    shutil.copyfile(path, folder / "robot.yaml")
    shutil.copyfile(path.parent / data["urdf"], folder / data["urdf"])


def _machines(robots: Path | None) -> list[tuple[str, Path, Path]]:
    """(name of the case, robot file, recording) of the real machines in a folder of robots."""
    if robots is None:
        return []
    found = []
    for recording in sorted(robots.glob("*/recordings/*.parquet")):
        machine = recording.parent.parent
        if (machine / "LICENSE-DATA").exists():
            found.append((f"{machine.name}_{recording.stem}", machine / f"{machine.name}.yaml", recording))
    return found


def _write(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n")
