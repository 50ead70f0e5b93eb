"""Style of figures: light, legible in print, distinguishable by colour-blind eyes; and groups of runs with means."""

import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robrain.lab.report.mean_interval import bootstrap_interval, mean_interval
from robrain.protocol.safe_text import safe_text
from robrain.recording.drawing.palette import ROBOT_COLORS, css

YELLOW = 5
PRINT_COLORS = tuple("#1b1b1b" if place == YELLOW else css(color) for place, color in enumerate(ROBOT_COLORS))
"""The dashboard's, with black for the yellow that is lost on white: the eight of Okabe and Ito."""
LINE_STYLES = ("-", "--", ":", "-.")
MARKERS = "o^sDv"
INK = "#1f2933"
FAINT = "#9aa5b1"
GOOD, WARN, BAD = "#009e73", "#e69f00", "#d55e00"
NEUTRAL = "#0072b2"
DPI = 110
LEGEND_MAX = 16
"""More lines than this have no legend: it would be illegible."""
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "text.parse_math": False,  # a dollar in a robot's name is a dollar
    "lines.linewidth": 1.6,
    "svg.hashsalt": "robrain",  # names in the file are equal each time
    "pdf.fonttype": 42,  # letters stay letters: a reader can search and edit them
}
FORMATS: Mapping[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
"""Formats of figures, each with the metadata that is left out, because it differs with time and version."""
POINTS_AT, POINTS_HEIGHT = -0.17, 0.15
"""Middle of the strip of points from the middle of its row, and half the strip's height, in rows."""
MEAN_AT = 0.16
CURVE_POINTS = 240
PANELS_PER_LINE = (3, 4, 2)
"""Numbers of panels side by side; the one that leaves the smallest gap is taken, of equal ones the first."""


@contextmanager
def figure_style() -> Iterator[None]:
    """The style, applied while the block draws and saves."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        # A name may hold characters that the font lacks; they are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def new_figure(width_in: float = 9.0, height_in: float = 4.2) -> Figure:
    """An empty figure, not of pyplot: there is no global reference to it."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")


def line_style(index: int) -> dict[str, Any]:
    """Colour and dashes of line number `index`, counted from 0."""
    round_number, place = divmod(index, len(PRINT_COLORS))
    return {"color": PRINT_COLORS[place], "linestyle": LINE_STYLES[round_number % len(LINE_STYLES)]}


def label(text: str) -> str:
    """A name from a recording as a figure may have it."""
    return safe_text(text, 40)


def time_axis(axes: Axes, duration_s: float) -> float:
    """Label the x axis with the unit of time that suits; returns how many seconds one of it has."""
    unit_s, name = (1.0, "s") if duration_s <= 300 else (60.0, "min") if duration_s <= 4 * 3600 else (3600.0, "h")
    axes.set_xlabel(f"Time ({name})")
    axes.set_xlim(0.0, max(duration_s / unit_s, 1e-3))
    return unit_s


def legend(axes: Axes, count: int) -> None:
    """A legend beside the axes, unless it would have too many lines."""
    if 1 < count <= LEGEND_MAX:
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def picture(figure: Figure, form: str = "svg") -> bytes:
    """The figure in one of `FORMATS`; the same figure gives the same bytes. Call it within `figure_style`."""
    out = io.BytesIO()
    figure.savefig(out, format=form, metadata=FORMATS[form])
    return out.getvalue()


Curve = Sequence[tuple[float, float]]
"""Times and values of a run."""


def panels(count: int, rows: int, label_length: int) -> tuple[Figure, list[Axes]]:
    """A figure with exactly `count` panels that share their rows; the first of a line has room for the labels."""
    columns = min(count, min(PANELS_PER_LINE, key=lambda columns: -count % columns)) if count > 3 else count
    lines = math.ceil(count / columns)
    width_in = 2.8 * columns + 0.075 * min(label_length, 40)
    figure = new_figure(max(width_in, 4.5), lines * min(1.1 + 0.36 * rows, 14.0))
    grid = figure.add_gridspec(lines, columns)
    found: list[Axes] = []
    for place in range(count):
        axes = figure.add_subplot(grid[divmod(place, columns)], sharey=found[0] if found else None)
        axes.tick_params(labelleft=place % columns == 0)
        found.append(axes)
    return figure, found


def draw_groups(axes: Axes, groups: Sequence[Sequence[float]], expected: Sequence[int] | None = None) -> None:
    """Draw a row for each group, the first on top.

    Args:
        axes: where.
        groups: values of each group; a group without values leaves its row empty.
        expected: number of values that each group could have; a row that has fewer shows its number.

    """
    for row, values in enumerate(groups):
        color = line_style(row)["color"]
        found = mean_interval(values)
        if found is not None:
            heights = row + POINTS_AT + _spread(len(values))
            axes.plot(values, heights, "o", color=color, alpha=0.5, markersize=3.5, markeredgewidth=0)
            if found.low is not None and found.high is not None:
                ends = [row + MEAN_AT] * 2
                axes.plot([found.low, found.high], ends, color=color, linewidth=2.4, solid_capstyle="butt")
            axes.plot(found.mean, row + MEAN_AT, "D", color=color, markeredgecolor="white", markersize=7)
        if expected is not None and len(values) < expected[row]:
            axes.annotate(f"{len(values)} of {expected[row]}", (1.0, row + MEAN_AT), xycoords=("axes fraction", "data"),
                          ha="right", va="center", fontsize=7, color=INK)  # fmt: skip
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.08)


def bar(axes: Axes, row: int, value: float, color: str, words: str) -> None:
    """Draw a bar from zero in a row, with words at its end."""
    axes.barh(row, value, color=color, height=0.65)
    axes.annotate(words, (value, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)


def label_rows(axes: Axes, labels: Sequence[str], title: str = "") -> None:
    """Name the rows of a figure, and their quantity."""
    axes.set_yticks(range(len(labels)), labels)
    if title:
        axes.set_ylabel(title)


def draw_mean_curves(axes: Axes, groups: Sequence[Sequence[Curve]], labels: Sequence[str], unit_s: float) -> None:
    """Draw the mean of each group's curves and its 95 % interval; a run keeps its last value after its end."""
    for index, (curves, label) in enumerate(zip(groups, labels, strict=True)):
        drawn = [curve for curve in curves if curve]
        if not drawn:
            continue
        if len(drawn) == 1:
            times, mean = np.array(drawn[0], np.float64).T
            ends = None
        else:
            times, mean, ends = mean_curve(drawn)
        style = line_style(index)
        axes.plot(times / unit_s, mean, label=label, **style)
        if ends is not None:
            axes.fill_between(times / unit_s, *ends, color=style["color"], alpha=0.15, linewidth=0)


def mean_curve(
    curves: Sequence[Curve],
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Times, means and both ends of the 95 % interval of several curves."""
    longest_s = max(curve[-1][0] for curve in curves)
    times = np.linspace(0.0, longest_s, CURVE_POINTS)
    values = np.array([np.interp(times, *np.array(curve, np.float64).T) for curve in curves])
    return times, values.mean(axis=0), bootstrap_interval(values)


def _spread(count: int) -> NDArray[np.float64]:
    """Heights that keep equal values apart: the golden ratio's multiples fill the strip evenly."""
    shares = np.modf(np.arange(count) * 0.6180339887498949 + 0.5)[0]
    return POINTS_HEIGHT * (2 * shares - 1) if count > 1 else np.zeros(count)
