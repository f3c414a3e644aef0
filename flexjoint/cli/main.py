"""The command line: `flexjoint init | import | check-data | diagnose | compare | simulate | view | ...`.

Exit code 0 when the work was done (a diagnosis that refuses is done), 1 where a check finds a change, 2 on
unusable input with one line on standard error. What a command needs is imported when it runs.
"""

from __future__ import annotations

import argparse
import errno
import importlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from flexjoint.cli import options, streams
from flexjoint.cli.interrupts import INTERRUPTED, end_now, ended_at_once
from flexjoint.cli.paper import command as paper
from flexjoint.cli.simulation import view
from flexjoint.core.errors import FlexJointError

UNUSABLE = 2
CHECK = (
    "Refit the known causes to a new recording. Exit code 0: as before; 1: changed; 2: unusable."
    " --robot is the nominal robot of the diagnosis; an extended robot may stand alone."
)
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)  # what an output that takes no more says


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code, 0 unless the command has another (`--help` and wrong usage exit
    by themselves)."""
    with streams.plain():
        try:
            arguments = _parser().parse_args(argv)
            code = arguments.run(arguments)
            sys.stdout.flush()
        except FlexJointError as error:
            return _say(error, UNUSABLE)
        except BrokenPipeError:  # whoever read the output has enough of it
            streams.abandon_output()
            return 0
        except OSError as error:
            if error.filename is None and error.errno not in FULL:
                raise
            streams.abandon_output()
            return _say(f"{error.filename or 'output'}: {error.strerror}", UNUSABLE)
        except MemoryError:
            return _say("memory is short; give less at once, or cut the recording", UNUSABLE)
        except KeyboardInterrupt:
            streams.say_interrupted()
            return INTERRUPTED
    return int(code or 0)


def command() -> NoReturn:
    """The program: `main`, and its end, on which Ctrl-C waits for nothing."""
    with ended_at_once() as interrupted:
        try:
            code = main()
        except Exception:
            if not interrupted():
                raise
            code = INTERRUPTED  # a library has made another exception of it
        if interrupted():
            streams.say_interrupted()
            code = INTERRUPTED
        if code == INTERRUPTED:  # what is in memory need not be put away
            end_now(code)
    raise SystemExit(code)


def _say(message: object, code: int) -> int:
    streams.say(message)
    return code


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, and which raises OSError where its help cannot be
    written: argparse's own keeps silent."""

    def _print_message(self, message: str, file: Any = None) -> None:
        print(message, end="", file=file, flush=True)

    def error(self, message: str) -> NoReturn:
        raise SystemExit(_say(f"{message} (see {self.prog} --help)", UNUSABLE))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="flexjoint",
        description="Simulate, compare and diagnose robots with series elastic and flexible joints.",
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    _add_init(commands)
    _add_import(commands)

    _add_diagnose(commands)
    _add_check(commands)
    _add_fleet(commands)
    _add_check_data(commands)

    compare = commands.add_parser("compare", help="measure how far a robot's simulation is from a recording")
    compare.add_argument("recording", type=Path, metavar="REC", help="table, or another log")
    options.add_robot(compare)
    options.add_mapping(compare)
    compare.add_argument("--horizon", type=float, default=0.5, help="window length [s], default 0.5")
    compare.add_argument("--closed-loop", action="store_true", help="drive by references, not by torques")
    options.add_engine(compare)
    options.add_budget(compare)
    compare.add_argument("--json", type=Path, metavar="OUT.json", help="write the errors as JSON")
    compare.set_defaults(run=_lazily("diagnosis.compare"))

    simulate = commands.add_parser("simulate", help="simulate a robot along a reference")
    options.add_robot(simulate)
    simulate.add_argument(
        "--reference", type=Path, required=True, metavar="REC", help="table with q_ref, or tau_m"
    )
    simulate.add_argument(
        "--out", type=Path, required=True, metavar="REC", help="recording to write (.csv or .parquet)"
    )
    simulate.add_argument(
        "--scheme", metavar="NAME", help="integration scheme (docs/explained/simulation.md)"
    )
    simulate.add_argument(
        "--width", type=float, metavar="W", help="[rad/s] over which schemes that need it smooth dry friction"
    )
    options.add_engine(simulate)
    options.add_budget(simulate)
    simulate.set_defaults(run=_lazily("simulation.simulate"))

    _add_theta_d(commands)
    view.add(commands)

    _add_plan(commands)
    _add_export(commands)

    demo = commands.add_parser("demo", help="diagnose a real robot's recording that comes with flexjoint")
    demo.add_argument("--out", type=Path, default=Path("flexjoint-demo"), metavar="FOLDER")
    demo.set_defaults(run=_lazily("diagnosis.demo"))

    robots = commands.add_parser("robots", help="list the robots that come with flexjoint")
    robots.set_defaults(run=_lazily("robots.robots"))

    effects = commands.add_parser("effects", help="list the physical effects it knows")
    effects.add_argument("--markdown", action="store_true", help="as the page docs/reference/effects.md")
    effects.set_defaults(run=_lazily("robots.effects"))

    schema = commands.add_parser("schema", help="print the JSON schema of what a command writes")
    schema.add_argument("name", nargs="?", metavar="NAME", help="without one, the names")
    schema.set_defaults(run=_lazily("programs.schema"))

    serve = commands.add_parser(
        "mcp", help="serve programs that call tools, over stdio (docs/reference/programs.md)"
    )
    serve.set_defaults(run=_lazily("programs.serve"))

    paper.add(commands)
    _add_benchmark(commands)
    return parser


def _add_diagnose(commands: Any) -> None:
    diagnose = commands.add_parser("diagnose", help="name what the simulation gets wrong on a recording")
    diagnose.add_argument(
        "recordings", nargs="+", type=Path, metavar="REC", help="table, another log, or a folder of them"
    )
    options.add_robot(diagnose)
    options.add_mapping(diagnose)
    diagnose.add_argument(
        "--payload",
        action="append",
        default=[],
        metavar="REC:JOINT=KG,X,Y,Z",
        help="a known load in one of the recordings, its centre in the link frame [m]; may be repeated",
    )
    diagnose.add_argument("--json", type=Path, metavar="OUT.json", help="write the diagnosis as JSON")
    diagnose.add_argument("--report", type=Path, metavar="OUT.html", help="write a page to read")
    diagnose.add_argument("--model", type=Path, metavar="OUT.yaml", help="write the extended robot")
    diagnose.add_argument(
        "--all-causes",
        action="store_true",
        help="put causes below 50 %% probability into the extended robot, too",
    )
    diagnose.add_argument(
        "--numbers",
        action="store_true",
        help="change nominal numbers within their tolerances in the extended robot, too",
    )
    diagnose.add_argument(
        "--learn",
        action="store_true",
        help="learn smooth laws of what no cause explains, into the extended robot, too",
    )
    diagnose.add_argument("--quiet", action="store_true", help="print nothing")
    diagnose.add_argument(
        "--no-refine", action="store_true", help="leave the numbers as the torque balances give them"
    )
    diagnose.add_argument(
        "--ignore-data-checks",
        action="store_true",
        help="go on with data whose signs, zeros, units or names cannot be right",
    )
    options.add_budget(diagnose)
    diagnose.set_defaults(run=_lazily("diagnosis.diagnose"))


def _add_check(commands: Any) -> None:
    check = commands.add_parser(
        "check", help="whether a robot is as it was; exit code 1 where it has changed", description=CHECK
    )
    check.add_argument("recording", type=Path, metavar="REC", help="table, or another log")
    check.add_argument(
        "--against",
        type=Path,
        required=True,
        metavar="D.json|E.yaml",
        help="a diagnosis (`diagnose --json`) or an extended robot (`diagnose --model`)",
    )
    options.add_robot(check, required=False)
    options.add_mapping(check)
    check.add_argument("--json", type=Path, metavar="OUT.json", help="write the check as JSON")
    check.add_argument("--quiet", action="store_true", help="print nothing")
    check.set_defaults(run=_lazily("diagnosis.check"))


def _add_fleet(commands: Any) -> None:
    fleet = commands.add_parser("fleet", help="watch many robots: who needs somebody, and for what")
    fleet.add_argument(
        "source",
        type=Path,
        metavar="FOLDER|LIST",
        help="one folder a robot, or a list (docs/howto/fleets.md)",
    )
    fleet.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="results; work is kept there"
    )
    fleet.add_argument("--robot", type=Path, metavar="R.yaml", help="robot file of all that name none")
    fleet.add_argument("--workers", type=int, metavar="N", help="local processes, default one per core")
    fleet.add_argument("--scheduler", metavar="tcp://...", help="of a Dask cluster that does the work")
    fleet.add_argument("--quiet", action="store_true", help="print nothing")
    fleet.set_defaults(run=_lazily("diagnosis.fleet"))


def _add_check_data(commands: Any) -> None:
    data = commands.add_parser("check-data", help="find wrong signs, zeros, units and names in a recording")
    data.add_argument("recording", type=Path, metavar="REC", help="table, or another log")
    options.add_robot(data)
    options.add_mapping(data)
    data.add_argument(
        "--out", type=Path, metavar="REC", help="write the repaired recording (.csv or .parquet)"
    )
    data.add_argument("--json", type=Path, metavar="OUT.json", help="write the findings as JSON")
    data.set_defaults(run=_lazily("recordings.check_data"))


def _add_init(commands: Any) -> None:
    init = commands.add_parser("init", help="write the robot file of a URDF, MJCF or SDF")
    init.add_argument(
        "description",
        metavar="DESCRIPTION",
        help="URDF, MJCF or SDF, package://... of example-robot-data, or a name of robot_descriptions",
    )
    init.add_argument("--out", type=Path, default=Path("robot.yaml"), metavar="ROBOT.yaml")
    init.add_argument("--recording", type=Path, metavar="LOG", help="check it, and fill in what it shows")
    init.add_argument("--rigid", action="store_true", help="say nothing of springs: all joints are rigid")
    init.add_argument("--force", action="store_true", help="write over a robot file that is there")
    options.add_log(init)
    init.set_defaults(run=_lazily("robots.init"))


def _add_import(commands: Any) -> None:
    log = commands.add_parser("import", help="make a recording of another program's log")
    log.add_argument("log", type=Path, metavar="LOG", help="a file, or the folder of a bag or dataset")
    log.add_argument("--to", type=Path, metavar="TABLE", help="recording to write (.csv or .parquet)")
    log.add_argument("--signals", action="store_true", help="list what the log holds, and write nothing")
    log.add_argument("--robot", metavar="R.yaml", help="names of joints, gear ratios, and a check against it")
    options.add_log(log)
    log.set_defaults(run=_lazily("recordings.import_log"))


def _add_theta_d(commands: Any) -> None:
    theta_d = commands.add_parser("theta-d", help="motor positions and torques that hold given poses")
    theta_d.add_argument("poses", type=Path, metavar="POSES", help="CSV or Parquet table with q.<joint>")
    options.add_robot(theta_d)
    theta_d.add_argument("--out", type=Path, required=True, metavar="OUT", help=".csv or .parquet to write")
    theta_d.add_argument(
        "--contact",
        action="append",
        default=[],
        metavar="FRAME",
        help="a point that carries; may be repeated",
    )
    theta_d.add_argument("--path", action="store_true", help="poses are a slow path: hysteresis remembers")
    theta_d.add_argument("--max-deflection", type=float, metavar="RAD", help="largest theta - q to accept")
    theta_d.add_argument("--details", action="store_true", help="write g.<joint> and phi.<joint>, too")
    theta_d.set_defaults(run=_lazily("simulation.theta_d"))


def _add_plan(commands: Any) -> None:
    plan = commands.add_parser("plan", help="design the recording that decides what a diagnosis left open")
    options.add_robot(plan)
    plan.add_argument("--diagnosis", type=Path, metavar="D.json", help="break its ties (`diagnose --json`)")
    plan.add_argument(
        "--out", type=Path, required=True, metavar="REF", help="reference to write (.csv or .parquet)"
    )
    plan.add_argument("--seconds", type=float, help="duration, default 16")
    plan.add_argument("--reach", type=float, help="rad to either side of the centre, default 0.6")
    plan.add_argument("--speed", type=float, help="rad/s at most, default the URDF's limit")
    plan.add_argument("--seed", type=int, default=1, help="of the search for a motion, default 1")
    plan.add_argument("--json", type=Path, metavar="OUT.json", help="write what to expect as JSON")
    plan.add_argument("--quiet", action="store_true", help="print nothing")
    plan.set_defaults(run=_lazily("diagnosis.plan"))


def _add_export(commands: Any) -> None:
    export = commands.add_parser("export", help="write a robot for MuJoCo, Gazebo, Isaac Lab, Drake or ROS")
    export.add_argument("robot", metavar="ROBOT.yaml", help="robot file, or the name of a shipped robot")
    export.add_argument(
        "--to",
        required=True,
        metavar="TARGET",
        help="mjcf, urdf, sdf, isaaclab, drake or ros2_control (docs/reference/exporting.md)",
    )
    export.add_argument("--out", type=Path, required=True, metavar="OUT", help="the file to write")
    export.add_argument(
        "--measure",
        type=Path,
        metavar="REC",
        help="run the exported MJCF in MuJoCo beside the simulation, in the windows of this recording",
    )
    export.add_argument("--horizon", type=float, default=0.5, help="their length [s], default 0.5")
    options.add_choice(export)
    options.add_mapping(export)
    options.add_engine(export)
    export.set_defaults(run=_lazily("robots.export"))


def _add_benchmark(commands: Any) -> None:
    benchmark = commands.add_parser("benchmark", help="recordings with known defects, for any tool")
    verbs = benchmark.add_subparsers(required=True, metavar="VERB")
    making = verbs.add_parser("make", help="write recordings, nominal models and the sealed truth")
    making.add_argument("out", type=Path, metavar="OUT", help="a new folder")
    making.add_argument("--count", type=int, default=10, help="cases of each part, default 10")
    making.add_argument("--seed", type=int, default=1, help="draws the machines, default 1")
    making.add_argument("--parts", nargs="+", metavar="PART", help="default: all (docs/studies/benchmark.md)")
    making.add_argument("--no-real", action="store_true", help="leave recordings of real machines out")
    making.set_defaults(run=_lazily("programs.benchmark", "make_folder"))
    answering = verbs.add_parser("answer", help="flexjoint's own answers")
    answering.add_argument("folder", type=Path, metavar="OUT", help="what `make` wrote")
    answering.add_argument("answers", type=Path, metavar="ANSWERS.json", help="to write, or to go on with")
    answering.set_defaults(run=_lazily("programs.benchmark", "answer"))
    scoring = verbs.add_parser("score", help="what a tool's answers are worth")
    scoring.add_argument("folder", type=Path, metavar="OUT", help="what `make` wrote")
    scoring.add_argument(
        "answers", type=Path, metavar="ANSWERS.json", help="of any tool (docs/studies/benchmark.md)"
    )
    scoring.add_argument("--json", type=Path, metavar="OUT.json", help="write the score as JSON")
    scoring.set_defaults(run=_lazily("programs.benchmark", "show_score"))


def _lazily(command: str, function: str = "run") -> Callable[[argparse.Namespace], int | None]:
    """A command's `run`, whose module, and all that it needs, is imported when it runs."""

    def run(arguments: argparse.Namespace) -> int | None:
        module = importlib.import_module(f"flexjoint.cli.{command}")
        code: int | None = getattr(module, function)(arguments)
        return code

    return run


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"flexjoint {version('flexjoint')}"
    except PackageNotFoundError:  # run from a checkout
        return "flexjoint (not installed)"
