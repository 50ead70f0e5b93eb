"""What one browser looks at closely: the robot and the mote that are selected there, and where it has zoomed in."""

from typing import NamedTuple

from robrain.coordinator.dashboard.robot_view import MoteView
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.protocol.model.geometry import Point2D

MOTES = 40
"""More motes than this have neither label nor link at the same time; the table has them all."""


class Focus(NamedTuple):
    """Motes are many: their labels and links are drawn only for those in focus."""

    robot: str = ""
    """The selected robot; nobody if empty."""
    chosen: bool = False
    """Whether a person selected it; at first the page itself selects one."""
    mote: str = ""
    """The selected mote; none if empty."""
    middle: Point2D | None = None
    """What the camera looks at, arena frame, if it is zoomed in."""
    reach_m: float = 0.0
    """How far around the middle is seen."""

    def is_another(self, other: "Focus") -> bool:
        """Whether something else is selected, or it was zoomed in or out; the camera may have moved."""
        return (self[:3], self.middle is None) != (other[:3], other.middle is None)


def motes_in_focus(view: TeamView, focus: Focus) -> list[MoteView]:
    """The selected mote, those that the selected robot hears, and those that are seen from nearby, nearest first."""
    robot = view.robots.get(focus.robot) if focus.chosen else None
    heard = {link.peer for link in robot.links if not link.is_robot} if robot is not None else set()
    found: list[tuple[float, str]] = []
    for mote in view.motes.values():
        if mote.place is None:
            continue
        if mote.name == focus.mote:
            found.append((-1.0, mote.name))
        elif robot is not None and (mote.name in heard or robot.name in mote.links):
            found.append((0.0, mote.name))
        elif focus.middle is not None:
            distance_m = ((mote.place.x_m - focus.middle.x_m) ** 2 + (mote.place.y_m - focus.middle.y_m) ** 2) ** 0.5
            if distance_m <= focus.reach_m:
                found.append((distance_m, mote.name))
    return [view.motes[name] for _, name in sorted(found)[:MOTES]]
