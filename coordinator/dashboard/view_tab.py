"""The tab of the picture: camera, layers, what the marks mean, motes, dark or light."""

from typing import TYPE_CHECKING, Any

import viser

from robrain.coordinator.dashboard.field_layer import FieldLayer
from robrain.coordinator.dashboard.gui_values import set_html, set_value
from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.palette import HEAT, css
from robrain.coordinator.dashboard.panel_html import motes_html
from robrain.coordinator.dashboard.words import text

if TYPE_CHECKING:
    from robrain.coordinator.dashboard.page import ClientPage

OVERVIEW, TOP = "Overview", "Top view"
MOTES_PERIOD_S = 3.0
LEGEND = (
    '<div class="rb"><h4>Motes</h4><div class="rb-legend"><span class="rb-good">◆ well</span>'
    '<span class="rb-warn">▲ low</span><span class="rb-bad">■ nearly empty</span>'
    '<span class="rb-soft">◇ not heard</span></div>'
    '<h4>Radio links</h4><div class="rb-legend"><span class="rb-good">— strong</span>'
    '<span class="rb-warn">– – weak</span>'
    '<span class="rb-bad">· · very weak</span><span>▬ relay</span></div>'
    '<h4>Tasks</h4><div class="rb-legend"><span>⚑ flag: waits</span><span>▼ pin: a robot is at it</span>'
    "<span>⚡ plate: charger</span><span>yellow diamond: border of the known</span></div><h4>Keys</h4>"
    '<div class="rb-legend"><span><b>H</b> halt all</span><span><b>O</b> overview</span><span><b>T</b> top view</span>'
    "<span><b>F</b> follow</span><span><b>N</b>, <b>P</b> next, previous robot</span>"
    "<span><b>L</b> light or dark</span>"
    "<span><b>W A S D Q E</b> drive by hand, once armed</span><span><b>Ctrl+K</b> all commands</span></div></div>"
)


class ViewTab:
    """Built within the tab's context."""

    def __init__(self, page: "ClientPage") -> None:
        gui = page.client.gui
        self._page = page
        self._listed_s: float | None = None
        camera = gui.add_button_group("Camera", (OVERVIEW, TOP))
        camera.on_click(self._move_camera)
        self._follow = gui.add_checkbox("Follow selected", False)
        self._follow.on_update(lambda event: page.post(lambda: self.set_follow(event.target.value)))
        theme = gui.add_button_group("Colours", ("Dark", "Light"))
        theme.on_click(lambda event: page.post(lambda: page.set_dark(event.target.value == "Dark")))
        self._boxes: list[tuple[Layer, viser.GuiCheckboxHandle]] = []
        with gui.add_folder("Layers (for all who look on)"):
            for layer in page.context.scene.layers:
                self._add_layer(gui, layer)
            self._scale = gui.add_html("", visible=False)
        with gui.add_folder("Legend and keys", expand_by_default=False):
            gui.add_html(LEGEND)
        self._mote_folder = gui.add_folder("Motes", expand_by_default=False, visible=False)
        with self._mote_folder:
            self._motes = gui.add_html("")

    def draw(self, now_s: float) -> None:
        """Bring it up to date."""
        view = self._page.context.view
        for layer, box in self._boxes:
            set_value(box, layer.shown)  # another browser may have switched it
        if bool(view.motes) != self._mote_folder.visible:
            self._mote_folder.visible = bool(view.motes)
        if view.motes and (self._listed_s is None or now_s - self._listed_s >= MOTES_PERIOD_S):
            self._listed_s = now_s
            set_html(self._motes, motes_html(view))
        field = next((layer for layer, _ in self._boxes if isinstance(layer, FieldLayer)), None)
        shown = field is not None and field.shown and field.range is not None
        if self._scale.visible != shown:
            self._scale.visible = shown
        if field is not None and field.range is not None and shown:
            set_html(self._scale, scale_html(*field.range))

    def overview(self) -> None:
        """See all of the map."""
        self.set_follow(False)
        self._page.context.scene.show_overview(self._page.client)

    def top(self) -> None:
        """See all of the map from above."""
        self.set_follow(False)
        self._page.context.scene.show_top(self._page.client)

    def set_follow(self, follows: bool) -> None:
        """Have the camera go along with the selected robot, or not."""
        self._page.follows = follows
        set_value(self._follow, follows)

    def _move_camera(self, event: viser.GuiEvent[Any]) -> None:
        self._page.post(self.top if event.target.value == TOP else self.overview)

    def _add_layer(self, gui: viser.GuiApi, layer: Layer) -> None:
        box = gui.add_checkbox(layer.label, layer.shown)
        self._boxes.append((layer, box))

        @box.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # and not our own setting of it
                shown = box.value
                self._page.post(lambda: setattr(layer, "shown", shown))


def scale_html(quantity: str, low: float, high: float) -> str:
    """The colours of the heat map and what they stand for."""
    steps = ", ".join(css(color) for color in HEAT)
    return (
        f'<div class="rb" data-testid="field-scale">{text(quantity, 40)}'
        f'<div class="rb-scale" style="background: linear-gradient(to right, {steps})"></div>'
        f'<div style="display: flex; justify-content: space-between">'
        f"<span>{low:.1f}</span><span>{high:.1f}</span></div></div>"
    )
