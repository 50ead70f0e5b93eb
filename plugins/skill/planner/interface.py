"""What the planner offers."""

from typing import Protocol

from robrain.plugins.skill.mapper.interface import MapView
from robrain.protocol.model.geometry import Point2D

Circle = tuple[float, float, float]
"""x, y, radius: metres, arena frame."""


class PlannerInterface(Protocol):
    """Shortest safe paths, arena frame."""

    def plan(self, view: MapView, start: Point2D, goal: Point2D, avoid: list[Circle]) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand; None if there is no way."""
        ...
