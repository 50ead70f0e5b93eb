"""Base classes of the scene's layers, which can be shown or hidden and are drawn periodically.

A layer of the server's scene is drawn once and sent to all browsers, and each browser shows or hides it for itself
(`layer_switches.py`). A layer of a client's scene belongs to that browser alone.
"""

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import viser

from robrain.dashboard.scene.merged_meshes import MergedMeshes
from robrain.dashboard.scene.meshes import Mesh
from robrain.dashboard.server.retry import Retry
from robrain.dashboard.state.focus import Focus
from robrain.dashboard.state.team_view import TeamView
from robrain.recording.drawing.palette import Rgb

logger = logging.getLogger(__name__)

MANY_ROBOTS = 25
SLOWER = 3.0
"""Factor of all periods for a larger team: nobody can watch each robot, and a browser has much to draw."""


class Layer(ABC):
    """Draws one aspect of the team below a node of its own, which hides with its checkbox.

    A layer gives its `name` (of the node), its `label` (for people), its `period_s` and whether it is shown at first,
    and draws in `_draw`.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    period_s: ClassVar[float]
    shown_at_first: ClassVar[bool] = True

    def __init__(self, scene: viser.SceneApi) -> None:
        self.scene = scene
        self._root = scene.add_frame(f"/{self.name}", show_axes=False, visible=self.shown_at_first)
        self._drawn_s: float | None = None
        self._wanted = self.shown_at_first
        self.retry = Retry()
        """Schedules the next drawing after an error."""
        self.needed = self.shown_at_first
        """Whether any browser shows it; if not, it is not drawn."""

    @property
    def wanted(self) -> bool:
        """Whether browsers show it by default, unless it fails."""
        return self._wanted

    @wanted.setter
    def wanted(self, wanted: bool) -> None:
        self._wanted = wanted
        self._show()

    @property
    def shown(self) -> bool:
        """Whether it is visible: wanted, and last drawn without an error."""
        return self._wanted and not self.failing

    @property
    def failing(self) -> bool:
        """Whether the last drawing failed; the layer is hidden until one succeeds."""
        return self.retry.failing

    def draw(self, view: TeamView, now_s: float) -> None:
        """Draw what changed, if drawing is due.

        A layer that fails is hidden and retried later, so that the page and its halt keep working.
        """
        period_s = self.period_s * (SLOWER if len(view.robots) > MANY_ROBOTS else 1.0)
        is_time = self._drawn_s is None or now_s - self._drawn_s >= period_s
        if not (self.needed and is_time and self.retry.is_due(now_s)):
            return
        self._drawn_s = now_s
        try:
            self._draw(view, now_s)
        except Exception:  # viser may raise anything; the page and its halt must keep working
            pause_s = self.retry.fail(now_s)
            logger.exception("the layer %s cannot be drawn; it is hidden, next try in %.0f s", self.label, pause_s)
        else:
            if failures := self.retry.succeed():
                logger.warning("the layer %s is drawn again after %d failures", self.label, failures)
        self._show()

    def hurry(self) -> None:
        """Draw at the next step, even if that is before it is due."""
        self._drawn_s = None

    def _show(self) -> None:
        if self._root.visible != self.shown:
            self._root.visible = self.shown

    def node(self, name: str) -> str:
        """The full name of a node of this layer."""
        return f"/{self.name}/{name}"

    @abstractmethod
    def _draw(self, view: TeamView, now_s: float) -> None:
        """Bring the layer's nodes up to date."""


class OwnLayer(Layer):
    """A layer of one client's scene, with details of that browser's focus; `_draw` reads `focus`."""

    focus = Focus()

    def draw_for(self, focus: Focus, view: TeamView, now_s: float) -> None:
        """Draw what changed, if drawing is due; at once if the selection or the zoom state changed."""
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

    def _draw(self, view: TeamView, now_s: float) -> None:
        self._solids.show(self._meshes(view, now_s))

    @abstractmethod
    def _meshes(self, view: TeamView, now_s: float) -> Mapping[Rgb, Mesh]:
        """The meshes to show."""
