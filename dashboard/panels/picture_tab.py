"""The tab of the picture: camera, colours, layers, legend and motes."""

import viser

from robrain.dashboard.html.elements import render
from robrain.dashboard.html.team_html import motes_html
from robrain.dashboard.layers.floor_layers import FieldLayer
from robrain.dashboard.layers.layer import LayerSwitch
from robrain.dashboard.panels.gui_values import set_html, set_value, set_visible
from robrain.dashboard.panels.page import Page, Tab
from robrain.recording.drawing.palette import HEAT

OVERVIEW, TOP = "Overview", "Top view"
MOTES_PERIOD_S = 3.0


class PictureTab(Tab):
    """The tab of one page."""

    title, icon = "View", viser.Icon.EYE

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._listed_s: float | None = None
        camera = gui.add_button_group("Camera", (OVERVIEW, TOP))
        camera.on_click(lambda event: page.post(page.show_top if event.target.value == TOP else page.show_overview))
        self._follow = gui.add_checkbox("Follow selected", False)
        self._follow.on_update(lambda event: page.post(lambda: page.set_follow(event.target.value)))
        theme = gui.add_button_group("Colours", ("Dark", "Light"))
        theme.on_click(lambda event: page.post(lambda: page.set_dark(event.target.value == "Dark")))
        with gui.add_folder("Layers"):
            for switch in page.switches:
                self._add_box(switch)
            self._scale = gui.add_html("", visible=False)
        with gui.add_folder("Legend and keys", expand_by_default=False):
            gui.add_html(render("controls", "legend"))
        self._mote_folder = gui.add_folder("Motes", expand_by_default=False, visible=False)
        with self._mote_folder:
            self._motes = gui.add_html("")

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        view = self._page.context.view
        set_value(self._follow, self._page.follows)
        set_visible(self._mote_folder, bool(view.motes))
        if view.motes and (self._listed_s is None or now_s - self._listed_s >= MOTES_PERIOD_S):
            self._listed_s = now_s
            set_html(self._motes, motes_html(view))
        layers = [switch.layer for switch in self._page.switches if switch.shown]
        scale = next((layer.range for layer in layers if isinstance(layer, FieldLayer)), None)
        set_visible(self._scale, scale is not None)
        if scale is not None:
            set_html(self._scale, scale_html(*scale))

    def _add_box(self, switch: LayerSwitch) -> None:
        def choose(shown: bool) -> None:
            switch.shown = shown

        box = self._page.client.gui.add_checkbox(switch.label, switch.shown)
        box.on_update(lambda event: self._page.post(lambda: choose(event.target.value)))


def scale_html(quantity: str, low: float, high: float) -> str:
    """The heat map's colours, with the values at both ends."""
    return render("controls", "scale", quantity=quantity, steps=HEAT, low=low, high=high)
