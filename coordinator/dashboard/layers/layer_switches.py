"""Which layers one browser shows: each has its own choice, though all layers but the lidar's are drawn once for all.

viser lets a client's scene have a node of its own under the name of a shared one; that browser then goes by it, also
for all that hangs below. So a browser that hides a layer has a hidden frame of its own in place of the layer's root,
and nothing is sent twice.
"""

from collections.abc import Iterable

import viser

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.layers.marker_layers import MoteLabelLayer, MoteLayer, ScanLayer
from robrain.coordinator.dashboard.layers.own_layer import OwnLayer
from robrain.coordinator.dashboard.layers.radio_layer import FocusRadioLayer, RadioLayer
from robrain.coordinator.dashboard.state.alerts import Alert, Level
from robrain.coordinator.dashboard.state.focus import Focus
from robrain.coordinator.dashboard.state.team_view import TeamView


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
        self._shown = layer.wanted
        self._frame = client.scene.add_frame(f"/{layer.name}", show_axes=False, visible=layer.shown)

    @property
    def label(self) -> str:
        """What people call the layer."""
        return self.layer.label

    @property
    def shown(self) -> bool:
        """Whether this browser shows it; a failing layer is hidden regardless."""
        return self._shown

    @shown.setter
    def shown(self, shown: bool) -> None:
        self._shown = shown
        self._show()

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All that it switches."""
        return (self.layer,) if self._own is None else (self.layer, self._own)

    def draw(self, view: TeamView, focus: Focus, now_s: float) -> None:
        """Draw what is this browser's own, and hide what could not be drawn."""
        self._show()
        if self._own is not None:
            self._own.wanted = self._own.needed = self._shown
            self._own.draw_for(focus, view, now_s)

    def _show(self) -> None:
        visible = self._shown and not self.layer.failing
        if self._frame.visible != visible:
            self._frame.visible = visible


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
        return self.layer.wanted

    @shown.setter
    def shown(self, shown: bool) -> None:
        self.layer.wanted = self.layer.needed = shown

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All that it switches."""
        return (self.layer,)

    def draw(self, view: TeamView, focus: Focus, now_s: float) -> None:
        """Draw it for the given focus."""
        self.layer.draw_for(focus, view, now_s)


Switch = LayerSwitch | OwnSwitch
OWN: dict[type[Layer], type[OwnLayer]] = {MoteLayer: MoteLabelLayer, RadioLayer: FocusRadioLayer}
"""Per-browser layers that share the switch of a layer common to all browsers."""


def switches_of(client: viser.ClientHandle, layers: tuple[Layer, ...]) -> list[Switch]:
    """A browser's switches of all layers, in the order of their checkboxes."""
    switches: list[Switch] = [
        LayerSwitch(client, layer, OWN[type(layer)](client.scene) if type(layer) in OWN else None) for layer in layers
    ]
    return [*switches, OwnSwitch(ScanLayer(client.scene))]


def troubles_of(switches: Iterable[Switch], now_s: float) -> list[Alert]:
    """Alerts for the layers that one browser wants to show and that fail."""
    return [
        Alert(Level.WARN, "Picture", f"{layer.label} cannot be drawn; next try in {layer.retry_in_s(now_s):.0f} s")
        for switch in switches
        for layer in switch.layers
        if switch.shown and layer.failing
    ]
