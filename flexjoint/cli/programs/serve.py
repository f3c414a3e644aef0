"""`flexjoint mcp`: flexjoint for programs that call tools, over stdio (Model Context Protocol).

Every tool takes paths and gives what the command of its name writes as JSON (`flexjoint schema`). Nothing is
written but what a tool is given a path for.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexjoint.cli.diagnosis.plan import content as plan_content
from flexjoint.cli.outputs import Asked, check_place
from flexjoint.core.errors import FlexJointError, MissingExtraError
from flexjoint.diagnosis import pipeline
from flexjoint.diagnosis.comparison import compare as comparing
from flexjoint.diagnosis.followup import experiment
from flexjoint.diagnosis.followup.agreement.agreement import agreement
from flexjoint.diagnosis.followup.checking import check as checking
from flexjoint.diagnosis.followup.learning import learn as learning
from flexjoint.diagnosis.result import Diagnosis, to_json
from flexjoint.diagnosis.result.known import parsed
from flexjoint.diagnosis.result.wording import cause
from flexjoint.effects import catalogue
from flexjoint.recording import checks
from flexjoint.recording import table as tables
from flexjoint.recording.importing import logs_in, read
from flexjoint.recording.table import Recording
from flexjoint.robot.robot import Robot, load

if TYPE_CHECKING:
    from mcp.server import MCPServer

ABOUT = "Diagnose what a robot's simulation gets wrong. Paths are of files on this machine; units are SI."


def run(arguments: argparse.Namespace) -> None:
    """Serve until the caller hangs up. Raises MissingExtraError without the extra `mcp`, and OSError where
    standard output takes nothing."""
    made = server()
    try:
        made.run("stdio")
    except BaseExceptionGroup as group:
        raise _first(group) from None


def _first(error: BaseException) -> BaseException:
    """What went wrong in the first of a group's tasks."""
    return _first(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error


def server() -> MCPServer:
    """The server with its tools."""
    try:
        from mcp.server import MCPServer
    except ImportError:
        raise MissingExtraError("mcp", "mcp") from None
    made = MCPServer("flexjoint", instructions=ABOUT)
    for tool in (diagnose, learn, check, compare, plan, explain):
        made.tool()(_saying(tool))
    return made


def _saying(tool: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """The tool with what it cannot use told to the caller in one line, as the commands do."""
    from mcp.server.mcpserver.exceptions import ToolError

    @wraps(tool)
    def said(*args: Any, **arguments: Any) -> dict[str, Any]:
        try:
            return tool(*args, **arguments)
        except (FlexJointError, OSError) as error:
            raise ToolError(str(error)) from None

    return said


def diagnose(recordings: list[str], robot: str, out: str = "") -> dict[str, Any]:
    """Name what the robot's simulation gets wrong on recordings of it, with sizes and standard errors.

    recordings: paths of tables, logs or folders of them. robot: path of a robot file, or a shipped robot's
    name. out: path of a .json that the diagnosis is written to as well. It may take minutes.
    """
    nominal = load(robot)
    asked = _asked(out, "", [*recordings, robot])
    result = _diagnosed(nominal, _read(recordings, nominal))
    return _written(asked, result, nominal)


def learn(recordings: list[str], robot: str, out: str = "", model: str = "") -> dict[str, Any]:
    """Diagnose recordings of a robot, then learn smooth laws without a name of what no cause explains, each
    kept only where it holds on data that it did not see. `learned` of the answer holds them.

    recordings: paths of tables, logs or folders of them. robot: path of a robot file, or a shipped robot's
    name. out: path of a .json that the diagnosis is written to as well. model: path of a .yaml that the robot
    with its likely causes and these laws is written to. It may take minutes.
    """
    nominal = load(robot)
    asked = _asked(out, model, [*recordings, robot])
    found = _read(recordings, nominal)
    result = learning.learn(nominal, found, _diagnosed(nominal, found))
    return _written(asked, result, nominal)


def check(recording: str, against: str, robot: str = "") -> dict[str, Any]:
    """Say in seconds whether a robot is as it was when it was diagnosed.

    against: a diagnosis (.json) with its nominal robot, or an extended robot (.yaml) alone.
    """
    if not robot and not against.endswith((".yaml", ".yml")):
        raise FlexJointError(f"{against} does not hold its robot; give that, too")
    known = load(robot or against)
    return checking.check(known, _recording(recording, known), against if robot else None).to_json()


def compare(recording: str, robot: str, horizon: float = comparing.HORIZON) -> dict[str, Any]:
    """Measure how far a robot's simulation is from a recording, per channel, in windows of `horizon`
    seconds."""
    nominal = load(robot)
    return comparing.compare(nominal, _recording(recording, nominal), horizon=horizon).to_json()


def plan(robot: str, out: str, diagnosis: str = "", seconds: float = 16.0) -> dict[str, Any]:
    """Design the recording that decides what a diagnosis left open, and write its reference (.csv or
    .parquet).

    diagnosis: path of its JSON; without one the whole catalogue is to be excited.
    """
    nominal = load(robot)
    _check_out(out, (".csv", ".parquet"), [diagnosis])
    limits = experiment.limits_of(nominal, seconds)
    made = experiment.plan(nominal, Path(diagnosis) if diagnosis else None, limits)
    tables.write(made.reference, Path(out))
    return plan_content(made, nominal, Path(out))


def explain(diagnosis: str, robot: str, finding: int = 0) -> dict[str, Any]:
    """Explain a cause that a diagnosis names: its law, its numbers, the evidence, what else it could be.

    diagnosis: path of its JSON. finding: which of its causes, 0 the main one.
    """
    return parsed(Path(diagnosis), load(robot), lambda content, _robot: _explained(content, finding))


def _explained(content: Mapping[str, Any], index: int) -> dict[str, Any]:
    findings = content["findings"]
    if not 0 <= index < len(findings):
        raise FlexJointError(f"expected a finding from 0 to {len(findings) - 1}, got {index}")
    one = findings[index]
    law = catalogue()[one["effect"]]
    steps = [s for s in content["trace"] if (s["effect"], s["joint"]) == (one["effect"], one["joint"])]
    return {
        "schema": 1,
        "cause": cause(one["effect"], one["joint"]),
        "what": (type(law).__doc__ or "").strip(),
        "law": law.law,
        "reference": law.reference,
        "probability": one["probability"],
        "parameters": one["parameters"],
        "evidence": {"removed": one["removed"], "gain": one["gain"], "steps": [s["text"] for s in steps]},
        "could_also_be": one["indistinguishable"],
        "next_experiment": content["next_experiment"],
    }


def _read(recordings: Sequence[str], robot: Robot) -> list[Recording]:
    return [_recording(str(log), robot) for path in recordings for log in logs_in(path)]


def _diagnosed(robot: Robot, recordings: Sequence[Recording]) -> Diagnosis:
    return agreement(robot, recordings, pipeline.diagnose(robot, recordings))


def _asked(out: str, model: str, inputs: Sequence[str]) -> Asked:
    """The files that are to be written; refused before the long work where they cannot be."""
    asked = Asked(json=Path(out) if out else None, model=Path(model) if model else None)
    asked.check([Path(path) for path in inputs])
    return asked


def _written(asked: Asked, diagnosis: Diagnosis, nominal: Robot) -> dict[str, Any]:
    content = to_json(diagnosis, asked.model_name())
    asked.write(content, None, diagnosis.extend(nominal))
    return content


def _recording(path: str, robot: Robot) -> Recording:
    found = read(path, None, robot).recording
    checks.check(robot, found)
    return found


def _check_out(out: str, suffixes: Sequence[str], inputs: Sequence[str]) -> None:
    if out:
        check_place(Path(out), suffixes, [Path(path) for path in inputs if path])
