"""What a layer is that one browser has for itself: it shows something of what is looked at closely there."""

from robrain.coordinator.dashboard.focus import Focus
from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.team_view import TeamView


class OwnLayer(Layer):
    """A layer of a client's scene; `_draw` finds what is looked at in `focus`."""

    focus = Focus()

    def draw_for(self, focus: Focus, view: TeamView, now_s: float) -> None:
        """Draw what changed, if it is time to, and at once when something else is selected or zoomed at."""
        if focus.is_another(self.focus):
            self.hurry()
        self.focus = focus
        self.draw(view, now_s)
