"""What the planner offers."""

from collections.abc import Sequence
from typing import Protocol

from robrain.algorithms.navigation.navigation_grid import Zone
from robrain.algorithms.navigation.right_of_way import Track
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.skill.mapper.interface import MapView
from robrain.protocol.model.geometry import Point2D

Circle = tuple[float, float, float]
"""x, y, radius: metres, arena frame."""


class PlannerInterface(Protocol):
    """Shortest safe paths, arena frame."""

    def plan(
        self,
        view: MapView,
        start: Point2D,
        goal: Point2D,
        avoid: Sequence[Circle],
        dear: Sequence[Zone] = (),
        *,
        is_narrow: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints from start to as near to goal as the robot can stand; None if there is no way.

        The path avoids circles, and zones unless the way around is much longer. With `is_narrow` it may lead through
        places with less than the preferred clearance, down to what a robot can squeeze through by the map; the driver
        finds out on the spot whether it fits.
        """

    def escape(
        self,
        view: MapView,
        start: Point2D,
        speed_m_s: float,
        tracks: Sequence[Track],
        apart_m: float,
        *,
        is_narrow: bool = False,
    ) -> list[Point2D] | None:
        """Waypoints to the nearest place clear of all tracks with right of way; None if there is none."""

    def is_narrow(self, view: MapView, place: Point2D) -> bool:
        """Whether a place, and all within one cell of it, has less than the preferred clearance but room to squeeze."""

    def standpoint(self, view: MapView, place: Point2D, within_m: float, *, is_narrow: bool = False) -> Point2D | None:
        """The nearest point, within `within_m`, from which the robot can see a place; None if there is none."""

    def safe_positions(self, view: MapView, positions: Floats, *, is_narrow: bool = False) -> int:
        """How many of `positions` (N, 2) on a path precede the first that is too near to a known obstacle."""
