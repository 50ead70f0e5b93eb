"""What the lidar offers."""

from typing import Protocol

import msgspec

from robrain.agent.event import Event
from robrain.protocol.model.numeric.kernel_array import Floats


class LaserScan(msgspec.Struct, frozen=True, eq=False):
    """One turn of the lidar, in the robot's frame; the sensor sits at the robot's centre.

    `angles_rad` and `ranges_m` are (N,); a range of `range_max_m` means that nothing was hit.
    """

    stamp_ns: int
    angles_rad: Floats
    ranges_m: Floats
    range_max_m: float


class ScanInterface(Protocol):
    """Scans as they come."""

    scanned: Event[LaserScan]

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""

    def doubt(self, why: str) -> None:
        """Say that the last scan cannot be true: the lidar is at fault until it sends another."""
