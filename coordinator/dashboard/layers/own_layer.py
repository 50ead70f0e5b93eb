"""Base class of per-browser layers, which show details of that browser's focus."""

from robrain.coordinator.dashboard.layers.layer import Layer
from robrain.coordinator.dashboard.state.focus import Focus
from robrain.coordinator.dashboard.state.team_view import TeamView


class OwnLayer(Layer):
    """A layer of one client's scene; `_draw` reads `focus`."""

    focus = Focus()

    def draw_for(self, focus: Focus, view: TeamView, now_s: float) -> None:
        """Draw what changed, if drawing is due; at once if the selection or the zoom state changed."""
        if focus.is_another(self.focus):
            self.hurry()
        self.focus = focus
        self.draw(view, now_s)
