"""The tab of the picture: camera, theme, layers, legend and motes."""

from robrain.coordinator.dashboard.html.html_words import text
from robrain.coordinator.dashboard.html.panel_html import motes_html
from robrain.coordinator.dashboard.layers.floor_layers import FieldLayer
from robrain.coordinator.dashboard.layers.layer_switches import LayerSwitch
from robrain.coordinator.dashboard.panels.gui_values import set_html, set_value, set_visible
from robrain.coordinator.dashboard.panels.page_context import Page
from robrain.coordinator.drawing.palette import HEAT, css

OVERVIEW, TOP = "Overview", "Top view"
MOTES_PERIOD_S = 3.0
LEGEND = (
    '<div class="rb"><h4>Motes</h4><div class="rb-legend"><span class="rb-good">◆ well</span>'
    '<span class="rb-warn">▲ low</span><span class="rb-bad">■ nearly empty</span>'
    '<span class="rb-soft">◇ not heard</span></div>'
    '<h4>Radio links</h4><div class="rb-legend"><span class="rb-good">━ strong</span>'
    '<span class="rb-warn">– – weak</span>'
    '<span class="rb-bad">· · very weak</span><span>wider: between robots</span><span>▬ relay</span>'
    "<span>▶ readings from mote to mote, to a gateway</span></div>"
    '<h4>Tasks</h4><div class="rb-legend"><span>⚑ flag: waits</span><span>▼ pin: a robot is at it</span>'
    "<span>⚡ plate: charger</span><span>yellow diamond: border of the known</span></div><h4>Keys</h4>"
    '<div class="rb-legend"><span><b>H</b> halt all</span><span><b>O</b> overview</span><span><b>T</b> top view</span>'
    "<span><b>F</b> follow</span><span><b>N</b>, <b>P</b> next, previous robot</span>"
    "<span><b>L</b> light or dark</span>"
    "<span><b>W A S D Q E</b> drive by hand, once armed</span><span><b>Ctrl+K</b> all commands</span></div></div>"
)


class ViewTab:
    """The tab of one page; built within the tab's context."""

    def __init__(self, page: Page) -> None:
        gui = page.client.gui
        self._page = page
        self._listed_s: float | None = None
        camera = gui.add_button_group("Camera", (OVERVIEW, TOP))
        camera.on_click(lambda event: page.post(self.top if event.target.value == TOP else self.overview))
        self._follow = gui.add_checkbox("Follow selected", False)
        self._follow.on_update(lambda event: page.post(lambda: self.set_follow(event.target.value)))
        theme = gui.add_button_group("Colours", ("Dark", "Light"))
        theme.on_click(lambda event: page.post(lambda: page.set_dark(event.target.value == "Dark")))
        with gui.add_folder("Layers"):
            for switch in page.switches:
                self._add_box(switch)
            self._scale = gui.add_html("", visible=False)
        with gui.add_folder("Legend and keys", expand_by_default=False):
            gui.add_html(LEGEND)
        self._mote_folder = gui.add_folder("Motes", expand_by_default=False, visible=False)
        with self._mote_folder:
            self._motes = gui.add_html("")

    def draw(self, now_s: float) -> None:
        """Show the current state."""
        view = self._page.context.view
        set_visible(self._mote_folder, bool(view.motes))
        if view.motes and (self._listed_s is None or now_s - self._listed_s >= MOTES_PERIOD_S):
            self._listed_s = now_s
            set_html(self._motes, motes_html(view))
        layers = [switch.layer for switch in self._page.switches if switch.shown]
        scale = next((layer.range for layer in layers if isinstance(layer, FieldLayer)), None)
        set_visible(self._scale, scale is not None)
        if scale is not None:
            set_html(self._scale, scale_html(*scale))

    def overview(self) -> None:
        """Move the camera to where the whole map is seen from the side and above."""
        self.set_follow(False)
        self._page.context.scene.show_overview(self._page.client)

    def top(self) -> None:
        """Move the camera above the map."""
        self.set_follow(False)
        self._page.context.scene.show_top(self._page.client)

    def set_follow(self, follows: bool) -> None:
        """Whether the camera follows the selected robot."""
        self._page.follows = follows
        set_value(self._follow, follows)

    def _add_box(self, switch: LayerSwitch) -> None:
        def choose(shown: bool) -> None:
            switch.shown = shown

        box = self._page.client.gui.add_checkbox(switch.label, switch.shown)
        box.on_update(lambda event: self._page.post(lambda: choose(event.target.value)))


def scale_html(quantity: str, low: float, high: float) -> str:
    """The heat map's colours, with the values at both ends."""
    steps = ", ".join(css(color) for color in HEAT)
    return (
        f'<div class="rb" data-testid="field-scale">{text(quantity, 40)}'
        f'<div class="rb-scale" style="background: linear-gradient(to right, {steps})"></div>'
        f'<div style="display: flex; justify-content: space-between">'
        f"<span>{low:.1f}</span><span>{high:.1f}</span></div></div>"
    )
