"""A fleet: work is kept and not done again, a bad file or a killed worker stops nothing, and who changed is
shown."""

from __future__ import annotations

import csv
import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from pathlib import Path

import pytest
from planting import Planted, plant
from pyarrow import parquet
from support import mortal
from support.cli_runs import complaint, run
from support.diagnose_cases import ROBOTS, SENSORS, as_recording, nominal
from support.thorough import thorough

from flexjoint.core.errors import FlexJointError
from flexjoint.diagnosis.followup.fleet import campaign, words, workers
from flexjoint.diagnosis.followup.fleet.assess import assessed, of_types
from flexjoint.diagnosis.followup.fleet.campaign import Period, Reading
from flexjoint.diagnosis.followup.fleet.roster import Entry, Event
from flexjoint.diagnosis.followup.fleet.trends import DAY
from flexjoint.diagnosis.followup.fleet.units import Store, Unit, perform, release, unit_of
from flexjoint.diagnosis.followup.fleet.workers import cluster, local
from flexjoint.diagnosis.settings import FleetSettings
from flexjoint.recording.table import Recording
from flexjoint.recording.table import write as write_recording
from flexjoint.report.fleet import watch

LEVER = ROBOTS / "lever.yaml"
SETTINGS = FleetSettings()


@cache
def recorded(seed: int, gap: float = 0.0) -> Recording:
    causes = [Planted("backlash", "swing", {"gap": gap})] if gap else []
    return as_recording(plant(LEVER, causes, "rich", 6.0, seed, SENSORS["full"]), f"lever-{seed}")


@pytest.fixture
def fleet_folder(tmp_path: Path) -> Path:
    """Two robots of three recordings: one that stays as it is, one that has play from the second one on; and
    a file that is none."""
    folder = tmp_path / "logs"
    folder.mkdir()
    rows = []
    for machine, gaps in (("calm", (0.0, 0.0, 0.0)), ("worn", (0.0, 0.01, 0.01))):
        for k, gap in enumerate(gaps):
            name = f"{machine}_{k}.parquet"
            write_recording(recorded(61 + k + (10 if machine == "worn" else 0), gap), folder / name)
            rows.append((name, machine, f"2026-03-{2 + 7 * k:02d}"))
    (folder / "broken.csv").write_text("time,q.swing\n0,zero\n")
    rows.append(("broken.csv", "calm", "2026-03-12"))
    with (folder / "roster.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("recording", "machine", "time"), *rows])
    return folder


# ------------------------------------------------------------------ the whole way
@thorough
def test_who_changed_is_shown_and_work_is_not_done_again(
    fleet_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    assert run("fleet", fleet_folder, "--out", out, "--robot", LEVER, "--workers", 1) == 0
    shown = capsys.readouterr().out
    assert "2 robots: 1 need somebody" in shown and "lost motion" in shown and "arcmin" in shown
    table = parquet.read_table(out / "fleet.parquet").to_pylist()
    gaps = {row["recording"][-14:]: row["value"] for row in table if row["parameter"] == "gap"}
    assert gaps["worn_1.parquet"] == pytest.approx(0.01, rel=0.01)  # known to 0.1 %; 6 s are short
    assert {row["robot"] for row in table} == {"calm", "worn"}
    page = (out / "fleet.html").read_text(encoding="utf-8")
    assert "1 robot needs somebody" in page and "broken.csv" in page and "<script" not in page
    found = json.loads((out / "fleet.json").read_text())
    assert {one["robot"]: one["state"] for one in found["robots"]} == {"calm": "green", "worn": "needs"}
    assert found["robots"][0]["troubles"][0]["joint"] == "swing"
    again = watch.watch(fleet_folder, out, robot=LEVER, workers=1)
    assert again.units == 0  # all results lay there
    assert [line.period.machine for line in again.of("needs")] == ["worn"]
    (line,) = again.of("needs")
    assert line.troubles[0].joint == "swing" and line.troubles[0].sort == "wear"
    assert [line.period.machine for line in again.of("green")] == ["calm"]
    (period,) = (period for period in again.periods if period.machine == "calm")
    assert [entry.recording.name for entry, _ in period.unusable] == ["broken.csv"]


def test_nothing_to_watch_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = complaint(capsys, "fleet", tmp_path / "none", "--out", tmp_path / "out")
    assert "does not exist" in said
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------ units
def test_a_unit_is_known_by_all_that_its_result_depends_on(tmp_path: Path) -> None:
    one, other = tmp_path / "a.csv", tmp_path / "b.csv"
    one.write_text("time\n0\n")
    other.write_text("time\n0\n")
    key = unit_of("check", one, LEVER, {"schema": 1}).key
    assert unit_of("check", other, LEVER, {"schema": 1}).key == key  # not its name
    others = (
        unit_of("diagnosis", one, LEVER, {"schema": 1}),
        unit_of("check", one, LEVER, {"schema": 2}),
        unit_of("check", one, ROBOTS / "crane.yaml", {"schema": 1}),
    )
    assert key not in {unit.key for unit in others}
    one.write_text("time\n1\n")
    assert unit_of("check", one, LEVER, {"schema": 1}).key != key


def test_a_bad_file_is_a_result(tmp_path: Path) -> None:
    result = perform(unit_of("diagnosis", tmp_path / "none.csv", LEVER))
    assert "none.csv" in result["error"] and result["version"] == release()
    store = Store(tmp_path / "units")
    store.put(result)
    assert store.get(result["key"]) == result
    (tmp_path / "units" / f"{result['key']}.json").write_text("{")
    assert store.get(result["key"]) is None  # damaged: done again


def units(folder: Path) -> list[Unit]:
    kinds = ("never", "once", "never", "always", "never")
    return [Unit(f"k{k}", "check", str(folder / f"m{k}"), kind) for k, kind in enumerate(kinds)]


def outcome(results: Iterator[dict[str, object]]) -> dict[object, object]:
    return {result["key"]: bool(result.get("died")) for result in results}


def test_a_unit_that_a_broken_pool_refuses_is_not_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker may die between the result of one unit and the handing out of the next one."""

    class Breaking:
        left = 4  # units that it takes

        def __enter__(self) -> Breaking:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def submit(self, function: Callable[[Unit], dict[str, object]], unit: Unit) -> Future[object]:
            if Breaking.left == 0:
                raise BrokenProcessPool
            Breaking.left -= 1
            future: Future[object] = Future()
            future.set_result(function(unit))
            return future

    monkeypatch.setattr(workers, "_pool", lambda _workers: Breaking())
    monkeypatch.setattr(workers, "_alone", lambda unit, _restarts: {"key": unit.key})
    monkeypatch.setattr(workers, "perform", lambda unit: {"key": unit.key})
    assert set(outcome(local(2, 1)(units(tmp_path)))) == {"k0", "k1", "k2", "k3", "k4"}


def test_a_killed_worker_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "perform", mortal.perform)
    done = outcome(local(2, 1)(units(tmp_path)))
    assert done == {"k0": False, "k1": False, "k2": False, "k3": True, "k4": False}


def test_progress_is_shown_before_the_first_unit_is_done(tmp_path: Path) -> None:
    said: list[object] = []
    ours = units(tmp_path)[:2]
    done = ({"key": unit.key, "seconds": 1.0, "error": ""} for unit in ours)
    work = campaign._Work(Store(tmp_path), lambda _units: done, lambda *told: said.append(told))
    assert set(work.done(ours, "checking")) == {"k0", "k1"}
    assert said == [(0.0, "checking"), (0.5, "checking"), (1.0, "checking")]
    work.done(ours, "checking")
    assert len(said) == 3  # what is done already takes no time


def test_workers_are_killed_where_nobody_waits_for_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a result cannot be written: who stops asking waits for no unit that is under way."""
    monkeypatch.setattr(workers, "perform", mortal.perform)
    kinds = ("never", "slow", "slow", "slow")
    results = local(2, 1)([Unit(f"k{k}", "check", str(tmp_path), kind) for k, kind in enumerate(kinds)])
    assert next(results)["key"] == "k0"
    begin = time.monotonic()
    results.close()  # type: ignore[attr-defined]
    assert time.monotonic() - begin < 10.0  # of the minute that a unit takes
    assert not multiprocessing.active_children()


@thorough
def test_a_dask_cluster_does_the_same_units(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two workers in processes of their own, of which one is killed in the middle; its nanny starts
    another."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "perform", mortal.perform)
    ours = [unit for unit in units(tmp_path) if unit.robot != "always"]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as machines:
        done = outcome(cluster(machines.scheduler_address, 2)(ours))
    assert done == {"k0": False, "k1": False, "k2": False, "k4": False}
    with pytest.raises(FlexJointError, match="no Dask scheduler answers"):
        list(cluster("tcp://127.0.0.1:9", 2)(ours))


# ------------------------------------------------------------------ assessment
def period(machine: str, values: Sequence[float], alarms: Sequence[int] = (), robot: Path = LEVER) -> Period:
    """Weekly readings of a lever's friction."""
    key = ("motor_coulomb_friction", "swing", "level")
    readings = [
        Reading(
            Entry(machine, Path(f"{machine}_{k}.csv"), robot, 7.0 * DAY * k),
            {key: (value, 0.01)},
            {"swing": 0.1},
            {},
            {"swing": "friction moved"} if k in alarms else {},
        )
        for k, value in enumerate(values)
    ]
    return Period(machine, robot, None, tuple(readings), (), frozenset({key[:2]}))


def test_the_robot_that_wears_is_shown_with_its_date_and_the_others_are_green() -> None:
    calm = [period(f"c{k}", [1.0 + 0.01 * ((i * 7 + k) % 3 - 1) for i in range(8)]) for k in range(6)]
    worn = period("worn", [1.0, 1.01, 0.99, 1.0, 1.5, 1.51, 1.49, 1.5], alarms=(4, 5, 6, 7))
    lines = assessed([*calm, worn], {LEVER: nominal("lever")}, SETTINGS)
    assert [line.state for line in lines] == ["needs"] + ["green"] * 6
    (trouble,) = lines[0].troubles
    assert trouble.since == 28.0 * DAY and trouble.what.startswith("friction")
    assert "maintenance" in lines[0].next


def test_one_alarm_asks_for_a_second_recording_and_names_nothing() -> None:
    (line,) = assessed([period("a", [1.0, 1.0, 1.4], alarms=(2,))], {LEVER: nominal("lever")}, SETTINGS)
    assert line.state == "again" and not line.troubles and "second time" in line.next
    (line,) = assessed([period("a", [1.0, 1.4, 1.0], alarms=(1,))], {LEVER: nominal("lever")}, SETTINGS)
    assert line.state == "green"  # it has passed


def test_robots_of_one_type_are_each_others_reference() -> None:
    levels = (1.0, 1.01, 0.99, 1.02, 3.0)
    own = [period(name, [1.0, value]) for name, value in zip("abcde", levels, strict=True)]
    notes = of_types(own, SETTINGS)
    assert any("5 of 5 robots" in note and "nominal model" in note for note in notes)
    assert [note.split()[0] for note in notes if "odd" in note] == ["e"]


def test_a_repair_begins_anew() -> None:
    entries = tuple(Entry("a", Path(f"{k}.csv"), LEVER, float(k)) for k in range(4))
    roster = campaign.Roster(entries, (Event("a", 1.5, "gear replaced"),))
    first, second = campaign._split(roster)
    assert [len(one.entries) for one in (first, second)] == [2, 2]
    assert second.period.event is not None and second.period.event.text == "gear replaced"


def test_shop_words() -> None:
    robot = nominal("lever")
    assert words.amount("backlash", "gap", 0.001, robot, "swing") == "3.44 arcmin"
    limit = robot.joint("swing").torque_limit
    said = words.amount("motor_coulomb_friction", "level", 0.05 * limit, robot, "swing")
    assert said == "5 % of rated torque"
    assert words.amount("spring_stiffness", "scale", -0.12, robot, "swing") == "-12 %"
    assert words.amount("sensor_delay", "delay", 3e-3, robot, "swing") == "3 ms"
    assert [words.sort_of(e) for e in ("payload", "backlash", "sensor_delay", "motor_encoder_offset")] == [
        "setting",
        "wear",
        "sensor",
        "sensor",
    ]


def test_results_are_whole_json(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.put({"key": "k", "value": float("nan")})
    assert json.loads((tmp_path / "k.json").read_text()) == {"key": "k", "value": None}
