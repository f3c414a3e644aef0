"""Figures as SVG images inside the page. Names of users never enter a figure: they stand in the caption."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flexjoint.diagnosis.result import LearnedLaw, Repeated
from flexjoint.diagnosis.result.wording import unit_of
from flexjoint.report import series

# Blue and orange stay apart for every common colour vision; dashes tell them apart in grey print.
INK, RULE = "#1f2933", "#cbd2d9"
MEASURED, BEFORE, AFTER = "#9aa5b1", "#c2570c", "#0b5cad"
SIZE = (4.6, 2.35)  # inches; two of them side by side on a desk, one below the other on a phone
MARGINS = {"left": 0.175, "right": 0.945, "top": 0.93, "bottom": 0.205}
STYLE = {
    "svg.hashsalt": "flexjoint",
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.edgecolor": RULE,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.limits": (-3, 5),
    "axes.formatter.use_mathtext": True,
    "grid.color": "#edf0f2",
    "grid.linewidth": 0.8,
    "xtick.color": RULE,
    "ytick.color": RULE,
    "xtick.labelcolor": "#52606d",
    "ytick.labelcolor": "#52606d",
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
}
BUCKETS = 450
POINTS = 1200
DASHES = (4, 2)
SECTION_LINES = (":", "-", "--")  # of a law of two signals: low, middle and high in the other
MOST_TICKS = 12


@dataclass(frozen=True)
class Plotted:
    """What a picture's axes show, for the page's script, which draws them anew when a reader zooms."""

    x: str  # labels
    y: str
    numbers: str  # limits of x and y; left, right, top and bottom of the axes as shares of the picture


@dataclass(frozen=True)
class Image:
    """An SVG as a data URI with its natural size [pt] and the text for those who cannot see it."""

    uri: str
    width: float
    height: float
    alt: str
    axes: Plotted | None = None  # none of a formula


@contextmanager
def _styled() -> Iterator[None]:
    with matplotlib.style.context(["default", STYLE]):
        yield


def traces(
    time: np.ndarray,
    measured: np.ndarray,
    before: np.ndarray,
    after: np.ndarray | None,
    channel: str,
    name: str,
    prismatic: bool,
    alt: str,
) -> Image:
    """A measured signal with the simulations on it, each (N,) at `time` [s]."""
    with _styled():
        figure, axes = _axes("time [s]", _label(channel, name, prismatic))
        axes.plot(*series.thinned(time, measured, BUCKETS), color=MEASURED, linewidth=2.8)
        axes.plot(*series.thinned(time, before, BUCKETS), color=BEFORE, dashes=DASHES)
        if after is not None:
            axes.plot(*series.thinned(time, after, BUCKETS), color=AFTER)
        _tight(axes, time)
        return _image(figure, alt)


def errors(
    time: np.ndarray,
    before: np.ndarray,
    after: np.ndarray | None,
    channel: str,
    marked: tuple[float, float],
    changes: Sequence[float],
    prismatic: bool,
    alt: str,
) -> Image:
    """Simulated minus measured over the whole recording, each (N,); the excerpt is shaded."""
    with _styled():
        unit = unit_of(channel, prismatic)
        figure, axes = _axes("time [s]", f"error of {channel}" + (f" [{unit}]" if unit else ""))
        axes.axvspan(*marked, color="#e4e7eb", linewidth=0)
        axes.axhline(0.0, color=RULE, linewidth=0.8)
        axes.plot(*series.thinned(time, before, BUCKETS), color=BEFORE, linewidth=0.8)
        if after is not None:
            axes.plot(*series.thinned(time, after, BUCKETS), color=AFTER, linewidth=0.8)
        for time_of_change in changes:
            axes.axvline(time_of_change, color=INK, linewidth=1.0, linestyle=":")
        _tight(axes, time)
        return _image(figure, alt)


Curve = tuple[np.ndarray, np.ndarray]  # time (N,) [s] and values (N,)


def curves(
    label: str,
    alt: str,
    wide: Curve | None = None,
    dashed: Curve | None = None,
    full: Curve | None = None,
    until: float | None = None,
) -> Image:
    """Up to three signals over time, wide grey, dashed orange and full blue, up to a time [s]."""
    styles = (
        (wide, {"color": MEASURED, "linewidth": 2.8}),
        (dashed, {"color": BEFORE, "dashes": DASHES}),
        (full, {"color": AFTER}),
    )
    with _styled():
        figure, axes = _axes("time [s]", label)
        for curve, style in styles:
            if curve is not None:
                time, values = curve
                shown = slice(None) if until is None else time <= until
                axes.plot(*series.thinned(time[shown], values[shown], BUCKETS), **style)
                _tight(axes, time[shown])
        return _image(figure, alt)


def dependence(
    x: np.ndarray,
    before: np.ndarray,
    after: np.ndarray | None,
    signal: str,
    name: str,
    noise: float,
    prismatic: bool,
    alt: str,
) -> Image:
    """A balance's residual over a signal, each (N,): samples, binned median, middle half."""
    with _styled():
        figure, axes = _axes(_label(signal, name, prismatic), f"residual [{unit_of('tau_t', prismatic)}]")
        axes.axhline(0.0, color=RULE, linewidth=0.8)
        for level in (-2 * noise, 2 * noise):
            axes.axhline(level, color="#52606d", linewidth=0.7, linestyle=(0, (1, 3)))
        step = max(1, x.size // POINTS)
        shown: list[tuple[np.ndarray, str, tuple[float, ...]]] = [(before, BEFORE, DASHES)]
        if after is not None:
            shown.append((after, AFTER, (1, 0)))
        for values, colour, dashes in shown:
            axes.plot(
                x[::step],
                values[::step],
                ".",
                color=colour,
                markersize=2.2,
                alpha=0.25,
                markeredgewidth=0,
                rasterized=True,
            )
            for bins in series.levels(x, values):
                _medians(axes, bins, colour, dashes)
        _robust_limits(axes, [values for values, _, _ in shown], noise)
        return _image(figure, alt)


def by_recording(number: Repeated, alt: str) -> Image:
    """A number by recording with two standard errors, odd ones marked, and the value of all as a band."""
    with _styled():
        figure, axes = _axes("recording", f"[{number.unit}]" if number.unit not in ("", "1") else "")
        values, stds = np.array(number.values), np.array(number.stds)
        known = np.isfinite(stds)
        place = np.arange(1, values.size + 1)
        low, high = (number.mean + side * 2.0 * number.std for side in (-1.0, 1.0))
        axes.axhspan(low, high, color="#e4e7eb", linewidth=0)
        axes.axhline(number.mean, color=AFTER, linewidth=1.0)
        odd = np.isin(place - 1, number.odd)
        for chosen, colour in ((known & ~odd, INK), (known & odd, BEFORE)):
            error = 2.0 * stds[chosen]
            axes.errorbar(
                place[chosen], values[chosen], error, fmt="o", color=colour, markersize=4, capsize=2
            )
        axes.set_xlim(0.5, values.size + 0.5)
        axes.set_xticks(place[:: -(-values.size // MOST_TICKS)])
        return _image(figure, alt)


def law(learned: LearnedLaw, name: str, alt: str) -> Image:
    """A learned law over its signal, with two standard errors as a band; one of two signals at several places
    of the other."""
    with _styled():
        figure, axes = _axes(f"{name} [{learned.signal_unit}]", f"[{learned.unit}]")
        x, value, std = (np.array(v) for v in (learned.at, learned.value, learned.std))
        axes.axhline(0.0, color=RULE, linewidth=0.8)
        if not learned.sections:
            axes.fill_between(x, value - 2.0 * std, value + 2.0 * std, color="#e4e7eb", linewidth=0)
            axes.plot(x, value, color=AFTER, linewidth=1.6)
        for one, dashes in zip(learned.sections, SECTION_LINES, strict=False):
            value, std = np.array(one.value), np.array(one.std)
            axes.fill_between(x, value - 2.0 * std, value + 2.0 * std, color="#e4e7eb", linewidth=0)
            label = f"{learned.other} = {one.at:.3g} {learned.other_unit}"
            axes.plot(x, value, color=AFTER, linewidth=1.4, linestyle=dashes, label=label)
        if learned.sections:
            axes.legend(frameon=False)
        axes.set_xlim(float(x[0]), float(x[-1]))
        return _image(figure, alt)


def over_time(
    days: np.ndarray,
    values: np.ndarray,
    stds: np.ndarray,
    changes: Sequence[float],
    events: Sequence[float],
    unit: str,
    alt: str,
) -> Image:
    """A number (N,) over days with two standard errors; changes are dashed, events dotted."""
    with _styled():
        figure, axes = _axes("days", f"[{unit}]" if unit not in ("", "1") else "")
        errors = np.where(np.isfinite(stds), 2.0 * stds, 0.0)
        axes.errorbar(days, values, errors, fmt="o", color=INK, markersize=3.5, capsize=2, linewidth=0.9)
        for day in changes:
            axes.axvline(day, color=BEFORE, linewidth=1.0, dashes=DASHES)
        for day in events:
            axes.axvline(day, color=AFTER, linewidth=1.0, linestyle=":")
        return _image(figure, alt)


def _medians(axes: Axes, bins: series.Binned, colour: str, dashes: tuple[float, ...]) -> None:
    """Lines through the medians; points where x has a few values only, or a bin has no neighbour."""
    bare = ~np.isfinite(bins.median)
    alone = np.concatenate([[True], bare[:-1]]) & np.concatenate([bare[1:], [True]]) & ~bare
    alone |= bins.discrete & ~bare
    spread = (bins.median[alone] - bins.low[alone], bins.high[alone] - bins.median[alone])
    axes.errorbar(bins.x[alone], bins.median[alone], spread, fmt="o", markersize=4, color=colour)
    if not bins.discrete:
        axes.fill_between(bins.x, bins.low, bins.high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(bins.x, bins.median, color=colour, linewidth=1.6, dashes=dashes)


def formula(latex: str) -> Image | None:
    """LaTeX as an image; None where mathtext does not know it."""
    with _styled():
        figure = Figure(figsize=(0.1, 0.1))
        figure.text(0, 0, f"${latex}$", fontsize=11, color=INK)
        try:
            return _image(figure, latex, tight=True)
        except (ValueError, RuntimeError):  # what mathtext raises on input that it cannot parse
            return None


def _label(signal: str, name: str, prismatic: bool) -> str:
    """A signal's name in words with its unit."""
    unit = unit_of(signal, prismatic)
    return name + (f" [{unit}]" if unit else "")


def _axes(xlabel: str, ylabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=SIZE)
    figure.subplots_adjust(**MARGINS)  # the same in all, so that plots stand in line
    axes = figure.add_subplot()
    # a signal's name may hold a $, which is not meant as mathematics
    axes.xaxis.label.set_parse_math(False)
    axes.yaxis.label.set_parse_math(False)
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.yaxis.set_label_coords(-0.165, 0.5)
    axes.locator_params(nbins=6)
    return figure, axes


def _tight(axes: Axes, time: np.ndarray) -> None:
    if time.size and time[-1] > time[0]:
        axes.set_xlim(float(time[0]), float(time[-1]))


def _robust_limits(axes: Axes, values: list[np.ndarray], noise: float) -> None:
    """Limits that a few outliers do not blow up."""
    together = np.concatenate(values)
    together = together[np.isfinite(together)]
    if together.size:
        low, high = np.percentile(together, [0.5, 99.5])
        low, high = min(float(low), -2.5 * noise), max(float(high), 2.5 * noise)
        margin = 0.06 * (high - low) or 1.0
        axes.set_ylim(low - margin, high + margin)


def _image(figure: Figure, alt: str, tight: bool = False) -> Image:
    stream = io.StringIO()
    bare = dict.fromkeys(("Date", "Creator", "Format", "Type"))  # the same diagnosis, the same bytes
    box = {"bbox_inches": "tight", "pad_inches": 0.02} if tight else {}
    figure.savefig(stream, format="svg", dpi=144, metadata=bare, transparent=True, **box)
    svg = stream.getvalue()
    svg = svg[svg.index("<svg") :]  # the prolog names an external DTD
    head = svg[: svg.index(">")]
    width, height = (float(head.split(f'{side}="')[1].split("pt")[0]) for side in ("width", "height"))
    encoded = base64.b64encode(svg.encode("utf-8")).decode("ascii")
    return Image(f"data:image/svg+xml;base64,{encoded}", width, height, alt, _plotted(figure))


def _plotted(figure: Figure) -> Plotted | None:
    if not figure.axes:
        return None
    axes = figure.axes[0]
    sides = (MARGINS[side] for side in ("left", "right", "top", "bottom"))
    numbers = (*axes.get_xlim(), *axes.get_ylim(), *sides)
    return Plotted(axes.get_xlabel(), axes.get_ylabel(), " ".join(f"{number:.9g}" for number in numbers))
