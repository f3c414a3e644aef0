"""Plant, diagnose, write down: one JSON line a case, one file a range of cases.

A range's file appears whole or not at all, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from planting import Planted, robot_file
from planting.cases import Case
from planting.dirty.case import Dirty
from support.diagnose_cases import as_recording

import flexjoint
from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.balances.balances import balances_of
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.regression.fit import fit
from flexjoint.diagnosis.regression.problem import Problem
from flexjoint.diagnosis.result import Diagnosis, Fitted
from flexjoint.effects import Planned, catalogue
from flexjoint.recording.noise import white_noise
from flexjoint.recording.table import Recording
from flexjoint.robot import robot
from flexjoint.robot.payload import KnownPayload
from flexjoint.robot.robot import Robot

from .cases import COUNTS, DIRTY, SEALED, USUAL, StudyCase, make

RANGE = 10  # cases a file
FRESH = 3  # every n-th case is simulated on fresh data too


@dataclass(frozen=True)
class Range:
    part: str
    numbers: range

    @property
    def file(self) -> str:
        step = f"-every{self.numbers.step}" if self.numbers.step > 1 else ""
        return f"{self.part}-{self.numbers[0]:04d}-{self.numbers[-1]:04d}{step}.jsonl"


@cache
def version() -> str:
    """Commit where there is one, and a digest of the package's sources, which is what counts."""
    folder = Path(flexjoint.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode())
        digest.update(path.read_bytes())
    try:
        told = subprocess.run(
            ["git", "-C", str(folder), "rev-parse", "--short=10", "HEAD"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        commit = told.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "no commit"
    return f"{commit}, sources {digest.hexdigest()[:10]}"


# --- one case ---------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Prepared:
    """A case with its recordings made, ready to be diagnosed; `record` says what was planted."""

    case: StudyCase
    machine: Case
    nominal: Robot
    recordings: tuple[Recording, ...]
    payloads: tuple[KnownPayload | None, ...]
    record: dict[str, Any]


def prepared(case: StudyCase) -> Prepared:
    """The case with what its machine records."""
    started = time.perf_counter()
    record: dict[str, Any] = {
        "part": case.part,
        "number": case.number,
        "robot": case.case.robot,
        "excitation": case.case.excitation,
        "sensors": case.sensors,
        "inexact": case.case.inexact,
        "rate": case.case.rate,
        "seconds": case.case.seconds,
        "size": case.size,
        "seed": case.case.seed,
        "truth": case.case.truth()["truth"],
        "excluded": sorted(_struck(case.excluded)),
    }
    machine = replace(case.case, effects=(*case.case.effects, *case.hidden))
    recorded = machine.train()
    recording = as_recording(recorded, case.name)
    if isinstance(case.case, Dirty):
        record |= case.case.measured(recorded)
    recordings = [recording]
    if case.second is not None:
        recordings.append(as_recording(case.second.fresh(), f"{case.name}, second"))
        record["second"] = f"{case.second.excitation}, {'known payload' if case.load else 'no payload'}"
    nominal = _nominal(case)
    record["joints"] = len(nominal.joints)
    record["planting"] = round(time.perf_counter() - started, 3)
    record["excess"] = excess(nominal, recording)
    if len(case.case.effects) > 1 and not isinstance(case.case, Dirty):
        record["least_excess"] = least_excess(nominal, recording, case.case.effects)
    payloads = (None, _known(case.load) if case.load else None)[: len(recordings)]
    return Prepared(case, machine, nominal, tuple(recordings), payloads, record)


def diagnosed(case: StudyCase) -> dict[str, Any]:
    """The case as one record: what was planted, what was said, what it cost."""
    ready = prepared(case)
    nominal, record, found = ready.nominal, *said_of(ready)
    simulated = case.part in ("single", "double") and case.number % FRESH == 0 and not case.hidden
    if simulated and found is not None and found.findings:
        fresh = as_recording(ready.machine.fresh(), case.name)
        record["fresh"] = _on_fresh_data(nominal, found, case, fresh)
    return record


def said_of(ready: Prepared, refine: bool = True) -> tuple[dict[str, Any], Diagnosis | None]:
    """The record with what the diagnosis says, and the diagnosis; None where there was an error."""
    record = ready.record
    started = time.perf_counter()
    try:
        found = diagnose(
            ready.nominal,
            ready.recordings,
            excluded=_struck(ready.case.excluded),
            payloads=ready.payloads,
            refine=refine,
            workers=1,  # cases beside each other take the cores
        )
    except FlexJointError as error:
        failed = {"verdict": "error", "error": str(error)}
    except Exception:  # a bug of the product: the study goes on and shows it
        failed = {"verdict": "crash", "error": traceback.format_exc(limit=-4)}
    else:
        return {**record, "diagnosis": round(time.perf_counter() - started, 3), **_said(found)}, found
    return {**record, "diagnosis": time.perf_counter() - started, **failed}, None


def _struck(effects: Sequence[str]) -> frozenset[str]:
    """The effects and those that contain them as special cases."""
    wider = {e.name for e in catalogue().values() if set(e.contains) & set(effects)}
    return frozenset({*effects, *wider})


def _known(load: Planted) -> KnownPayload:
    x, y, z = load.parameters["position"]  # type: ignore[misc]
    return KnownPayload(str(load.joint), load.value("mass"), (x, y, z))


def _nominal(case: StudyCase) -> Robot:
    loaded = robot.load(robot_file(case.case.robot))
    if not case.hidden:
        return loaded
    return replace(loaded, file=loaded.file.model_copy(update={"offsets": "per_recording"}))


def excess(nominal: Robot, recording: Recording) -> float | None:
    """Energy per sample of the nominal model's white residual, what its tolerances explain taken out: 1 for
    noise alone. None where no balance can be closed."""
    balances = balances_of(nominal, recording)
    if not balances.rows:
        return None
    problem = Problem(balances)
    return round(problem.energy(problem.residual([])) / problem.noise_energy, 5)


def least_excess(nominal: Robot, recording: Recording, causes: Sequence[Planted]) -> float | None:
    """Energy per sample that each of the planted causes explains beside the others and the tolerances, above
    1: the least of them. A cause may be lost in its own tolerance, or in noise, beside a large one."""
    balances = balances_of(nominal, recording)
    if not balances.rows:
        return None
    problem = Problem(balances)
    true = [Planned.of(c.effect, c.joint, c.parameters, since=c.since) for c in causes]
    whole = fit(problem, true).energy
    gains = [fit(problem, [e for e in true if e is not one]).energy - whole for one in true]
    return round(1.0 + min(gains) / problem.noise_energy, 5)


def _on_fresh_data(
    nominal: Robot, found: Diagnosis, case: StudyCase, recording: Recording
) -> list[float] | None:
    """RMS error of the simulated positions on another recording of the machine, in their noise, mean over
    channels: by the nominal model, the extended one, and one with the very effects that were planted
    (start states and missed ticks of the command leave an error with any model). None where it cannot be
    simulated."""
    true = [Planned.of(p.effect, p.joint, p.parameters) for p in case.case.effects]
    out = []
    for model in (nominal, found.extend(nominal, least=0.0), nominal.extended(true)):
        try:
            rms = compare(model, recording).rms
        except FlexJointError:
            return None
        shares = [
            rms[f"{channel}.{joint}"] / white_noise(values)
            for (channel, joint), values in recording.columns.items()
            if channel in ("q", "theta") and f"{channel}.{joint}" in rms
        ]
        out.append(round(float(np.mean(shares)), 4))
    return out


def _said(found: Diagnosis) -> dict[str, Any]:
    findings = []
    for f in found.findings:
        values = {
            name: fitted if isinstance(fitted, str) else _numbers(fitted)
            for name, fitted in f.parameters.items()
        }
        findings.append(
            {
                "effect": f.effect,
                "joint": f.joint,
                "probability": round(f.probability, 4),
                "left": round(f.left, 2),
                "gain": round(f.gain, 4),
                "reliability": round(f.reliability, 4),
                "removed": None if f.removed is None else asdict(f.removed),
                "parameters": values,
                "since": f.since,
                "ties": [[tie.effect, tie.joint] for tie in f.indistinguishable],
            }
        )
    return {
        "verdict": found.verdict,
        "findings": findings,
        "unexplained": [[u.joint, u.balance, round(u.share, 4), u.against] for u in found.unexplained],
        "not_excited": [list(pair) for pair in found.not_excited],
        "remaining": [asdict(r) for r in found.remaining],
        "explained": round(found.explained, 5),
        "energy": [round(e, 4) for e in found.energy],
    }


def _numbers(fitted: Fitted) -> dict[str, list[float]]:
    return {"value": np.ravel(fitted.value).tolist(), "std": np.ravel(fitted.std).tolist()}


# --- all cases --------------------------------------------------------------------------------------------
def ranges(parts: Sequence[str], every: int = 1, sealed: bool | None = None) -> Iterator[Range]:
    """The ranges of some parts, or of every n-th of their cases; of the parts that have sealed numbers
    (cases.DIRTY) only these or only the others, or all (None)."""
    for part in parts:
        halves = {None: (0, COUNTS[part]), False: (0, SEALED), True: (SEALED, COUNTS[part])}
        first, end = halves[sealed if part in DIRTY else None]
        numbers = range(first, end, every)
        for start in range(0, len(numbers), RANGE):
            yield Range(part, numbers[start : start + RANGE])


def run(
    folder: Path,
    shard: tuple[int, int] = (1, 1),
    jobs: int | None = None,
    parts: Sequence[str] = USUAL,
    every: int = 1,
    sealed: bool | None = False,
) -> None:
    """Run what is missing in the folder of every n-th range; `sealed` as for `ranges`; raises ValueError when
    the folder holds results of another version of the code."""
    folder.mkdir(parents=True, exist_ok=True)
    held = {record["version"] for record in records(folder)}
    if held - {version()}:
        raise ValueError(f"{folder} holds results of {sorted(held)}, this is {version()}; use another folder")
    index, count = shard
    mine = [r for k, r in enumerate(ranges(parts, every, sealed)) if k % count == index - 1]
    todo = [r for r in mine if not (folder / r.file).exists()]
    print(f"{len(mine) - len(todo)} of {len(mine)} ranges are done; {version()}", flush=True)
    os.environ["OMP_NUM_THREADS"] = "1"
    # a process a range: none grows with the number of cases
    with ProcessPoolExecutor(jobs or os.cpu_count(), get_context("spawn"), max_tasks_per_child=1) as pool:
        waiting = {pool.submit(write_range, folder, r): r for r in todo}
        for k, done in enumerate(as_completed(waiting), 1):
            seconds = done.result()
            print(f"{k}/{len(todo)} {waiting[done].file}: {seconds:.0f} s", flush=True)


def write_range(folder: Path, wanted: Range) -> float:
    """Diagnose a range into its file; returns the seconds it took."""
    started = time.perf_counter()
    lines = []
    for number in wanted.numbers:
        record = {**diagnosed(make(wanted.part, number)), "version": version()}
        lines.append(json.dumps(record))
    temporary = folder / f".{wanted.file}.{os.getpid()}"
    temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
    temporary.replace(folder / wanted.file)
    return time.perf_counter() - started


def records(folder: Path) -> list[dict[str, Any]]:
    """All records in a folder, each case once, in the order of parts and numbers."""
    found = {}
    for path in sorted(folder.glob("*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            record = json.loads(line)
            found[record["part"], record["number"]] = record
    return [found[key] for key in sorted(found)]
