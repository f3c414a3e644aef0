"""What programs rely on: every JSON output keeps to its schema, and a real client calls the tools over
stdio."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from planting import Planted, plant
from support.cli_runs import complaint, run
from support.diagnose_cases import ROBOTS, SENSORS, as_recording, nominal
from support.pages import DOCS, blocks
from support.thorough import thorough

from flexjoint.cli.diagnosis.demo import Demo
from flexjoint.cli.diagnosis.demo import write as write_demo
from flexjoint.cli.main import _parser
from flexjoint.cli.programs import serve
from flexjoint.core.files import write_json
from flexjoint.diagnosis.comparison.compare import compare
from flexjoint.diagnosis.data.check import check_data
from flexjoint.diagnosis.followup.agreement.agreement import agreement
from flexjoint.diagnosis.followup.checking.check import check
from flexjoint.diagnosis.followup.fleet.assess import assessed
from flexjoint.diagnosis.followup.fleet.campaign import Period, Reading
from flexjoint.diagnosis.followup.fleet.fleet import Fleet
from flexjoint.diagnosis.followup.fleet.roster import Entry, Event
from flexjoint.diagnosis.followup.fleet.trends import DAY
from flexjoint.diagnosis.followup.fleet.units import Store, perform, unit_of
from flexjoint.diagnosis.pipeline import diagnose
from flexjoint.diagnosis.result import Diagnosis
from flexjoint.diagnosis.result.schema import names, schema
from flexjoint.diagnosis.settings import FleetSettings
from flexjoint.recording.table import Recording
from flexjoint.recording.table import write as write_recording

LEVER = ROBOTS / "lever.yaml"
Written = dict[str, dict[str, Any]]


def recorded(seed: int) -> Recording:
    offset = Planted("torque_offset", "swing", {"offset": 1.0})
    return as_recording(plant(LEVER, [offset], "rich", 6.0, seed, SENSORS["full"]), f"lever-{seed}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, and its diagnosis beside another one."""
    path = tmp_path_factory.mktemp("programs")
    write_recording(recorded(5), path / "rec.parquet")
    both = [recorded(5), recorded(6)]
    found = agreement(nominal("lever"), both, diagnose(nominal("lever"), both[0], workers=1))
    assert [f.effect for f in found.findings] == ["torque_offset"]
    found.write(path / "diagnosis.json")
    return path


@pytest.fixture(scope="module")
def written(folder: Path) -> Written:
    """Each output as its command writes it."""
    robot, one, out = nominal("lever"), recorded(5), folder
    turned = {k: -v if k == ("tau_m", "swing") else v for k, v in one.columns.items()}
    check(robot, one, folder / "diagnosis.json").write(folder / "check.json")
    compare(robot, one).write(folder / "comparison.json")
    wrong = check_data(robot, replace(one, columns=turned))
    assert wrong.findings
    wrong.write(folder / "data.json")
    known = json.loads((folder / "diagnosis.json").read_text())
    unit = unit_of("check", folder / "rec.parquet", LEVER, known)
    Store(folder / "units").put(perform(unit))
    (folder / "unit.json").write_bytes((folder / "units" / f"{unit.key}.json").read_bytes())
    known_to = ("--robot", LEVER, "--diagnosis", folder / "diagnosis.json")
    assert run("plan", *known_to, "--out", out / "ref.csv", "--json", out / "plan.json", "--quiet") == 0
    told = serve.explain(str(folder / "diagnosis.json"), str(LEVER))
    (folder / "explanation.json").write_text(json.dumps(told))
    _fleet(folder)
    _benchmark(folder)
    gains = {"rec_B": (compare(robot, one), compare(robot, one))}
    write_demo(Demo(robot, robot, one, Diagnosis("healthy", ""), gains), folder / "demo")
    (folder / "gain.json").write_bytes((folder / "demo" / "gain.json").read_bytes())
    return {name: json.loads((folder / f"{name}.json").read_text()) for name in names()}


def _fleet(folder: Path) -> None:
    """A machine that wears over six weeks, whose readings were made here: what is written of it is asked."""
    moments = [7.0 * DAY * k for k in range(6)]
    key = ("motor_coulomb_friction", "swing", "level")
    readings = [
        Reading(
            Entry("m1", Path(f"{k}.csv"), LEVER, moment, 20.0 + k % 3),
            {key: (1.0 + 0.5 * (k >= 3) + 1e-3 * (-1) ** k, 0.01)},
            {"swing": 0.1},
            {},
            {"swing": "more is left"} if k >= 3 else {},
        )
        for k, moment in enumerate(moments)
    ]
    bad = (Entry("m1", Path("bad.csv"), LEVER, moments[-1]), "no such file")
    period = Period("m1", LEVER, None, tuple(readings), (bad,))
    lines = assessed([period], {LEVER: nominal("lever")}, FleetSettings())
    assert lines[0].state == "needs" and lines[0].troubles and lines[0].trends
    event = Event("m1", moments[0], "gear changed")
    found = Fleet(lines, (period,), (event,), {}, ("one type", "of robot"), 0, 0.0)
    write_json(folder / "fleet.json", found.to_json())


def _benchmark(folder: Path) -> None:
    """A case, an answer to it and its score, by the commands."""
    place, answers = folder / "cases", folder / "benchmark_answers.json"
    assert run("benchmark", "make", place, "--count", 1, "--parts", "clean", "--no-real") == 0
    (folder / "benchmark_cases.json").write_bytes((place / "cases.json").read_bytes())
    assert run("benchmark", "answer", place, answers) == 0
    assert run("benchmark", "score", place, answers, "--json", folder / "benchmark_score.json") == 0


def undescribed(value: Any, described: dict[str, Any], where: str = "") -> list[str]:
    """Keys of an output that its schema does not name."""
    kinds = [described, *described.get("anyOf", [])]
    out: list[str] = []
    if isinstance(value, dict):
        known: dict[str, Any] = {key: s for kind in kinds for key, s in kind.get("properties", {}).items()}
        free = [kind for kind in kinds if "additionalProperties" in kind]
        anything = any(kind.get("type") == "object" and "properties" not in kind for kind in kinds)
        for key, inner in value.items():
            if key in known:
                out += undescribed(inner, known[key], f"{where}.{key}")
            elif not free and not anything:
                out.append(f"{where}.{key}")
    if isinstance(value, list):
        items = next((kind["items"] for kind in kinds if "items" in kind), {})
        out += [key for inner in value for key in undescribed(inner, items, where)]
    return out


@thorough
@pytest.mark.parametrize("name", names())
def test_what_is_written_keeps_to_its_schema(name: str, written: Written) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(schema(name))
    jsonschema.validate(written[name], schema(name), cls=jsonschema.Draft202012Validator)
    assert undescribed(written[name], schema(name)) == []
    first = next(iter(schema(name)["required"]))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({k: v for k, v in written[name].items() if k != first}, schema(name))


def test_every_command_that_writes_json_has_a_schema() -> None:
    titles = " ".join(schema(name)["title"] for name in names())
    writing = [command for command, options in _commands(_parser()) if "--json" in options]
    assert {"diagnose", "plan", "benchmark score"} <= set(writing)
    assert [command for command in writing if f"`flexjoint {command} --json`" not in titles] == []


def _commands(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, set[str]]]:
    """Each command and verb, with its options."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb, inner in action.choices.items():
                yield from _commands(inner, f"{name} {verb}".strip())
    yield name, {option for action in parser._actions for option in action.option_strings}


@pytest.mark.parametrize(
    ("page", "shown"),
    [
        ("reference/formats.md", ("comparison", "check", "plan", "diagnosis")),
        ("studies/benchmark.md", ("benchmark_answers",)),
    ],
)
def test_the_examples_of_a_page_keep_to_their_schemas(page: str, shown: tuple[str, ...]) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    for text, name in zip(blocks(DOCS / page, "json"), shown, strict=True):
        jsonschema.validate(json.loads(text), schema(name), cls=jsonschema.Draft202012Validator)


def test_a_refusal_keeps_to_the_schema_too(tmp_path: Path) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    Diagnosis("refused", "the robot hardly moves").write(tmp_path / "d.json")
    jsonschema.validate(json.loads((tmp_path / "d.json").read_text()), schema("diagnosis"))


def test_the_command_prints_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("schema") == 0
    assert capsys.readouterr().out.split() == list(names())
    assert run("schema", "check") == 0
    assert json.loads(capsys.readouterr().out) == schema("check")
    assert "valid: benchmark_answers, benchmark_cases" in complaint(capsys, "schema", "chek")


# ------------------------------------------------------------------ Model Context Protocol
@thorough
def test_a_client_calls_the_tools_over_stdio(folder: Path) -> None:
    pytest.importorskip("mcp")
    hose = Planted("kinked_hose", "swing", {"torque": 6.0, "angle": 0.2, "width": 0.1})  # of no catalogue
    one = plant(LEVER, [hose], "rich", 8.0, 3, SENSORS["full"])
    write_recording(as_recording(one, "hose"), folder / "hose.parquet")
    asyncio.run(asyncio.wait_for(_calls(folder), 100.0))


async def _calls(folder: Path) -> None:
    from mcp import Client, StdioServerParameters

    command = StdioServerParameters(
        command=sys.executable, args=["-m", "flexjoint", "mcp"], env={"PYTHONPATH": ":".join(sys.path)}
    )
    diagnosis, recording = str(folder / "diagnosis.json"), str(folder / "rec.parquet")
    async with Client(command) as client:
        tools = await client.list_tools()
        assert {tool.name for tool in tools.tools} == {
            "diagnose", "learn", "check", "compare", "plan", "explain",
        }  # fmt: skip

        async def call(tool: str, **arguments: Any) -> dict[str, Any]:
            answer = await client.call_tool(tool, arguments)
            assert not answer.is_error, answer.content
            return json.loads(answer.content[0].text)  # type: ignore[union-attr]

        told = await call("explain", diagnosis=diagnosis, robot=str(LEVER))
        assert told["cause"] == "torque offset at swing" and told["law"] and told["evidence"]["steps"]
        offset = told["parameters"]["offset"]
        assert abs(offset["value"] - 1.0) < 3.0 * offset["std"] + 1e-3  # and what the filter does
        checked = await call("check", recording=recording, against=diagnosis, robot=str(LEVER))
        assert checked["verdict"] == "as_before"
        compared = await call("compare", recording=recording, robot=str(LEVER))
        assert compared["windows"] == 12 and np.isfinite(compared["rms"]["q.swing"])
        extended = folder / "learned.yaml"
        learned = await call(
            "learn", recordings=[str(folder / "hose.parquet")], robot=str(LEVER), model=str(extended)
        )
        jsonschema = pytest.importorskip("jsonschema")
        jsonschema.validate(learned, schema("diagnosis"), cls=jsonschema.Draft202012Validator)
        assert [law["signal"] for law in learned["learned"]["laws"]] == ["q"]
        assert learned["model"] == str(extended)
        again = await call("compare", recording=str(folder / "hose.parquet"), robot=str(extended))
        before = await call("compare", recording=str(folder / "hose.parquet"), robot=str(LEVER))
        assert again["nrmse"]["q.swing"] < 0.1 * before["nrmse"]["q.swing"]
        wrong = await client.call_tool("compare", {"recording": "none.csv", "robot": str(LEVER)})
        assert wrong.is_error and "none.csv" in wrong.content[0].text  # type: ignore[union-attr]
