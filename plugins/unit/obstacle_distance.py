"""Obstacle distance: the nearest obstacle in each direction, by lidar and range sensors together.

It is worked out when somebody asks, so that it costs nothing otherwise. Sensors that are not fresh are left out and not
named in the answer. The robot's own motion since the measurement (some centimetres) is not made up for.
"""

import math
from functools import reduce
from typing import Protocol

import msgspec

from robrain.agent.plugin import Unit, external
from robrain.algorithms.navigation.obstacles import joined, sector_distances_m
from robrain.plugins.device.range_sensors.interface import RangeSensorsInterface
from robrain.plugins.device.scan.interface import ScanInterface
from robrain.plugins.unit.lookout import RING_FRESH_NS, SCAN_FRESH_NS, ring_points_m, scan_points_m
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.ranges import check_positive


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


SECTORS_MAX = 360
HERE = Pose2D(0.0, 0.0, 0.0)


class ObstacleDistance(Unit):
    """Finds the nearest obstacle in each direction."""

    class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
        """The robot's hull."""

        radius_m: float = 0.20

        def __post_init__(self) -> None:
            check_positive(self, "radius_m")

    interface = ObstacleDistanceInterface
    parameters: Parameters

    def activate(self) -> None:
        self._scan = self.env.use("scan", ScanInterface)
        self._ranges = self.env.use("range_sensors", RangeSensorsInterface)

    @external
    def view(self, sectors: int = 12) -> ObstacleView:
        """The nearest obstacle in each of this many sectors, by sensors with recent data."""
        if not 1 <= sectors <= SECTORS_MAX:
            raise CallError(ErrorCode.BAD_ARGUMENTS, f"view: expected 1 to {SECTORS_MAX} sectors, got {sectors}")
        now_ns = self.env.clock.now_ns()
        scan, ring = self._scan.latest(), self._ranges.latest()
        seen, sees = [], []
        if scan is not None and now_ns - scan.stamp_ns <= SCAN_FRESH_NS:
            seen.append(scan_points_m(scan, HERE))
            sees.append("scan")
        if ring is not None and now_ns - ring.stamp_ns <= RING_FRESH_NS:
            seen.append(ring_points_m(ring, None, HERE))
            sees.append("range_sensors")
        touched_rad = list(self._ranges.pressed_rad())
        if not seen:
            return ObstacleView(distances_m=[None] * sectors, sees=[], touched_rad=touched_rad)
        nearest_m = sector_distances_m(reduce(joined, seen), 0.0, 0.0, 0.0, sectors)
        distances_m = [
            round(max(0.0, distance_m - self.parameters.radius_m), 3) if math.isfinite(distance_m) else None
            for distance_m in nearest_m
        ]
        found = [(distance_m, sector) for sector, distance_m in enumerate(distances_m) if distance_m is not None]
        if not found:
            return ObstacleView(distances_m=distances_m, sees=sees, touched_rad=touched_rad)
        closest_m, sector = min(found)
        return ObstacleView(
            distances_m=distances_m,
            sees=sees,
            nearest_m=closest_m,
            nearest_rad=math.remainder(math.tau * sector / sectors, math.tau),
            touched_rad=touched_rad,
        )
