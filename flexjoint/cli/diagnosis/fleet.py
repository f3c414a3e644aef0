"""`flexjoint fleet`: many robots over time, one table and one page of who needs somebody."""

from __future__ import annotations

import argparse

from rich.console import Console

from flexjoint.core.messages import escaped
from flexjoint.core.running.progress import silent
from flexjoint.report.fleet.watch import FOUND, PAGE, TABLE, watch
from flexjoint.report.material import require
from flexjoint.report.progress import Progress
from flexjoint.report.terminal import show


def run(arguments: argparse.Namespace) -> None:
    """The command. Raises FlexJointError where there is nothing to watch, before the long work."""
    for package in ("matplotlib", "jinja2"):
        require(package)
    with Progress() as bar:
        fleet = watch(
            arguments.source,
            arguments.out,
            robot=arguments.robot,
            workers=arguments.workers,
            scheduler=arguments.scheduler,
            progress=silent if arguments.quiet else bar,
        )
    if not arguments.quiet:
        console = Console()
        show(fleet.summary(), console)
        for name in (TABLE, PAGE, FOUND):
            text = f"wrote {escaped(str(arguments.out / name))}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
