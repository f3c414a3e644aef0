"""`flexjoint paper ...`: the experiments of Kashiri et al. 2017, as tables."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from flexjoint.paper import Difference, Table

NOTE = """\
(*) given as NRMSE in the signal's unit; which norm it is, the paper does not say.
Read from the left, the step reaches a held controller a tick after the continuous one, which is most of the
difference. Read from the right it does not, and tau_m is off by the whole torque at that one sample."""


def add(commands: Any) -> None:
    """Register the command and its experiments; one more experiment is one more parser here."""
    paper = commands.add_parser("paper", help="reproduce the experiments of Kashiri et al. 2017")
    experiments = paper.add_subparsers(required=True, metavar="EXPERIMENT")
    one_link = experiments.add_parser("one-link", help="section 5.1: one link on three springs")
    one_link.add_argument(
        "--steps-only", action="store_true", help="leave out the ramp, step and chirp, which take longest"
    )
    one_link.set_defaults(run=_one_link)


def _one_link(arguments: argparse.Namespace) -> None:
    from rich.console import Console

    from flexjoint import paper

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


def _facts(console: Console) -> None:
    from flexjoint import paper

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
    from flexjoint import paper

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
        grid.add_column(escape(label), justify="left" if label in ("run", "signal", "spring") else "right")
    for row in rows:
        grid.add_row(*(escape(cell) for cell in row))
    console.print(grid)
