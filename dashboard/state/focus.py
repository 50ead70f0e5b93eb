"""The focus of one browser: its selected robot and mote, and the area that it has zoomed in on."""

from typing import NamedTuple

from robrain.dashboard.state.shown_robot import ShownMote
from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.model.geometry import Point2D

MOTES = 40
"""Maximum number of motes with label and link at a time; the table lists all."""


class Focus(NamedTuple):
    """Labels and links are drawn only for motes in focus, as a team may have many motes."""

    robot: str = ""
    """Name of the selected robot; empty if none."""
    chosen: bool = False
    """Whether a person selected it; the page preselects one."""
    mote: str = ""
    """Name of the selected mote; empty if none."""
    middle: Point2D | None = None
    """Target of the camera, arena frame; None if not zoomed in."""
    reach_m: float = 0.0
    """Visible radius around `middle`."""

    def is_another(self, other: "Focus") -> bool:
        """Whether the selection or the zoom state differs; camera movement does not count."""
        return (self[:3], self.middle is None) != (other[:3], other.middle is None)


def motes_in_focus(view: ShownTeam, focus: Focus) -> list[ShownMote]:
    """The selected mote, motes in reach of the selected robot, then visible ones, nearest first; at most `MOTES`."""
    robot = view.robots.get(focus.robot) if focus.chosen else None
    received = {link.peer for link in robot.links if not link.is_robot} if robot is not None else set()
    found: list[tuple[float, str]] = []
    for mote in view.motes.values():
        if mote.place is None:
            continue
        if mote.name == focus.mote:
            found.append((-1.0, mote.name))
        elif robot is not None and (mote.name in received or robot.name in mote.links):
            found.append((0.0, mote.name))
        elif focus.middle is not None:
            distance_m = ((mote.place.x_m - focus.middle.x_m) ** 2 + (mote.place.y_m - focus.middle.y_m) ** 2) ** 0.5
            if distance_m <= focus.reach_m:
                found.append((distance_m, mote.name))
    return [view.motes[name] for _, name in sorted(found)[:MOTES]]
