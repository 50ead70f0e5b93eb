"""What a layer is that one browser has for itself: it shows something of the robot that is selected there."""

from robrain.coordinator.dashboard.layer import Layer
from robrain.coordinator.dashboard.team_view import TeamView


class OwnLayer(Layer):
    """A layer of a client's scene; `_draw` finds the name of the selected robot in `selected`."""

    selected = ""

    def draw_for(self, selected: str, view: TeamView, now_s: float) -> None:
        """Draw what changed, if it is time to, and at once when another robot is selected."""
        if selected != self.selected:
            self.selected = selected
            self.hurry()
        self.draw(view, now_s)
