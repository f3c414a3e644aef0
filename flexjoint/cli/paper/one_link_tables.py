"""The tables of section 5.1: step responses, differences from exact solutions, and what durations do."""

from __future__ import annotations

from collections.abc import Sequence

from flexjoint.cli.paper import one_link
from flexjoint.cli.paper.grid import Grid
from flexjoint.cli.paper.motions import motion, prepare
from flexjoint.cli.paper.one_link import Difference, Table
from flexjoint.core.running.progress import Report, silent

NOTE = (
    "(*) given as NRMSE in the signal's unit; which norm it is, the paper does not say. Read from the left,"
    " the step reaches a held controller a tick after the continuous one, which is most of the difference."
    " Read from the right it does not, and tau_m is off by the whole torque at that one sample."
)
DURATIONS = (
    "The paper states no durations. The largest differences stand at the step: a longer ramp ends at another"
    " angle, with another load, and moves them by some per cent. The mean ones are of the whole time, of"
    " which the step is a second: they fall with its root. No duration brings them to the paper's NRMSE."
)
HEAD = ("run", "signal", "max", "RMS", "RMS / range", "MSE")
TOTALS = (15.0, 20.0, 25.0, one_link.VARYING_SECONDS)  # [s]


def grids(steps_only: bool = False, report: Report = silent) -> list[Grid]:
    """All tables, in order of the paper's section."""
    prepare(one_link.calls(steps_only), one_link.cost, report)
    found = [grid for name in one_link.TRANSMISSIONS for grid in _steps(name)]
    if not steps_only:
        found += [*_varying(), *_durations()]
    report(1.0, "")
    return [_facts(), *found]


def _facts() -> Grid:
    rows = []
    for transmission in one_link.TRANSMISSIONS:
        exact = motion(one_link.exact, transmission, one_link.STEP, one_link.STEP_SECONDS)
        found = one_link.step_facts(exact)
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
    return Grid("1 rad step, exact, continuous control", head, rows)


def _steps(transmission: str) -> list[Grid]:
    return [_grid(table) for table in one_link.step_tables(transmission, one_link.STEP_SECONDS)]


def _varying() -> list[Grid]:
    table = _grid(one_link.varying_table(seconds=one_link.VARYING_SECONDS))
    paper = [
        [
            "the paper, Gazebo against Matlab",
            f"{signal} [{unit}]",
            f"{one_link.PAPER_MAX[signal]:.2g}",
            "",
            f"{one_link.PAPER_NRMSE[signal]:.2g} (*)",
            "",
        ]
        for signal, unit in one_link.SIGNALS.items()
    ]
    return [Grid(table.title, table.head, [*table.rows, *paper], table.words, NOTE)]


def _durations() -> list[Grid]:
    ramps, totals = _grid(one_link.ramp_table()), _grid(one_link.total_table(TOTALS))
    return [ramps, Grid(totals.title, totals.head, totals.rows, totals.words, DURATIONS)]


def _grid(table: Table) -> Grid:
    rows: list[Sequence[str]] = [
        [name, f"{signal} [{unit}]", *_cells(found[signal])]
        for name, found in table.rows.items()
        for signal, unit in one_link.SIGNALS.items()
    ]
    return Grid(table.title, HEAD, rows, ("signal",))


def _cells(found: Difference) -> list[str]:
    return [f"{number:.2g}" for number in (found.max, found.rms, found.nrmse, found.mse)]
