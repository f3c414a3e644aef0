"""Fig. 6 of the paper: three springs under a step, and one of them along a ramp, a step and a chirp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexjoint.cli.paper import one_link
from flexjoint.cli.paper.grid import Grid
from flexjoint.cli.paper.motions import motion
from flexjoint.cli.paper.one_link import Motion
from flexjoint.cli.paper.page import Page, Section
from flexjoint.core.running.progress import Report, silent
from flexjoint.report import plots
from flexjoint.report.plots import Image

OURS = "default scheme, 1 kHz"  # of the tables' runs
SHOWN = 2.4  # s of the step responses' 5
SIGNALS = {"tau_m": "motor torque", "tau_t": "transmission torque"}
LEAD = (
    "One link on a series elastic actuator: section 5.1. The paper compares its Gazebo plugin with Matlab;"
    " here the plugin's scheme and flexjoint's default, both with a controller that acts and is held at"
    " 1 kHz, are compared with an exact solution under continuous control, which stands for Matlab.",
)
LEGEND = (
    ("measured", "exact, continuous control"),
    ("before", "the paper's scheme, 1 kHz"),
    ("after", "default scheme, 1 kHz"),
)


def page(tables: Sequence[Grid], steps_only: bool = False, report: Report = silent) -> Page:
    """The page of what `one_link_tables.grids` gave."""
    report(0.0, "drawing")
    steps = [grid for grid in tables if "rad step" in grid.title]
    others = [grid for grid in tables if grid not in steps]
    sections = [
        Section(
            "Fig. 6, left: transmission displacement in the step test",
            (
                "A step of 1 rad on springs of 100, 188 and 500 N m/rad, the first"
                f" {SHOWN:g} s. On the left theta - q, on the right its error.",
            ),
            LEGEND,
            [_step(name) for name in one_link.TRANSMISSIONS],
            steps[:1],
        )
    ]
    if not steps_only:
        report(0.5, "drawing")
        sections.append(
            Section(
                "Fig. 6, right: ramp, step and chirp",
                (
                    f"K = 188 N m/rad; a ramp of {one_link.SPEED:g} rad/s for {one_link.RAMP:g} s, a step"
                    f" of -1 rad held for {one_link.HOLD:g} s, and the chirp"
                    f" 0.5 sin(0.02 pi t + 0.004 pi t^2) for {one_link.CHIRP:g} s. The durations are ours."
                    " On the left the signals, on the right the errors.",
                ),
                LEGEND,
                _varying("K188"),
            )
        )
        sections.append(Section("Beside the paper's numbers", grids=others[:1]))
        sections.append(Section("What the durations do", grids=others[1:]))
    sections.append(Section("Step responses, all schemes", grids=steps[1:]))
    report(1.0, "")
    return Page("One link on three springs", LEAD, sections)


def _step(transmission: str) -> tuple[Image, Image]:
    seconds = one_link.STEP_SECONDS
    exact = motion(one_link.exact, transmission, one_link.STEP, seconds)
    paper, default = _runs(transmission, one_link.STEP, seconds)
    signals = [run.theta - run.q for run in (exact, paper, default)]
    K, D = one_link.TRANSMISSIONS[transmission]
    of = f"K = {K:g} N m/rad, D = {D:g} N m s/rad"
    return _pair("theta - q [rad]", of, exact.time, signals, SHOWN)


def _varying(transmission: str) -> list[tuple[Image, Image]]:
    seconds = one_link.VARYING_SECONDS
    exact = motion(one_link.exact, transmission, one_link.VARYING, seconds)
    runs = _runs(transmission, one_link.VARYING, seconds)
    time = exact.time
    wanted = plots.curves(
        "q [rad]",
        "reference (grey) and exact link position (blue)",
        wide=(time, one_link.VARYING(time)),
        full=(time, exact.q),
    )
    _, error = _pair("q [rad]", "link position", time, [exact.q, *(run.q for run in runs)])
    pairs = [(wanted, error)]
    for name, words in SIGNALS.items():
        signals = [getattr(run, name) for run in (exact, *runs)]
        pairs.append(_pair(f"{name} [N m]", words, time, signals))
    return pairs


def _runs(transmission: str, reference: one_link.Profile, seconds: float) -> tuple[Motion, Motion]:
    """By the paper's scheme and the default one, as the tables have computed them."""
    scheme, rate = one_link.RUNS[one_link.GAZEBO]
    return (
        motion(one_link.held, transmission, reference, seconds, scheme, rate),
        motion(one_link.held, transmission, reference, seconds, *one_link.RUNS[OURS]),
    )


def _pair(
    label: str, words: str, time: np.ndarray, signals: Sequence[np.ndarray], until: float | None = None
) -> tuple[Image, Image]:
    """A signal and its errors: exact, the paper's scheme, the default one."""
    exact, paper, default = signals
    name, _, unit = label.rpartition(" [")
    signal = plots.curves(
        label, words, wide=(time, exact), dashed=(time, paper), full=(time, default), until=until
    )
    error = plots.curves(
        f"error of {name} [{unit}",
        f"error: {words}",
        dashed=(time, paper - exact),
        full=(time, default - exact),
        until=until,
    )
    return signal, error
