"""`flexjoint paper ...`: the experiments of Kameduła et al. 2016, as tables."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from flexjoint.cli import options

if TYPE_CHECKING:
    from rich.console import Console

    from flexjoint.cli.paper.one_link import Difference, Table

NOTE = """\
(*) given as NRMSE in the signal's unit; which norm it is, the paper does not say.
Read from the left, the step reaches a held controller a tick after the continuous one, which is most of the
difference. Read from the right it does not, and tau_m is off by the whole torque at that one sample."""

LAW = """\
l: the contact forces lambda. any: the largest of all joints but the wheels. law: the largest difference from
the static law (theta_d - q_d) - (tau_t - tau_ff)/Kp - tau_t/K."""
LEFT = ("run", "signal", "spring", "tau_ff; theta_d", "pose")  # columns of words


def add(commands: Any) -> None:
    """Register the command and its experiments; one more experiment is one more parser here."""
    paper = commands.add_parser("paper", help="reproduce the experiments of Kameduła et al. 2016")
    experiments = paper.add_subparsers(required=True, metavar="EXPERIMENT")
    one_link = experiments.add_parser("one-link", help="section 5.1: one link on three springs")
    one_link.add_argument(
        "--steps-only", action="store_true", help="leave out the ramp, step and chirp, which take longest"
    )
    one_link.set_defaults(run=_one_link)
    whole_body = experiments.add_parser(
        "whole-body", help="section 5.2: CENTAURO from its initial to a spider and a mammal pose"
    )
    whole_body.add_argument(
        "--figures", metavar="FOLDER", help="write figures like Fig. 8 and 9 of each variant"
    )
    options.add_engine(whole_body)
    whole_body.set_defaults(run=_whole_body)


def _one_link(arguments: argparse.Namespace) -> None:
    from rich.console import Console

    from flexjoint.cli.paper import one_link as paper

    console = Console()
    _facts(console)
    for transmission in paper.TRANSMISSIONS:
        with console.status(f"{transmission}: steps"):
            tables = paper.step_tables(transmission)
        for table in tables:
            _print(table, console)
    if not arguments.steps_only:
        with console.status("ramp, step and chirp"):
            varying = paper.varying_table()
        _print(varying, console, beside_paper=True)


def _whole_body(arguments: argparse.Namespace) -> None:
    from pathlib import Path

    from rich.console import Console

    from flexjoint.cli.paper import whole_body

    console = Console()
    engine = whole_body.quickest() if arguments.engine == "auto" else arguments.engine
    names = whole_body.robot_model().robot.joint_names
    shown = {label: names.index(joint) for label, joint in whole_body.SHOWN.items()}
    rows, files = [], []
    for gravity, title in whole_body.GRAVITY.items():
        for motor, reference in whole_body.MOTOR.items():
            with console.status(f"gravity_ff {title}, theta_d {reference}"):
                found = whole_body.run(gravity, motor, engine)
                if arguments.figures is not None:
                    files += whole_body.draw(found, Path(arguments.figures))
            for k, hold in enumerate(found.holds):
                errors = [f"{1e3 * hold.error[i]:+.1f}" for i in shown.values()]
                worst = whole_body.largest(hold.error), whole_body.largest(hold.error - hold.law)
                name = "" if k else f"{title}; {reference}"
                rows.append([name, hold.pose, *errors, f"{1e3 * worst[0]:.1f}", f"{1e3 * worst[1]:.3f}"])
    head = ["tau_ff; theta_d", "pose", *shown, "any", "law"]
    _grid("q - q_d at rest, in mrad", head, rows, console)
    console.print(LAW, soft_wrap=True)
    for file in files:
        console.print(str(file), soft_wrap=True)


def _facts(console: Console) -> None:
    from flexjoint.cli.paper import one_link as paper

    rows = []
    for transmission in paper.TRANSMISSIONS:
        with console.status(f"{transmission}: exact step response"):
            found = paper.step_facts(paper.exact(transmission))
        rows.append(
            [
                transmission,
                f"{found.peak:.3f}",
                f"{found.deflection:.4f}",
                f"{found.torque:.2f}",
                f"{found.saturated:.3f}",
                f"{found.settling:.2f}",
            ]
        )
    head = ["spring", "peak q [rad]", "|theta-q| [rad]", "|tau_t| [N m]", "saturated [s]", "2 % settling [s]"]
    _grid("1 rad step, exact, continuous control", head, rows, console)


def _print(table: Table, console: Console, beside_paper: bool = False) -> None:
    from flexjoint.cli.paper import one_link as paper

    rows = []
    for name, found in table.rows.items():
        for k, (signal, unit) in enumerate(paper.SIGNALS.items()):
            rows.append(["" if k else name, f"{signal} [{unit}]", *_cells(found[signal])])
    if beside_paper:
        for k, (signal, unit) in enumerate(paper.SIGNALS.items()):
            numbers = f"{paper.PAPER_MAX[signal]:.2g}", "", f"{paper.PAPER_NRMSE[signal]:.2g} (*)", ""
            rows.append(["" if k else "the paper, Gazebo against Matlab", f"{signal} [{unit}]", *numbers])
    _grid(table.title, ["run", "signal", "max", "RMS", "RMS / range", "MSE"], rows, console)
    if beside_paper:
        console.print(NOTE, soft_wrap=True)


def _cells(found: Difference) -> list[str]:
    return [f"{number:.2g}" for number in (found.max, found.rms, found.nrmse, found.mse)]


def _grid(title: str, head: list[str], rows: list[list[str]], console: Console) -> None:
    from rich.markup import escape
    from rich.table import Table as Grid

    grid = Grid(title=title, title_justify="left")
    for label in head:
        grid.add_column(escape(label), justify="left" if label in LEFT else "right")
    for row in rows:
        grid.add_row(*(escape(cell) for cell in row))
    console.print(grid)
