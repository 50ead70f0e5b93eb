"""Draws groups of runs: the value of each run as a point, their mean and its 95 % interval."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robrain.lab.report.figure_style import FAINT, INK, line_style, new_figure
from robrain.lab.report.mean_interval import bootstrap_interval, mean_interval

POINTS_AT, POINTS_HEIGHT = -0.17, 0.15
"""Middle of the strip of points from the middle of its row, and half the strip's height, in rows."""
MEAN_AT = 0.16
CURVE_POINTS = 240
PANELS_PER_LINE = (3, 4, 2)
"""Numbers of panels side by side; the one that leaves the smallest gap is taken, of equal ones the first."""

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
        expected: number of values that each group could have; a row that has fewer says so.

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


def label_rows(axes: Axes, labels: Sequence[str], title: str = "") -> None:
    """Name the rows of a figure, and what they are."""
    axes.set_yticks(range(len(labels)), labels)
    if title:
        axes.set_ylabel(title)


def draw_mean_curves(axes: Axes, groups: Sequence[Sequence[Curve]], labels: Sequence[str], unit_s: float) -> None:
    """Draw the mean of each group's curves and its 95 % interval; a run keeps its last value after its end."""
    for index, (curves, label) in enumerate(zip(groups, labels, strict=True)):
        told = [curve for curve in curves if curve]
        if not told:
            continue
        times, mean, ends = mean_curve(told)
        look = line_style(index)
        axes.plot(times / unit_s, mean, label=label, **look)
        if ends is not None:
            axes.fill_between(times / unit_s, *ends, color=look["color"], alpha=0.15, linewidth=0)


def mean_curve(
    curves: Sequence[Curve],
) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[NDArray[np.float64], NDArray[np.float64]] | None]:
    """Times, means and both ends of the 95 % interval; no ends for a single curve."""
    longest_s = max(curve[-1][0] for curve in curves)
    times = np.linspace(0.0, longest_s, CURVE_POINTS)
    values = np.array([np.interp(times, *np.array(curve, np.float64).T) for curve in curves])
    mean = values.mean(axis=0)
    return times, mean, None if len(curves) < 2 else bootstrap_interval(values)


def zero_line(axes: Axes) -> None:
    """A line at no difference."""
    axes.axvline(0.0, color=FAINT, linewidth=1.2, zorder=0.9)


def _spread(count: int) -> NDArray[np.float64]:
    """Heights that keep equal values apart: the golden ratio's multiples fill the strip evenly."""
    shares = np.modf(np.arange(count) * 0.6180339887498949 + 0.5)[0]
    return POINTS_HEIGHT * (2 * shares - 1) if count > 1 else np.zeros(count)
