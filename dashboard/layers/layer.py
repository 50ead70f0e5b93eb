"""Base classes of the scene's layers, which can be shown or hidden and are drawn periodically.

A layer of the server's scene is drawn once and sent to all browsers, and each browser shows or hides it for itself
(`LayerSwitch`). A layer of a client's scene belongs to that browser alone.
"""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import viser

from robrain.dashboard.scene.merged_meshes import MergedMeshes
from robrain.dashboard.scene.meshes import Mesh
from robrain.dashboard.scene.scene_nodes import Labels
from robrain.dashboard.state.alerts import Alert, AlertLevel
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.parts import parts_of
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.backoff import Backoff
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.topic import Topic
from robrain.recording.drawing.palette import Rgb

logger = logging.getLogger(__name__)

FIRST_RETRY_S, LONGEST_RETRY_S = 5.0, 300.0
"""Pause after the first failure to draw, and the longest one."""

MANY_ROBOTS = 25
SLOWER = 3.0
"""Factor of all periods for a larger team: no person can watch each robot, and a browser has much to draw."""


class Layer(ABC):
    """Draws one aspect of the team below one node, which its checkbox hides.

    A layer gives its `name` (of the node), its `label` (for people), its `period_s` and whether it is shown at first,
    and draws in `_draw`.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    period_s: ClassVar[float]
    shown_at_first: ClassVar[bool] = True
    detail: "ClassVar[type[OwnLayer] | None]" = None
    """A further layer of each browser, with the same switch."""
    topics: ClassVar[tuple[Topic[Any], ...]] = ()
    """Read from `ShownTeam.others`."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self.scene = scene
        self._root = scene.add_frame(f"/{self.name}", show_axes=False, visible=self.shown_at_first)
        self._drawn_s: float | None = None
        self.wanted = self.shown_at_first
        """Whether browsers show it by default, unless it fails."""
        self.retry = Backoff(FIRST_RETRY_S, LONGEST_RETRY_S)
        """Schedules the next drawing after an error."""
        self.needed = self.shown_at_first
        """Whether any browser shows it; if not, it is not drawn."""

    @property
    def failing(self) -> bool:
        """Whether the last drawing failed; the layer is hidden until one succeeds."""
        return self.retry.failures > 0

    def draw(self, view: ShownTeam, now_s: float) -> None:
        """Draw the changes, if drawing is due.

        A layer that fails is hidden and retried later, so that the page and its halt keep working.
        """
        period_s = self.period_s * (SLOWER if len(view.robots) > MANY_ROBOTS else 1.0)
        is_time = self._drawn_s is None or now_s - self._drawn_s >= period_s
        if not (self.needed and is_time and self.retry.is_due(now_s)):
            return
        self._drawn_s = now_s
        try:
            self._draw(view, now_s)
        except Exception:  # viser may raise any exception; the page and its halt must keep working
            pause_s = self.retry.fail(now_s)
            logger.exception("the layer %s cannot be drawn; it is hidden, next try in %.0f s", self.label, pause_s)
        else:
            if failures := self.retry.succeed():
                logger.warning("the layer %s is drawn again after %d failures", self.label, failures)
        self.show()

    def hurry(self) -> None:
        """Draw at the next step, even if that is before it is due."""
        self._drawn_s = None

    def show(self) -> None:
        """Make the layer visible if it is wanted, and was last drawn without an error."""
        visible = self.wanted and not self.failing
        if self._root.visible != visible:
            self._root.visible = visible

    def node(self, name: str) -> str:
        """The full name of a node of this layer."""
        return f"/{self.name}/{name}"

    @abstractmethod
    def _draw(self, view: ShownTeam, now_s: float) -> None:
        """Bring the layer's nodes up to date."""


class OwnLayer(Layer):
    """A layer of one client's scene, with details of that browser's focus; `_draw` reads `focus`."""

    focus = Focus()

    def draw_for(self, focus: Focus, view: ShownTeam, now_s: float) -> None:
        """Draw the changes, if drawing is due; at once if the selection or the zoom state changed."""
        if focus.is_another(self.focus):
            self.hurry()
        self.focus = focus
        self.draw(view, now_s)


class MeshLayer(Layer):
    """A layer of one merged mesh for each colour, which it gives in `_meshes`."""

    opacity: ClassVar[float | None] = None

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._solids = MergedMeshes(scene, self.node("solids"), self.opacity)

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        self._solids.show(self._meshes(view, now_s))

    @abstractmethod
    def _meshes(self, view: ShownTeam, now_s: float) -> Mapping[Rgb, Mesh]:
        """The meshes to show."""


class LabelledLayer(MeshLayer):
    """A layer with labels, which it gives in `_texts`."""

    def __init__(self, scene: viser.SceneApi) -> None:
        super().__init__(scene)
        self._labels = Labels(scene, self.node("label"), 0.8, below=True)  # above are the names of robots and motes

    def _draw(self, view: ShownTeam, now_s: float) -> None:
        super()._draw(view, now_s)
        self._labels.show({name: (text, (at.x_m, at.y_m, 0.0)) for name, (text, at) in self._texts(view).items()})

    @abstractmethod
    def _texts(self, view: ShownTeam) -> Mapping[str, tuple[str, Point2D]]:
        """The labels to show by name, each with its place."""


class LayerSwitch:
    """One browser's switch of a layer: each browser has its own choice.

    A node of a client's scene replaces the shared node of the same name in that browser, with all nodes below. So a
    browser that hides a layer has its own hidden frame in place of the layer's root, and nothing is sent twice.

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
            self._frame = client.scene.add_frame(
                f"/{layer.name}", show_axes=False, visible=layer.wanted and not layer.failing
            )
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
            self._own.show()
        self._show()

    def draw(self, view: ShownTeam, focus: Focus, now_s: float) -> None:
        """Draw the browser's own layer, and hide it if that fails."""
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
    shared = [LayerSwitch(client, layer, layer.detail(client.scene) if layer.detail else None) for layer in layers]
    return shared + [LayerSwitch(client, layer(client.scene)) for layer in parts_of(OwnLayer)]


def layer_alerts(switches: Iterable[LayerSwitch], now_s: float) -> list[Alert]:
    """Alerts for the layers that one browser wants to show and that fail."""
    return [
        Alert(
            AlertLevel.WARN, "Picture", f"{layer.label} cannot be drawn; next try in {layer.retry.wait_s(now_s):.0f} s"
        )
        for switch in switches
        for layer in switch.layers
        if switch.shown and layer.failing
    ]
