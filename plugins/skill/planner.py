"""Planner: cheapest paths on the inflated map, and paths to refuges."""

from collections.abc import Sequence
from typing import Annotated, Literal, Protocol

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from robrain.agent.plugin import Skill
from robrain.algorithms.mapping.zone_grid import ZoneGrid
from robrain.algorithms.navigation.clearance import PREFERRED_MARGIN_M, mapped_clearance_m
from robrain.algorithms.navigation.navigation_grid import NavigationGrid, Swath, clearance_m
from robrain.algorithms.navigation.path_planning import distance_field, standpoint
from robrain.algorithms.navigation.reservations import ReservedArea
from robrain.algorithms.navigation.right_of_way import Track, escape_cells
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.skill.mapper.mapper import MapCells
from robrain.plugins.unit.driver.interface import DriverInterface
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.ranges import Positive

Circle = tuple[float, float, float]
"""x, y, radius: metres, arena frame."""

LEFT_M = 0.25
"""Distance of the hull from an area that the robot has left (chosen): more than the gate asks for."""


class PlannerInterface(Protocol):
    """Shortest safe paths, arena frame."""

    def plan(
        self,
        view: MapCells,
        start: Point2D,
        goal: Point2D,
        avoid: Sequence[Circle],
        dear: Sequence[Swath] = (),
        *,
        is_narrow: bool = False,
        keeps_right: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand; None if there is no path.

        From inside a keep-out zone the path first leaves it by the shortest way. The path avoids circles, and swaths
        unless the detour is much longer. With `is_narrow` the path may lead through places with less than the preferred
        clearance, down to the squeezing limit of the robot on the map. The driver checks on the spot whether the robot
        fits.
        """

    def escape(
        self,
        view: MapCells,
        start: Point2D,
        speed_m_s: float,
        tracks: Sequence[Track],
        apart_m: float,
        *,
        is_late: bool = False,
        is_narrow: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints to the nearest place clear of all tracks with right of way, as of `escape_cells`; None for none."""

    def leave_zone(
        self,
        view: MapCells,
        start: Point2D,
        area: ReservedArea | None = None,
        avoid: Sequence[Circle] = (),
        *,
        to_rest: bool = False,
    ) -> list[Point2D]:
        """Waypoints of the shortest way out of keep-out zones; none if the robot is in none, or cannot leave it.

        The same for an area that the robot is to leave. The path avoids circles. With `to_rest` it also leaves
        no-stopping zones.
        """

    def is_narrow(self, view: MapCells, place: Point2D) -> bool:
        """Whether a place, and all within one cell of it, has less than the preferred clearance but room to squeeze."""

    def standpoint(self, view: MapCells, place: Point2D, within_m: float, *, is_narrow: bool = False) -> Point2D | None:
        """The nearest point, within `within_m`, from which the robot can see a place; None if there is none."""

    def safe_positions(self, view: MapCells, positions: Floats, *, is_narrow: bool = False) -> int:
        """Number of `positions` (N, 2) on a path before the first that is too near to a known obstacle."""

    def grid(self, view: MapCells) -> NavigationGrid:
        """Where the robot can stand with its preferred clearance, and what paths cost there; do not change it."""


class Planner(Skill):
    """Plans paths for a round robot; the driver gives its radius."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Limits and costs of paths. All values are chosen."""

        margin_m: Positive = PREFERRED_MARGIN_M
        """Distance kept from obstacles beyond the robot's radius, except on narrow paths."""
        snap_m: Positive = 0.8
        """Greatest distance of a path's ends from the robot and from the goal, if the robot cannot stand there."""
        unknown: Literal["avoid", "dear", "free"] = "avoid"
        """Unknown floor: not driven on; at `unknown_cost` times the cost of known floor; or as if it were known."""
        unknown_cost: Annotated[float, Meta(ge=1)] = 4.0

    interface = PlannerInterface
    parameters: Parameters

    def init(self) -> None:
        self._grids: dict[bool, tuple[NavigationGrid, int]] = {}
        """By `is_narrow`: the grid with the preferred clearance and the one with narrow places; made when needed.

        Each with the version of the map that it shows.
        """

    def activate(self) -> None:
        self._radius_m = self.env.use("driver", DriverInterface).radius_m()

    def plan(
        self,
        view: MapCells,
        start: Point2D,
        goal: Point2D,
        avoid: Sequence[Circle],
        dear: Sequence[Swath] = (),
        *,
        is_narrow: bool = False,
        keeps_right: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand."""
        grid, out = self.grid(view, is_narrow=is_narrow), self.leave_zone(view, start)
        begin, snap_m = out[-1] if out else start, self.parameters.snap_m
        path = grid.path(begin, goal, snap_m=snap_m, avoid=avoid, dear=dear, keeps_right=keeps_right)
        return None if path is None else out + path

    def leave_zone(
        self,
        view: MapCells,
        start: Point2D,
        area: ReservedArea | None = None,
        avoid: Sequence[Circle] = (),
        *,
        to_rest: bool = False,
    ) -> list[Point2D]:
        """Waypoints of the shortest way out of keep-out zones, or an area; none if there is none."""
        zones, snap_m = view.zones, self.parameters.snap_m
        if zones is None or view.seen is None:
            return []
        is_shut = zones.shuts(start, beside=to_rest)
        if area is None and not is_shut and not (to_rest and zones.forbids_rest(start)):
            return []
        seen = self._make(view, view.seen if is_shut else view.classes, is_narrow=True)
        begin = seen.snap(start, snap_m, avoid)
        if begin is None:
            return []
        costs = distance_field(seen.without(avoid), seen.cost, np.array([begin], np.int64))
        is_out = self.grid(view).traversable
        if to_rest:
            is_out = is_out & ~zones.no_rest
        if area is not None:
            reach_m = self._radius_m + LEFT_M
            away_m = clearance_m(area.cells(view.geometry), view.geometry.resolution_m, reach_m)
            is_out = is_out & (away_m >= reach_m)
        costs = np.where(is_out, costs, np.inf)
        row, column = divmod(int(costs.argmin()), costs.shape[1])
        if not np.isfinite(costs[row, column]):
            return []
        return seen.path(start, seen.geometry.center_of(row, column), snap_m=snap_m, avoid=avoid) or []

    def escape(
        self,
        view: MapCells,
        start: Point2D,
        speed_m_s: float,
        tracks: Sequence[Track],
        apart_m: float,
        *,
        is_late: bool = False,
        is_narrow: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints to the nearest place clear of all tracks with right of way."""
        grid = self.grid(view, is_narrow=is_narrow)
        cell = grid.snap(start, self.parameters.snap_m)
        if cell is None:
            return None
        no_rest = None if view.zones is None else view.zones.no_rest
        cells = escape_cells(
            grid.traversable, grid.geometry, cell, speed_m_s, tracks, apart_m, no_rest, is_late=is_late
        )
        return None if cells is None else grid.waypoints(cells)

    def is_narrow(self, view: MapCells, place: Point2D) -> bool:
        """Whether a place, and all within one cell of it, has less than the preferred clearance but room to squeeze."""
        near_m = view.geometry.resolution_m
        if self.grid(view).snap(place, near_m) is not None:
            return False
        return self.grid(view, is_narrow=True).snap(place, near_m) is not None  # or it is unknown or closed

    def standpoint(self, view: MapCells, place: Point2D, within_m: float, *, is_narrow: bool = False) -> Point2D | None:
        """The nearest point, within `within_m`, from which the robot can see a place; None if there is none."""
        grid = self.grid(view, is_narrow=is_narrow)
        reach = round(within_m / grid.geometry.resolution_m)
        cell = standpoint(view.classes, grid.traversable, grid.geometry.cell_of(place.x_m, place.y_m), reach)
        return None if cell is None else grid.geometry.center_of(*cell)

    def safe_positions(self, view: MapCells, positions: Floats, *, is_narrow: bool = False) -> int:
        """Number of `positions` (N, 2) on a path before the first that is too near to a known obstacle."""
        grid, _ = self._grids.get(is_narrow) or (self.grid(view, is_narrow=is_narrow), 0)
        return grid.clear_positions(view.classes, positions)

    def grid(self, view: MapCells, *, is_narrow: bool = False) -> NavigationGrid:
        """Where the robot can stand with its preferred clearance, or in narrow places, and what paths cost there."""
        grid, version = self._grids.get(is_narrow, (None, 0))
        if grid is None or grid.geometry != view.geometry or grid.zones is not view.zones:
            grid = self._make(view, view.classes, is_narrow=is_narrow, zones=view.zones)
        elif version != view.version:
            grid.update(view.classes)
        self._grids[is_narrow] = grid, view.version
        return grid

    def _make(
        self, view: MapCells, classes: NDArray[np.int8], *, is_narrow: bool, zones: ZoneGrid | None = None
    ) -> NavigationGrid:
        unknown_cost = {"avoid": None, "dear": self.parameters.unknown_cost, "free": 1.0}[self.parameters.unknown]
        preferred_m = self._radius_m + self.parameters.margin_m
        least_m = min(preferred_m, mapped_clearance_m(self._radius_m, view.geometry.resolution_m))
        needed_m = least_m if is_narrow else preferred_m
        return NavigationGrid(classes, view.geometry, needed_m, unknown_cost, preferred_m, zones)
