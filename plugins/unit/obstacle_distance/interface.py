"""What obstacle distance offers."""

from typing import Protocol

import msgspec


class ObstacleView(msgspec.Struct, frozen=True, kw_only=True):
    """The nearest obstacle in each direction, from the robot's hull.

    Sector 0 is centred on straight ahead, the others follow counter-clockwise. A distance is in metres; null means that
    nothing is seen there. Without any fresh sensor there is no distance at all, and `sees` is empty.
    """

    distances_m: list[float | None]
    sees: list[str]
    """The sensors that are fresh and in it: `scan`, `range_sensors`."""
    nearest_m: float | None = None
    nearest_rad: float | None = None
    """Middle of the sector of the nearest, robot's frame."""
    touched_rad: list[float] = []
    """Where a bump contact is pressed, robot's frame."""


class ObstacleDistanceInterface(Protocol):
    """Distances when asked for."""

    def view(self, sectors: int = 12) -> ObstacleView:
        """The nearest obstacle in each of this many sectors, by sensors with recent data."""
