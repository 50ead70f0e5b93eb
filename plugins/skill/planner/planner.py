"""Planner: cheapest paths on the inflated map, and ways out of the way of others."""

from collections.abc import Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.plugin import Skill
from robrain.plugins.skill.mapper.interface import MapView
from robrain.plugins.skill.planner.interface import Circle, PlannerInterface
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.protocol.model.escape import escape_cells
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.line_of_sight import standpoint
from robrain.protocol.model.navigation import NavigationGrid, Zone
from robrain.protocol.model.right_of_way import Track


class Planner(Skill):
    """Plans paths for a round robot, whose radius the driver tells."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """How paths are. All values are chosen."""

        margin_m: float = 0.08
        """Kept from obstacles beyond the robot's radius."""
        snap_m: float = 0.8
        """How far a path's ends may be from where the robot is and where it is to go, if it cannot stand there."""
        unknown: Literal["avoid", "dear", "free"] = "avoid"
        """Unknown floor: not driven on; at `unknown_cost` times the cost of known floor; or as if it were known."""
        unknown_cost: float = 4.0

        def __post_init__(self) -> None:
            for name in ("margin_m", "snap_m"):
                if not getattr(self, name) > 0:
                    raise ValueError(f"expected {name} > 0, got {getattr(self, name)}")
            if not self.unknown_cost >= 1:
                raise ValueError(f"expected unknown_cost >= 1, got {self.unknown_cost}")

    interface = PlannerInterface
    parameters: Parameters

    def init(self) -> None:
        self._grid: NavigationGrid | None = None
        self._version = -1

    def activate(self) -> None:
        self._needed_m = self.env.use("driver", DriverInterface).radius_m() + self.parameters.margin_m

    def plan(
        self, view: MapView, start: Point2D, goal: Point2D, avoid: Sequence[Circle], dear: Sequence[Zone] = ()
    ) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand."""
        return self._navigation(view).path(start, goal, snap_m=self.parameters.snap_m, avoid=avoid, dear=dear)

    def escape(
        self, view: MapView, start: Point2D, speed_m_s: float, tracks: Sequence[Track], apart_m: float
    ) -> list[Point2D] | None:
        """Waypoints to the nearest place out of the way of all tracks that go first."""
        grid = self._navigation(view)
        cell = grid.snap(start, self.parameters.snap_m)
        if cell is None:
            return None
        cells = escape_cells(grid.traversable, grid.geometry, cell, speed_m_s, tracks, apart_m)
        return None if cells is None else grid.waypoints(cells)

    def standpoint(self, view: MapView, place: Point2D, within_m: float) -> Point2D | None:
        """Where the robot can stand and see a place, as near to it as can be; None if walls hide it from there."""
        grid = self._navigation(view)
        reach = round(within_m / grid.geometry.resolution_m)
        cell = standpoint(view.classes, grid.traversable, grid.geometry.cell_of(place.x_m, place.y_m), reach)
        return None if cell is None else grid.geometry.center_of(*cell)

    def safe_positions(self, view: MapView, positions: NDArray[np.float64]) -> int:
        """How many of positions (N, 2) on a path come before the first that is too near to a known obstacle."""
        grid = self._grid if self._grid is not None else self._navigation(view)
        return grid.clear_positions(view.classes, positions)

    def _navigation(self, view: MapView) -> NavigationGrid:
        grid = self._grid
        if grid is None or grid.geometry != view.geometry:
            unknown_cost = {"avoid": None, "dear": self.parameters.unknown_cost, "free": 1.0}[self.parameters.unknown]
            grid = self._grid = NavigationGrid(view.classes, view.geometry, self._needed_m, unknown_cost)
        elif self._version != view.version:
            grid.update(view.classes)
        self._version = view.version
        return grid
