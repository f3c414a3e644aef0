"""The command line: `flexjoint diagnose | compare | simulate | plan | theta-d | view | paper | demo | ...`.

Exit code 0 when the work was done (a diagnosis that refuses is done), 2 on unusable input with one line on
standard error. Heavy modules are imported by the commands that need them.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from flexjoint import cli_paper, cli_robot, cli_view
from flexjoint.errors import FlexJointError

UNUSABLE = 2
INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code (`--help` and wrong usage exit by themselves)."""
    arguments = _parser().parse_args(argv)
    run: Callable[[argparse.Namespace], None] = arguments.run
    try:
        run(arguments)
        sys.stdout.flush()
    except FlexJointError as error:
        return _say(str(error), UNUSABLE)
    except BrokenPipeError:  # whoever read the output has enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.filename is None:
            raise
        return _say(f"{error.filename}: {error.strerror}", UNUSABLE)
    except KeyboardInterrupt:
        return _say("interrupted", INTERRUPTED)
    return 0


def _say(message: str, code: int) -> int:
    print(f"flexjoint: {' '.join(message.split())}", file=sys.stderr)
    return code


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Warnings as one line on standard error, without the place in the code."""
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *_rest: _warn(str(message))
        yield


def _warn(message: str) -> None:
    print(f"flexjoint: warning: {message}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        raise SystemExit(_say(f"{message} (see {self.prog} --help)", UNUSABLE))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="flexjoint",
        description="Simulate, compare and diagnose robots with series elastic and flexible joints.",
    )
    parser.add_argument("--version", action="version", version=_version())
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    diagnose = commands.add_parser("diagnose", help="name what the simulation gets wrong on a recording")
    diagnose.add_argument("recordings", nargs="+", type=Path, metavar="REC", help="CSV or Parquet table")
    cli_robot.add_arguments(diagnose)
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
    diagnose.add_argument("--quiet", action="store_true", help="print nothing")
    diagnose.add_argument(
        "--no-refine", action="store_true", help="leave the numbers as the torque balances give them"
    )
    diagnose.set_defaults(run=_diagnose)

    compare = commands.add_parser("compare", help="measure how far a robot's simulation is from a recording")
    compare.add_argument("recording", type=Path, metavar="REC", help="CSV or Parquet table")
    cli_robot.add_arguments(compare)
    compare.add_argument("--horizon", type=float, default=0.5, help="window length [s], default 0.5")
    compare.add_argument("--closed-loop", action="store_true", help="drive by references, not by torques")
    cli_robot.add_engine(compare)
    compare.add_argument("--json", type=Path, metavar="OUT.json", help="write the errors as JSON")
    compare.set_defaults(run=_compare)

    simulate = commands.add_parser("simulate", help="simulate a robot along a reference")
    cli_robot.add_arguments(simulate)
    simulate.add_argument(
        "--reference", type=Path, required=True, metavar="REC", help="table with q_ref, or tau_m"
    )
    simulate.add_argument(
        "--out", type=Path, required=True, metavar="REC", help="recording to write (.csv or .parquet)"
    )
    simulate.add_argument("--scheme", metavar="NAME", help="integration scheme (docs/simulation.md)")
    simulate.add_argument(
        "--width", type=float, metavar="W", help="[rad/s] over which schemes that need it smooth dry friction"
    )
    cli_robot.add_engine(simulate)
    simulate.set_defaults(run=_simulate)

    _add_theta_d(commands)
    cli_view.add(commands)

    _add_plan(commands)

    demo = commands.add_parser("demo", help="diagnose a real robot's recording that comes with flexjoint")
    demo.add_argument("--out", type=Path, default=Path("flexjoint-demo"), metavar="FOLDER")
    demo.set_defaults(run=_demo)

    robots = commands.add_parser("robots", help="list the robots that come with flexjoint")
    robots.set_defaults(run=_robots)

    effects = commands.add_parser("effects", help="list the physical effects it knows")
    effects.add_argument("--markdown", action="store_true", help="as the page docs/effects.md")
    effects.set_defaults(run=_effects)

    cli_paper.add(commands)
    return parser


def _add_theta_d(commands: Any) -> None:
    theta_d = commands.add_parser("theta-d", help="motor positions and torques that hold given poses")
    theta_d.add_argument("poses", type=Path, metavar="POSES", help="CSV or Parquet table with q.<joint>")
    cli_robot.add_arguments(theta_d)
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
    theta_d.set_defaults(run=_theta_d)


def _add_plan(commands: Any) -> None:
    plan = commands.add_parser("plan", help="design the recording that decides what a diagnosis left open")
    cli_robot.add_arguments(plan)
    plan.add_argument("--diagnosis", type=Path, metavar="D.json", help="break its ties (`diagnose --json`)")
    plan.add_argument(
        "--out", type=Path, required=True, metavar="REF", help="reference to write (.csv or .parquet)"
    )
    plan.add_argument("--seconds", type=float, help="duration, default 16")
    plan.add_argument("--reach", type=float, help="rad to either side of the centre, default 0.6")
    plan.add_argument("--speed", type=float, help="rad/s at most, default the URDF's limit")
    plan.add_argument("--seed", type=int, default=1, help="of the search for a motion, default 1")
    plan.add_argument("--quiet", action="store_true", help="print nothing")
    plan.set_defaults(run=_plan)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return f"flexjoint {version('flexjoint')}"
    except PackageNotFoundError:  # run from a checkout
        return "flexjoint (not installed)"


# --- commands ---------------------------------------------------------------------------------------------
def _diagnose(arguments: argparse.Namespace) -> None:
    from rich.console import Console

    from flexjoint import cli_outputs, recording
    from flexjoint.checks import check
    from flexjoint.diagnose import diagnose, extended_model
    from flexjoint.diagnosis import to_json
    from flexjoint.known_payload import parse
    from flexjoint.terminal import Progress, no_progress, summary

    asked = cli_outputs.Asked(arguments.json, arguments.report, arguments.model)
    asked.check([Path(arguments.robot), *arguments.recordings])
    nominal = cli_robot.load_chosen(arguments)
    recordings = [recording.read(path) for path in arguments.recordings]
    for table in recordings:
        check(nominal, table)
    payloads = parse(arguments.payload, [str(path) for path in arguments.recordings])
    with Progress() as bar:
        shown = no_progress if arguments.quiet else bar
        diagnosis = diagnose(
            nominal, recordings, progress=shown, payloads=payloads, refine=not arguments.no_refine
        )
    extended = extended_model(nominal, diagnosis)
    page = None
    if asked.report is not None:
        page = cli_outputs.page(diagnosis, nominal, extended, recordings[0])
    asked.write(to_json(diagnosis, asked.model_name()), page, extended)
    if not arguments.quiet:
        console = Console()
        summary(diagnosis, nominal, console)
        for path in asked.paths():
            console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)


def _compare(arguments: argparse.Namespace) -> None:
    from rich.console import Console

    from flexjoint import cli_outputs, recording
    from flexjoint.checks import check
    from flexjoint.compare import compare
    from flexjoint.model import FlexibleJointModel

    cli_outputs.Asked(json=arguments.json).check()
    loaded = cli_robot.load_chosen(arguments)
    table = recording.read(arguments.recording)
    check(loaded, table)
    how = arguments.horizon, arguments.closed_loop, arguments.engine
    result = compare(table, FlexibleJointModel(loaded), *how)
    if arguments.json is not None:
        cli_outputs.write_json(arguments.json, result.to_json())
    cli_outputs.print_comparison(result, loaded, table, Console())


def _simulate(arguments: argparse.Namespace) -> None:
    from flexjoint import cli_outputs, recording
    from flexjoint.checks import check_joints
    from flexjoint.integrate import DEFAULT
    from flexjoint.model import FlexibleJointModel
    from flexjoint.simulate import simulate

    cli_outputs.check_place(arguments.out, (".csv", ".parquet"), [arguments.reference])
    loaded = cli_robot.load_chosen(arguments)
    reference = recording.read(arguments.reference)
    check_joints(loaded, reference)
    scheme = arguments.scheme or DEFAULT
    with _plain_warnings():
        result = simulate(
            FlexibleJointModel(loaded),
            reference,
            scheme=scheme,
            width=arguments.width,
            engine=arguments.engine,
        ).measured
    recording.write(result, arguments.out)
    print(f"wrote {arguments.out}: {result.duration:.4g} s of {', '.join(result.joints)}")


def _theta_d(arguments: argparse.Namespace) -> None:
    from flexjoint import cli_theta_d

    cli_theta_d.run(arguments)


def _plan(arguments: argparse.Namespace) -> None:
    from flexjoint import cli_plan

    cli_plan.run(arguments)


def _demo(arguments: argparse.Namespace) -> None:
    from rich.console import Console

    from flexjoint import demo
    from flexjoint.terminal import Progress

    demo.outputs(arguments.out)  # complains before the work, not after it
    with Progress() as bar:
        shown = demo.run(bar)
    files = demo.write(shown, arguments.out)
    demo.show(shown, files, Console())


def _robots(arguments: argparse.Namespace) -> None:
    cli_robot.show_robots()


def _effects(arguments: argparse.Namespace) -> None:
    from flexjoint import cli_effects

    if arguments.markdown:
        print(cli_effects.markdown(), end="")
    else:
        cli_effects.show()
