"""A robot's charts: battery, power, energy as predicted and as measured, position error."""

from collections.abc import Sequence

import numpy as np
import viser
from viser import uplot

from robrain.coordinator.dashboard.palette import ROBOT_COLORS, css
from robrain.coordinator.dashboard.robot_history import RobotHistory

GREY = "rgba(130, 140, 155, 0.9)"
FAINT = "rgba(130, 140, 155, 0.18)"
HEIGHT_PX = 110
RANGES = {"Battery (%)": (0.0, 100.0)}
BLUE, ORANGE = css(ROBOT_COLORS[1]), css(ROBOT_COLORS[0])


class RobotCharts:
    """Four charts over the last ten minutes. The second line of each is dashed, to be told apart without colours."""

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
        for chart, (_, lines) in zip(self._charts, self.LAYOUT, strict=True):
            chart.data = (columns["time_s"], *(columns[name] for name, _ in lines))


def add_chart(
    gui: viser.GuiApi, title: str, labels: Sequence[str], y_range: tuple[float, float] | None = None
) -> viser.GuiUplotHandle:
    """An empty chart over seconds, with a line for each label."""
    grid = uplot.Axis_Grid(stroke=FAINT, width=1)
    bare = uplot.Series_Points(show=False)
    ticks = uplot.Axis_Ticks(show=False)
    looks = [uplot.Series(label=labels[0], stroke=BLUE, width=2, spanGaps=False, points=bare)]
    looks += [
        uplot.Series(label=label, stroke=ORANGE, width=2, dash=(6.0, 4.0), spanGaps=False, points=bare)
        for label in labels[1:]
    ]
    scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(range=y_range) if y_range is not None else uplot.Scale()}
    return gui.add_uplot(
        data=(np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in labels)),
        series=(uplot.Series(label="s"), *looks),
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
