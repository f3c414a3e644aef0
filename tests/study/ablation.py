"""What each check and stage of the diagnosis earns: a fixed sample of the study without it.

Every check of verdict/checks, and the stages that name causes beside the search, are left out in turn. A case
is diagnosed once with all of them, and it is noted which of them changed something. One that changed nothing
in a case would have left it as it is, so that only the other cases are diagnosed again.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from flexjoint.diagnosis import pipeline
from flexjoint.diagnosis.search.selection import Selection
from flexjoint.diagnosis.verdict import cases as verdict_cases
from flexjoint.diagnosis.verdict import checks
from flexjoint.diagnosis.verdict.joints.by_itself import Stage
from flexjoint.diagnosis.verdict.joints.friction import FRICTION
from flexjoint.diagnosis.verdict.joints.search import JOINT_SEARCH

from . import dirty
from .cases import COUNTS, DIRTY, SEALED, StudyCase, make
from .run import Prepared, prepared, said_of, version
from .score import Record, equivalent, false_names, matches, outcome
from .summary import alarmed, named
from .text import code, table

SAMPLE = {
    "single": 9,
    "double": 7,
    "healthy": 4,
    "struck": 4,
    "several": 2,
    "beyond": 4,
    "drawn": 4,
    "dirty": 4,
    "background": 2,
    "unknown": 3,
}
"""Cases of each part in a sample of the usual size."""
USUAL_SAMPLE = sum(SAMPLE.values())
WRONG = 0.5  # probability above which a wrong name does harm
LISTS = ("BALANCES", "NAMES", "SIMULATION", "FINDINGS")  # of verdict/checks: what the pipeline asks

Acted = Callable[[], None]  # called when a check or stage changes something


@dataclass(frozen=True)
class Piece:
    """A check or stage: how to watch it, and how to leave it out. `refined` tells that it is the refinement,
    which `diagnose` itself leaves out."""

    name: str
    watched: Callable[[Acted], Any]  # a context
    without: Callable[[], Any]  # a context
    refined: bool = False


# --- what is left out -------------------------------------------------------------------------------------
def pieces() -> tuple[Piece, ...]:
    """The checks in the order in which they are asked, then the stages."""
    return (
        *(_of_check(check) for check in checks.EVERY),
        Piece(
            "stage: robust search",
            lambda acted: _wrapped(pipeline, "search_robustly", acted, lambda out, _: out is not None),
            lambda: patch.object(pipeline, "search_robustly", lambda *_: None),
        ),
        _of_stage("stage: ordinary friction", FRICTION),
        _of_stage("stage: each joint searched by itself", JOINT_SEARCH),
        Piece(
            "belief: the simulation needs it",
            lambda acted: _wrapped(verdict_cases, "by_simulation", acted, lambda out, _: out > 0.0),
            lambda: patch.object(verdict_cases, "by_simulation", lambda *_: 0.0),
        ),
        Piece(
            "belief: the simulation follows",
            lambda acted: _wrapped(
                verdict_cases,
                "followed",
                acted,
                lambda out, given: any(a is not b for a, b in zip(out, given[1], strict=True)),
            ),
            lambda: patch.object(verdict_cases, "followed", lambda _best, found, _estimation: found),
        ),
        Piece(
            "refinement: numbers that it only confirms stay",
            lambda acted: _wrapped(verdict_cases.refined, "_known_better", acted, lambda out, _: bool(out)),
            lambda: patch.object(verdict_cases.refined, "_known_better", lambda *_: ""),
        ),
        Piece(
            "refinement: all of it",
            lambda acted: _wrapped(
                verdict_cases.refined,
                "refine",
                acted,
                lambda out, _: out[1].method == "output_error" or out[1].follows,
            ),
            ExitStack,
            refined=True,
        ),
    )


def _of_check(check: checks.Check[Any]) -> Piece:
    @contextmanager
    def without() -> Iterator[None]:
        with ExitStack() as stack:
            for name in LISTS:
                kept = tuple(one for one in getattr(checks, name) if one is not check)
                stack.enter_context(patch.object(checks, name, kept))
            yield

    return Piece(
        f"check: {check.name}",
        lambda acted: _wrapped(type(check), "objections", acted, lambda out, _: bool(out)),
        without,
    )


def _of_stage(name: str, stage: Stage) -> Piece:
    """One of the stages that look at each joint by itself."""
    usual = pipeline.joint_by_joint

    def without(selection: Selection, candidates: Any, asked: Stage, *given: Any) -> Selection:
        return selection if asked is stage else usual(selection, candidates, asked, *given)

    return Piece(
        name,
        lambda acted: _wrapped(
            pipeline, "joint_by_joint", acted, lambda out, given: given[2] is stage and out is not given[0]
        ),
        lambda: patch.object(pipeline, "joint_by_joint", without),
    )


def _wrapped(owner: Any, name: str, acted: Acted, changed: Callable[[Any, tuple[Any, ...]], bool]) -> Any:
    """A context in which a function of a module or class tells when its result changes something."""
    original = getattr(owner, name)

    def told(*given: Any) -> Any:
        out = original(*given)
        if changed(out, given):
            acted()
        return out

    return patch.object(owner, name, told)


# --- running ----------------------------------------------------------------------------------------------
def sample(count: int = USUAL_SAMPLE) -> list[tuple[str, int]]:
    """(part, number) of the sample: of each part every k-th case, k odd because parts alternate. First one of
    each part, then another one of each: a run that was stopped has some of all."""
    rounds = []
    for part, share in SAMPLE.items():
        wanted = max(1, round(share * count / USUAL_SAMPLE))
        cases = SEALED if part in DIRTY else COUNTS[part]
        step = max(1, cases // wanted - 1 + cases // wanted % 2)
        rounds += [(k, part, step // 2 + step * k) for k in range(wanted)]
    return [(part, number) for _, part, number in sorted(rounds, key=lambda one: one[0])]


def run(folder: Path, count: int = USUAL_SAMPLE) -> None:
    """Run what is missing in the folder, a file a case; raises ValueError when the folder holds results of
    another version of the code."""
    folder.mkdir(parents=True, exist_ok=True)
    held = {case["with"]["version"] for case in results(folder)}
    if held - {version()}:
        raise ValueError(f"{folder} holds results of {sorted(held)}, this is {version()}; use another folder")
    for part, number in sample(count):
        path = folder / f"{part}-{number:04d}.json"
        if path.exists():
            continue
        result = ablated(make(part, number))
        temporary = folder / f".{path.name}.{os.getpid()}"
        temporary.write_text(json.dumps(result), encoding="utf-8")
        temporary.replace(path)
        again = ", ".join(result["without"]) or "nothing"
        print(f"{path.stem}: {result['with']['cpu']:.0f} s; again without {again}", flush=True)


def ablated(case: StudyCase) -> dict[str, Any]:
    """The records of a case: with everything, and without each piece that changed something."""
    ready, known = prepared(case), pieces()
    acted: set[str] = set()
    with ExitStack() as stack:
        for piece in known:
            stack.enter_context(piece.watched(lambda name=piece.name: acted.add(name)))
        usual = _timed(ready)
    without = {}
    for piece in known:
        if piece.name in acted:
            with piece.without():
                without[piece.name] = _timed(ready, refine=not piece.refined)
    return {"with": usual, "without": without}


def _timed(ready: Prepared, refine: bool = True) -> Record:
    started = time.process_time()
    record, _ = said_of(ready, refine)
    return {**record, "cpu": round(time.process_time() - started, 3), "version": version()}


def results(folder: Path) -> list[dict[str, Any]]:
    """What `ablated` said of every case in a folder, in the order of the sample's parts."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    return sorted(found, key=lambda case: (list(SAMPLE).index(case["with"]["part"]), case["with"]["number"]))


# --- counting ---------------------------------------------------------------------------------------------
def wrong_names(record: Record) -> int:
    """Names stated above WRONG that stand for nothing that is there."""
    if record["part"] in DIRTY:
        return sum(n.finding["probability"] > WRONG and not n.right for n in dirty.names([record]))
    if record["excluded"]:
        (truth,) = record["truth"]
        false = [f for f in record.get("findings", ()) if not equivalent(f, truth)]
    else:
        false = false_names(record)
    return sum(f["probability"] > WRONG for f in false)


def right_names(record: Record) -> int:
    """Large causes of a dirty machine that are named; 0 of another."""
    return sum(dirty.belief(record, cause) >= dirty.NAMED for _, cause in dirty.large_causes([record]))


def _clean(record: Record) -> bool:
    """Whether a case has causes, all of which can be named."""
    return record["part"] not in DIRTY and bool(record["truth"]) and not record["excluded"]


@dataclass(frozen=True)
class Counts:
    """What became of the sample."""

    exact: int
    tied: int
    wrong: int
    alarms: int
    large: int

    @classmethod
    def of(cls, records: Sequence[Record]) -> Counts:
        told = [outcome(r) for r in records if _clean(r)]
        healthy = [r for r in records if r["part"] not in DIRTY and not r["truth"]]
        return cls(
            told.count("exact"),
            told.count("tied"),
            sum(map(wrong_names, records)),
            sum(map(alarmed, healthy)),
            sum(map(right_names, records)),
        )

    def told(self) -> tuple[int, ...]:
        return self.exact, self.tied, self.wrong, self.alarms, self.large


def merit(record: Record) -> tuple[int, int, int]:
    """What a case is judged by, the better the larger: causes named (a set with the right numbers counts as
    one more), wrong names above WRONG, alarms."""
    right = right_names(record)
    if _clean(record):
        right = sum(m.kind in ("exact", "tied") for m in matches(record)) + named(record)
    healthy = record["part"] not in DIRTY and not record["truth"]
    return right, -wrong_names(record), -int(healthy and alarmed(record))


def _said(record: Record) -> str:
    """What became of a case, in a few words."""
    names = ", ".join(
        f"{f['effect']}{'' if f['joint'] is None else ' on ' + f['joint']} {f['probability']:.2f}"
        for f in record.get("findings", ())
    )
    what = outcome(record) if _clean(record) else record["verdict"]
    return f"{what}: {names or 'nothing named'}"


# --- text -------------------------------------------------------------------------------------------------
WORDS = """\
# What each check of the diagnosis earns

Written by `python -m study ablation`; do not edit. A fixed sample of the study
([diagnosis_study.md](diagnosis_study.md)), every k-th case of each part, diagnosed without one check
(`flexjoint/diagnosis/verdict/checks`) or stage at a time. One that changed nothing in a case leaves it as it
is, so that only the cases in which it did something were diagnosed again. The sample is small: a check that
earns nothing here is rarely needed; it may still be needed.

*exact*, *tied*: causes that can be named, as in the study. *wrong*: names stated above {wrong} that stand for
nothing that is there, on all machines. *alarms*: healthy machines called anything else. *large*: large causes
of dirty machines, named with at least {named}. *better*, *worse*: cases that have more right names, fewer
wrong ones or no alarm with it, and the other way round; *other*: that come out otherwise, and are no better
or worse by these counts. *seconds*: processor time of the cases in which it did something, with and without.
"""


def page(cases: Sequence[dict[str, Any]]) -> str:
    """The page."""
    usual = [case["with"] for case in cases]
    counts = ", ".join(f"{sum(r['part'] == part for r in usual)} {part}" for part in SAMPLE)
    made = (
        f"\nCode {code(usual)}. Sample, {len(usual)} cases: {counts};"
        f" {sum(map(_clean, usual))} whose causes can be named,"
        f" {sum(len(dirty.large_causes([r])) for r in usual)} large causes on dirty machines. All of it takes"
        f" {sum(r['cpu'] for r in usual):.0f} s with everything.\n"
    )
    rows: list[Sequence[object]] = [("nothing", "", *Counts.of(usual).told(), "", "", "", "")]
    idle = []
    for piece in pieces():
        changed = [
            (case["with"], case["without"][piece.name]) for case in cases if piece.name in case["without"]
        ]
        better, worse, other = _compared(changed)
        left = Counts.of([case["without"].get(piece.name, case["with"]) for case in cases]).told()
        taken = ", ".join(f"{sum(pair[k]['cpu'] for pair in changed):.0f}" for k in (0, 1))
        rows.append((piece.name, len(changed), *left, better, worse, other, taken if changed else ""))
        idle += [piece.name] * (not better)
    heads = ("left out", "did something in", "exact", "tied", "wrong", "alarms", "large")
    result = table((*heads, "better", "worse", "other", "seconds"), rows)
    earned = f"\nThese make no case of the sample better: {', '.join(idle) or 'none'}.\n"
    return WORDS.format(wrong=WRONG, named=dirty.NAMED) + made + result + earned + _changes(cases)


def _compared(changed: Sequence[tuple[Record, Record]]) -> tuple[int, int, int]:
    better = sum(_gains(merit(one), merit(other)) for one, other in changed)
    worse = sum(_gains(merit(other), merit(one)) for one, other in changed)
    other = sum(merit(one) == merit(other) and _said(one) != _said(other) for one, other in changed)
    return better, worse, other


def _gains(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    """Whether one merit is better than the other in any count."""
    return any(a > b for a, b in zip(one, other, strict=True))


def _changes(cases: Sequence[dict[str, Any]]) -> str:
    rows = []
    for piece in pieces():
        for case in cases:
            one, other = case["with"], case["without"].get(piece.name)
            if other is not None and _said(one) != _said(other):
                truth = ", ".join(f"{t['effect']}/{t['joint']}" for t in one["truth"]) or "nothing"
                where = f"{one['part']} {one['number']}"
                rows.append((piece.name, where, truth, _said(one), _said(other)))
    heads = ("left out", "case", "planted", "with it", "without it")
    return "\n## Cases that come out otherwise\n" + table(heads, rows)
