"""One unit of work: a recording diagnosed, or checked against what is known of its machine.

A unit has a key, the hash of all that its result depends on: recording, robot, what is known, version. Its
result lies under that key, so that work that was done is never done again, whoever did it and wherever it
stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flexjoint.core.errors import FlexJointError
from flexjoint.core.files import write_json
from flexjoint.diagnosis.followup.checking.check import check
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import to_json
from flexjoint.recording import checks
from flexjoint.recording.importing import read
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import load

SCHEMA = 1
CHUNK = 1 << 20

Kind = Literal["diagnosis", "check"]


@dataclass(frozen=True)
class Unit:
    """What is sent to a worker; `known` is the JSON of a diagnosis that a check is made against."""

    key: str
    kind: Kind
    recording: str
    robot: str
    known: str = ""


def unit_of(kind: Kind, recording: Path, robot: Path, known: Mapping[str, Any] | None = None) -> Unit:
    """A unit with its key."""
    text = "" if known is None else json.dumps(known, sort_keys=True)
    parts = (str(SCHEMA), release(), kind, _content(recording), _robot(str(robot)), text)
    key = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
    return Unit(key, kind, str(recording), str(robot), text)


def release() -> str:
    """The version of flexjoint that makes a result."""
    try:
        return version("flexjoint")
    except PackageNotFoundError:  # run from a checkout
        return "unknown"


def _content(path: Path) -> str:
    """Hash of a file, or of all files of a folder; of a file that is not there, its name."""
    digest = hashlib.sha256()
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        try:
            with file.open("rb") as stream:
                while chunk := stream.read(CHUNK):
                    digest.update(chunk)
        except OSError:
            digest.update(str(file).encode())
    return digest.hexdigest()


@lru_cache(maxsize=4096)
def _robot(path: str) -> str:
    """Hash of a robot file with its description."""
    try:
        description = load(path).urdf
    except FlexJointError:
        description = None
    return _content(Path(path)) + (_content(description) if description is not None else "")


def perform(unit: Unit) -> dict[str, Any]:
    """The result of a unit. What is wrong with a recording is a result, too: it never stops the rest."""
    begin = time.process_time()
    done: dict[str, Any] = {"schema": SCHEMA, "key": unit.key, "kind": unit.kind, "version": release()}
    try:
        robot = load(unit.robot)
        recording = read(unit.recording, None, robot).recording
        checks.check(robot, recording)
        done["temperature"] = _temperatures(recording)
        if unit.kind == "check":
            done["content"] = check(robot, recording, json.loads(unit.known)).to_json()
        else:
            done["content"] = to_json(diagnose(robot, recording, workers=1))
        done["error"] = ""
    except FlexJointError as error:
        done["error"] = str(error)
    except Exception as error:  # one bad file never stops the rest
        done["error"] = f"{type(error).__name__}: {error}"
    done["seconds"] = time.process_time() - begin
    return done


def _temperatures(recording: Recording) -> dict[str, float]:
    """Mean temperature of each joint that has a sensor [deg C]."""
    found = {j: np.nanmean(x) for (c, j), x in recording.columns.items() if c == "temperature"}
    return {joint: float(value) for joint, value in found.items() if np.isfinite(value)}


class Store:
    """Results by key, one file each, in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, key: str) -> dict[str, Any] | None:
        """The result of a unit; None where it was not done, or its file is damaged."""
        try:
            content = json.loads((self._folder / f"{key}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        return content if isinstance(content, dict) and content.get("key") == key else None

    def put(self, result: Mapping[str, Any]) -> None:
        """Keep a result, whole or not at all."""
        write_json(self._folder / f"{os.path.basename(result['key'])}.json", result)
