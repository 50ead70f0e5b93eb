"""What the planner offers."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from robrain.plugins.skill.mapper.interface import MapView
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.navigation import Zone
from robrain.protocol.model.right_of_way import Track

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

        Circles are not driven through; zones only if the way around is much longer. A way that is narrow leads through
        places with less than the preferred clearance where there are no others, down to what a robot can squeeze
        through; whether it really can, the driver finds out there.
        """
        ...

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
        """Waypoints to the nearest place out of the way of all tracks that go first; None if there is none."""
        ...

    def is_narrow(self, view: MapView, place: Point2D) -> bool:
        """Whether there is less than the preferred clearance at a place and next to it."""
        ...

    def standpoint(self, view: MapView, place: Point2D, within_m: float, *, is_narrow: bool = False) -> Point2D | None:
        """Where the robot can stand and see a place, as near to it as can be; None if walls hide it from there."""
        ...

    def safe_positions(self, view: MapView, positions: NDArray[np.float64], *, is_narrow: bool = False) -> int:
        """How many of positions (N, 2) on a path come before the first that is too near to a known obstacle."""
        ...
