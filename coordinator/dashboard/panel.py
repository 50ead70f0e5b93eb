"""The panel beside the picture: halt, the team's figures, tables, chart, layers and views."""

from typing import Any

import numpy as np
import viser
from viser import uplot

from robrain.coordinator.dashboard.halt_control import HaltControl
from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.palette import ROBOT_COLORS, css
from robrain.coordinator.dashboard.panel_html import STYLE, motes_html, robots_html, summary_html
from robrain.coordinator.dashboard.scene import Scene
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.protocol.wire.endpoint import Endpoint

WIDTH_PX = 430
PERIOD_S = 0.4
CHART_PERIOD_S = 2.0


class Panel:
    """Shows a TeamView's figures and holds the controls. What it shows is shared by all who look on."""

    def __init__(self, server: viser.ViserServer, endpoint: Endpoint, scene: Scene) -> None:
        gui = server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH_PX)
        gui.add_html(STYLE)
        self.halt = HaltControl(server, endpoint)
        self._summary = gui.add_html("")
        views = gui.add_button_group("Camera", ("Overview", "Top view"))
        views.on_click(lambda event: _move_camera(scene, event))
        with gui.add_folder("Robots"):
            self._robots = gui.add_html("")
        self._chart_folder = gui.add_folder("Explored over arena time", visible=False)
        with self._chart_folder:
            self._chart = _add_chart(gui)
        self._mote_folder = gui.add_folder("Motes", expand_by_default=False, visible=False)
        with self._mote_folder:
            self._motes = gui.add_html("")
        with gui.add_folder("Layers", expand_by_default=False):
            for layer in scene.layers:
                _add_checkbox(gui, layer)
        self._drawn_s: float | None = None
        self._charted_s: float | None = None

    def draw(self, view: TeamView, now_s: float) -> None:
        """Bring figures and tables up to date, a few times a second."""
        if self._drawn_s is not None and now_s - self._drawn_s < PERIOD_S:
            return
        self._drawn_s = now_s
        self._summary.content = summary_html(view)
        self._robots.content = robots_html(view, now_s)
        self._mote_folder.visible = bool(view.motes)
        if view.motes:
            self._motes.content = motes_html(view)
        if len(view.explored) > 1 and (self._charted_s is None or now_s - self._charted_s >= CHART_PERIOD_S):
            self._charted_s = now_s
            self._chart_folder.visible = True
            time_s, fraction = np.array(view.explored).T
            self._chart.data = (time_s, 100 * fraction)


def _add_checkbox(gui: viser.GuiApi, layer: Layer) -> None:
    checkbox = gui.add_checkbox(layer.label, layer.shown)

    @checkbox.on_update
    def _(_: viser.GuiEvent[Any]) -> None:
        layer.shown = checkbox.value


def _move_camera(scene: Scene, event: viser.GuiEvent[Any]) -> None:
    if event.client is None:
        return
    if event.target.value == "Top view":
        scene.show_top(event.client)
    else:
        scene.show_overview(event.client)


def _add_chart(gui: viser.GuiApi) -> viser.GuiUplotHandle:
    grey = "rgba(160, 170, 185, 0.9)"
    grid = uplot.Axis_Grid(stroke="rgba(160, 170, 185, 0.15)", width=1)
    ticks = uplot.Axis_Ticks(show=False)
    return gui.add_uplot(
        data=(np.array([0.0, 1.0]), np.array([0.0, 0.0])),
        series=(
            uplot.Series(label="s"),
            uplot.Series(label="%", stroke=css(ROBOT_COLORS[1]), width=2),
        ),
        scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=(0.0, 100.0))},
        axes=(
            uplot.Axis(stroke=grey, grid=grid, ticks=ticks, size=26),
            uplot.Axis(stroke=grey, grid=grid, ticks=ticks, size=38),
        ),
        legend=uplot.Legend(show=False),
        height=130,
        padding=(10, 12, 0, 0),
    )
