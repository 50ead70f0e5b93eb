"""Which layers one browser shows: each has its own choice, though all layers but the lidar's are drawn once for all.

viser lets a client's scene have a node of its own under the name of a shared one, which replaces it in that browser,
together with all nodes below. So a browser that hides a layer has a hidden frame of its own in place of the layer's
root, and nothing is sent twice.
"""

from collections.abc import Iterable

import viser

from robrain.dashboard.layers.layer import Layer, OwnLayer
from robrain.dashboard.layers.marker_layers import MoteLabelLayer, MoteLayer, ScanLayer
from robrain.dashboard.layers.radio_layer import FocusRadioLayer, RadioLayer
from robrain.dashboard.state.alerts import Alert, AlertLevel
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.team_view import TeamView

OWN: dict[type[Layer], type[OwnLayer]] = {MoteLayer: MoteLabelLayer, RadioLayer: FocusRadioLayer}
"""Per-browser layers that share the switch of a layer common to all browsers."""


class LayerSwitch:
    """One browser's switch of a layer.

    Args:
        client: the browser.
        layer: drawn once for all browsers, or for this one alone.
        own: a further layer of this browser alone, with the same switch.
    """

    def __init__(self, client: viser.ClientHandle, layer: Layer, own: OwnLayer | None = None) -> None:
        self.layer = layer
        self.label = layer.label
        self.layers = (layer,) if own is None else (layer, own)
        self._own = layer if isinstance(layer, OwnLayer) else own
        self._frame: viser.FrameHandle | None = None
        if layer is not self._own:
            self._frame = client.scene.add_frame(f"/{layer.name}", show_axes=False, visible=layer.shown)
        self.shown = layer.wanted

    @property
    def shown(self) -> bool:
        """Whether this browser shows it; a failing layer is hidden regardless."""
        return self._shown

    @shown.setter
    def shown(self, shown: bool) -> None:
        self._shown = shown
        if self._own is not None:
            self._own.wanted = self._own.needed = shown
        self._show()

    def draw(self, view: TeamView, focus: Focus, now_s: float) -> None:
        """Draw the browser's own layer, and hide what could not be drawn."""
        self._show()
        if self._own is not None:
            self._own.draw_for(focus, view, now_s)

    def _show(self) -> None:
        if self._frame is not None:
            visible = self._shown and not self.layer.failing
            if self._frame.visible != visible:
                self._frame.visible = visible


def switches_of(client: viser.ClientHandle, layers: tuple[Layer, ...]) -> list[LayerSwitch]:
    """A browser's switches of all layers, in the order of their checkboxes."""
    own = {layer: OWN[type(layer)](client.scene) for layer in layers if type(layer) in OWN}
    return [LayerSwitch(client, layer, own.get(layer)) for layer in (*layers, ScanLayer(client.scene))]


def troubles_of(switches: Iterable[LayerSwitch], now_s: float) -> list[Alert]:
    """Alerts for the layers that one browser wants to show and that fail."""
    return [
        Alert(
            AlertLevel.WARN, "Picture", f"{layer.label} cannot be drawn; next try in {layer.retry.wait_s(now_s):.0f} s"
        )
        for switch in switches
        for layer in switch.layers
        if switch.shown and layer.failing
    ]
