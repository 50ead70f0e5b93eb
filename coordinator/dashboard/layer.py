"""What a layer of the scene is: something that can be shown or hidden, and is drawn now and then.

A layer of the server's scene is drawn once and sent to all browsers, and each browser shows or hides it for itself
(`layer_switches.py`). A layer of a client's scene belongs to that browser alone.
"""

import logging
from abc import ABC, abstractmethod
from typing import ClassVar

import viser

from robrain.coordinator.dashboard.team_view import TeamView

logger = logging.getLogger(__name__)

MANY_ROBOTS = 25
SLOWER = 3.0
"""Of a large team nobody can watch each robot, and a browser has much to draw."""


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
        self.needed = self.shown_at_first
        """Whether anybody is to see it; it is not drawn otherwise."""
        self.failures = 0
        """How often it could not draw; each time it is hidden from everybody."""

    @property
    def shown(self) -> bool:
        """Whether browsers see it that have not switched it for themselves."""
        return self._root.visible

    @shown.setter
    def shown(self, shown: bool) -> None:
        self._root.visible = shown

    def draw(self, view: TeamView, now_s: float) -> None:
        """Draw what changed, if it is time to; a layer that cannot is hidden, so that the page and its halt go on."""
        period_s = self.period_s * (SLOWER if len(view.robots) > MANY_ROBOTS else 1.0)
        if self.needed and (self._drawn_s is None or now_s - self._drawn_s >= period_s):
            self._drawn_s = now_s
            try:
                self._draw(view, now_s)
            except Exception:
                logger.exception("the layer %s cannot draw what there is, and is hidden", self.label)
                self.shown = self.needed = False
                self.failures += 1

    def hurry(self) -> None:
        """Draw the next time, whenever the last one was: all has become another."""
        self._drawn_s = None

    def node(self, name: str) -> str:
        """The full name of a node of this layer."""
        return f"/{self.name}/{name}"

    @abstractmethod
    def _draw(self, view: TeamView, now_s: float) -> None:
        """Bring the layer's nodes up to date."""
