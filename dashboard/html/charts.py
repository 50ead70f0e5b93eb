"""A robot's charts: battery, power, energy as predicted and as measured, position error."""

import math
from collections.abc import Sequence

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from robrain.recording.drawing.palette import ROBOT_COLORS, css
from robrain.recording.drawing.robot_history import RobotHistory

GREY = "rgba(130, 140, 155, 0.9)"
FAINT = "rgba(130, 140, 155, 0.18)"
HEIGHT_PX = 110
RANGES = {"Battery (%)": (0.0, 100.0)}
BLUE, ORANGE = css(ROBOT_COLORS[1]), css(ROBOT_COLORS[0])


class RobotCharts:
    """Four charts over the last ten minutes. The second line of each is dashed: visible without colours."""

    LAYOUT: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
        ("Battery (%)", (("soc_percent", "charge"),)),
        ("Power (W)", (("power_w", "measured"), ("model_power_w", "predicted"))),
        ("Energy (J)", (("measured_j", "measured"), ("predicted_j", "predicted"))),
        ("Position error (m)", (("error_m", "true error"), ("sigma_m", "own 1 σ"))),
    )

    def __init__(self, gui: viser.GuiApi) -> None:
        self._charts = [
            add_chart(gui, title, [label for _, label in lines], RANGES.get(title)) for title, lines in self.LAYOUT
        ]

    def draw(self, history: RobotHistory) -> None:
        """Show a robot's history."""
        columns = history.columns()
        if len(columns["time_s"]) < 2:
            empty = np.array([0.0, 1.0])
            columns = {name: empty if name == "time_s" else np.full(2, np.nan) for name in columns}
        for chart, (title, lines) in zip(self._charts, self.LAYOUT, strict=True):
            values = [columns[name] for name, _ in lines]
            chart.data = (columns["time_s"], *values)
            if title not in RANGES:
                _set_range(chart, nice_range(np.concatenate(values)))


def nice_range(values: NDArray[np.float64]) -> tuple[float, float]:
    """A range that holds these values and 0, with ends that change seldom: 1, 2 or 5 times a power of ten.

    The browser finds none by itself where a value is not known.

    >>> nice_range(np.array([np.nan, 3.0, 14.4])), nice_range(np.array([np.nan])), nice_range(np.array([-30.0, 0.2]))
    ((0.0, 20.0), (0.0, 1.0), (-50.0, 0.2))
    """
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    upper = _nice(high) if high > 0 else 0.0
    lower = -_nice(-low) if low < 0 else 0.0
    return (lower, upper) if upper > lower else (0.0, 1.0)


def _nice(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(round(step * power, 12) for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-9))


def _set_range(chart: viser.GuiUplotHandle, y_range: tuple[float, float]) -> None:
    known = chart.scales["y"].get("range") if chart.scales is not None else None
    if known is None or tuple(known) != y_range:
        chart.scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(range=y_range)}


def add_chart(
    gui: viser.GuiApi, title: str, labels: Sequence[str], y_range: tuple[float, float] | None = None
) -> viser.GuiUplotHandle:
    """An empty chart over seconds, with a line for each label."""
    grid = uplot.Axis_Grid(stroke=FAINT, width=1)
    bare = uplot.Series_Points(show=False)
    ticks = uplot.Axis_Ticks(show=False)
    lines = [uplot.Series(label=labels[0], stroke=BLUE, width=2, spanGaps=False, points=bare)]
    lines += [
        uplot.Series(label=label, stroke=ORANGE, width=2, dash=(6.0, 4.0), spanGaps=False, points=bare)
        for label in labels[1:]
    ]
    scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(range=y_range) if y_range is not None else uplot.Scale()}
    return gui.add_uplot(
        data=(np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in labels)),
        series=(uplot.Series(label="s"), *lines),
        title=title,
        scales=scales,
        axes=(
            uplot.Axis(stroke=GREY, grid=grid, ticks=ticks, size=26),
            uplot.Axis(stroke=GREY, grid=grid, ticks=ticks, size=46),
        ),
        legend=uplot.Legend(show=len(labels) > 1, live=False),
        height=HEIGHT_PX + (24 if len(labels) > 1 else 0),
        padding=(6, 12, 0, 0),
    )
