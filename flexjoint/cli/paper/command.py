"""`flexjoint paper ...`: the experiments of Kameduła et al. 2016, as tables and as a page with pictures."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexjoint.cli import options

if TYPE_CHECKING:
    from flexjoint.cli.paper.grid import Grid
    from flexjoint.cli.paper.page import Page
    from flexjoint.core.running.progress import Report

FOLDER = Path("flexjoint-paper")
COMPUTED = 0.9  # share of the time that the tables take; the rest is drawing


def add(commands: Any) -> None:
    """Register the command and its experiments; one more experiment is one more parser here."""
    paper = commands.add_parser("paper", help="reproduce the experiments of Kameduła et al. 2016")
    experiments = paper.add_subparsers(required=True, metavar="EXPERIMENT")
    one_link = experiments.add_parser("one-link", help="section 5.1: one link on three springs (Fig. 6)")
    one_link.add_argument(
        "--steps-only", action="store_true", help="leave out the ramp, step and chirp, which take longest"
    )
    _add_outputs(one_link)
    one_link.set_defaults(run=_one_link)
    whole_body = experiments.add_parser(
        "whole-body", help="section 5.2: CENTAURO from its initial to a spider and a mammal pose (Fig. 8, 9)"
    )
    options.add_engine(whole_body)
    _add_outputs(whole_body)
    whole_body.set_defaults(run=_whole_body)


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=Path, default=FOLDER, metavar="FOLDER", help=f"of the page, default {FOLDER}"
    )
    parser.add_argument("--tables", action="store_true", help="print the tables alone, draw no page")


def _one_link(arguments: argparse.Namespace) -> None:
    from flexjoint.cli.paper import one_link_tables

    def drawn(tables: list[Grid], report: Report) -> Page:
        from flexjoint.cli.paper import one_link_page

        return one_link_page.page(tables, arguments.steps_only, report)

    _experiment(
        arguments, "one-link.html", lambda report: one_link_tables.grids(arguments.steps_only, report), drawn
    )


def _whole_body(arguments: argparse.Namespace) -> None:
    from flexjoint.cli.paper import whole_body, whole_body_tables

    engine = whole_body.quickest() if arguments.engine == "auto" else arguments.engine

    def drawn(tables: list[Grid], report: Report) -> Page:
        from flexjoint.cli.paper import whole_body_page

        return whole_body_page.page(tables, engine, report)

    _experiment(arguments, "whole-body.html", lambda report: whole_body_tables.grids(engine, report), drawn)


def _experiment(
    arguments: argparse.Namespace,
    name: str,
    computed: Callable[[Report], list[Grid]],
    drawn: Callable[[list[Grid], Report], Page],
) -> None:
    """Compute the tables, draw the page, write it, and print the tables."""
    from rich.console import Console

    from flexjoint.cli.outputs import check_place
    from flexjoint.core.files import write_text
    from flexjoint.core.messages import escaped
    from flexjoint.core.running.progress import part
    from flexjoint.report.material import require
    from flexjoint.report.progress import Progress

    path = arguments.out / name
    if not arguments.tables:  # complains before the work, not after it
        for package in ("matplotlib", "jinja2"):
            require(package)
        check_place(path, (".html",))
    with Progress() as bar:
        share = 1.0 if arguments.tables else COMPUTED
        tables = computed(part(bar, 0.0, share))
        text = None if arguments.tables else drawn(tables, part(bar, share, 1.0 - share)).html()
    console = Console()
    for grid in tables:
        grid.show(console)
    if text is not None:
        write_text(path, text)
        print(f"wrote {escaped(str(path))}: {len(text.encode()) / 1e6:.1f} MB, opens offline")
