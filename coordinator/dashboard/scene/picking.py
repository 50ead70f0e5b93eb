"""What a click into the picture means."""

import math

from robrain.coordinator.dashboard.state.robot_view import MoteView, RobotView
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.protocol.model.geometry import Point2D

NEAR_M = 0.5
NEAR_SHARE = 0.02
"""And so much of the camera's distance: from afar a robot is small."""
FAR_M = 1e5


def floor_hit(
    origin: tuple[float, float, float], direction: tuple[float, float, float]
) -> tuple[Point2D, float] | None:
    """Where a ray meets the floor, arena frame, and how far along it, metres; None if it does not."""
    if not all(map(math.isfinite, (*origin, *direction))) or direction[2] >= 0 or origin[2] <= 0:
        return None
    along = -origin[2] / direction[2]
    x_m, y_m = origin[0] + along * direction[0], origin[1] + along * direction[1]
    distance_m = along * math.sqrt(sum(part * part for part in direction))
    return (Point2D(x_m, y_m), distance_m) if abs(x_m) < FAR_M and abs(y_m) < FAR_M else None


def robot_near(view: TeamView, place: Point2D, camera_m: float) -> RobotView | None:
    """The nearest robot that may have been meant by a click at a place, seen from so far."""
    reach_m = max(NEAR_M, NEAR_SHARE * camera_m)
    near = [
        (robot.pose.distance_m(place), robot)
        for robot in view.robots.values()
        if robot.pose is not None and robot.pose.distance_m(place) <= reach_m
    ]
    return min(near, key=lambda found: found[0])[1] if near else None


def mote_near(view: TeamView, place: Point2D, camera_m: float) -> MoteView | None:
    """The nearest mote within picking range of a click; the range grows with the camera's distance."""
    reach_m = max(NEAR_M, NEAR_SHARE * camera_m)
    near = [
        (math.hypot(mote.place.x_m - place.x_m, mote.place.y_m - place.y_m), mote.name)
        for mote in view.motes.values()
        if mote.place is not None
    ]
    distance_m, name = min(near, default=(math.inf, ""))
    return view.motes[name] if distance_m <= reach_m else None
