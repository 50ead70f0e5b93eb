"""Which layers one browser shows: each has its own choice, though all layers but the lidar's are drawn once for all.

viser lets a client's scene have a node of its own under the name of a shared one; that browser then goes by it, also
for all that hangs below. So a browser that hides a layer has a hidden frame of its own in place of the layer's root,
and nothing is sent twice.
"""

import viser

from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.marker_layers import ScanLayer
from robrain.coordinator.dashboard.own_layer import OwnLayer
from robrain.coordinator.dashboard.radio_layer import RadioLayer, SelectedRadioLayer
from robrain.coordinator.dashboard.team_view import TeamView


class LayerSwitch:
    """One browser's switch of a layer that all share.

    Args:
        client: the browser.
        layer: drawn once for all browsers.
        own: a layer of this browser's alone that goes with it.
    """

    def __init__(self, client: viser.ClientHandle, layer: Layer, own: OwnLayer | None = None) -> None:
        self.layer = layer
        self._own = own
        self._frame = client.scene.add_frame(f"/{layer.name}", show_axes=False, visible=layer.shown)
        self._failures = layer.failures

    @property
    def label(self) -> str:
        """What people call the layer."""
        return self.layer.label

    @property
    def shown(self) -> bool:
        """Whether this browser shows it."""
        return self._frame.visible

    @shown.setter
    def shown(self, shown: bool) -> None:
        self._frame.visible = shown

    def draw(self, view: TeamView, selected: str, now_s: float) -> None:
        """Draw what is this browser's own, and hide what could not be drawn."""
        if self.layer.failures != self._failures:
            self._failures = self.layer.failures
            self.shown = False
        if self._own is not None:
            self._own.shown = self._own.needed = self.shown and not self._own.failures
            self._own.draw_for(selected, view, now_s)


class OwnSwitch:
    """One browser's switch of a layer that is drawn for it alone."""

    def __init__(self, layer: OwnLayer) -> None:
        self.layer = layer

    @property
    def label(self) -> str:
        """What people call the layer."""
        return self.layer.label

    @property
    def shown(self) -> bool:
        """Whether this browser shows it."""
        return self.layer.shown

    @shown.setter
    def shown(self, shown: bool) -> None:
        self.layer.shown = self.layer.needed = shown

    def draw(self, view: TeamView, selected: str, now_s: float) -> None:
        """Draw it for the selected robot."""
        self.layer.draw_for(selected, view, now_s)


Switch = LayerSwitch | OwnSwitch


def switches_of(client: viser.ClientHandle, layers: tuple[Layer, ...]) -> list[Switch]:
    """A browser's switches of all layers, in the order of their checkboxes."""
    switches: list[Switch] = [
        LayerSwitch(client, layer, SelectedRadioLayer(client.scene) if isinstance(layer, RadioLayer) else None)
        for layer in layers
    ]
    return [*switches, OwnSwitch(ScanLayer(client.scene))]
