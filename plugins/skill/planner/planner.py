"""Planner: cheapest paths on the inflated map, through known floor only."""

import msgspec

from robrain.agent.plugin import Skill
from robrain.plugins.skill.mapper.interface import MapView
from robrain.plugins.skill.planner.interface import Circle, PlannerInterface
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.navigation import NavigationGrid


class Planner(Skill):
    """Plans paths for a round robot."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """`margin_m` is kept from obstacles beyond the robot's radius."""

        radius_m: float = 0.20
        margin_m: float = 0.08
        snap_m: float = 0.8

        def __post_init__(self) -> None:
            for name in self.__struct_fields__:
                if getattr(self, name) <= 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")

    interface = PlannerInterface
    parameters: Parameters

    def init(self) -> None:
        self._grid: NavigationGrid | None = None
        self._version = -1

    def plan(self, view: MapView, start: Point2D, goal: Point2D, avoid: list[Circle]) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand."""
        return self._navigation(view).path(start, goal, snap_m=self.parameters.snap_m, avoid=avoid)

    def _navigation(self, view: MapView) -> NavigationGrid:
        if self._grid is None or self._version != view.version:
            needed_m = self.parameters.radius_m + self.parameters.margin_m
            self._grid = NavigationGrid(view.classes, view.geometry, needed_m)
            self._version = view.version
        return self._grid
