"""What the lidar offers."""

from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.agent.event import Event


class LaserScan(msgspec.Struct, frozen=True, eq=False):
    """One turn of the lidar, in the robot's frame; the sensor sits at the robot's centre.

    `angles_rad` and `ranges_m` are (N,); a range of `range_max_m` means that nothing was hit.
    """

    stamp_ns: int
    angles_rad: NDArray[np.float64]
    ranges_m: NDArray[np.float64]
    range_max_m: float


class ScanInterface(Protocol):
    """Scans as they come."""

    scanned: Event[LaserScan]

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""

    def doubt(self, why: str) -> None:
        """Say that the last scan cannot be true: the lidar is at fault until it sends another."""
