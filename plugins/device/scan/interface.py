"""Interface of the lidar."""

from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import msgspec

from robrain.agent.event import Event

if TYPE_CHECKING:
    from robrain.algorithms.numeric.kernel_array import Floats


class LaserScan(msgspec.Struct, frozen=True, eq=False, dict=True):
    """One turn of the lidar, in the robot's frame; the sensor sits at the robot's centre."""

    stamp_ns: int
    beam_angles_rad: tuple[float, ...]
    beam_ranges_m: tuple[float, ...]
    """Of the beams, in the same order; a range of `range_max_m` means that nothing was hit."""
    range_max_m: float

    @cached_property
    def angles_rad(self) -> "Floats":
        """The angles as an array (N,). It needs robrain[navigation]."""
        return _array(self.beam_angles_rad)

    @cached_property
    def ranges_m(self) -> "Floats":
        """The ranges as an array (N,). It needs robrain[navigation]."""
        return _array(self.beam_ranges_m)


class ScanInterface(Protocol):
    """Scans as they come."""

    scanned: Event[LaserScan]

    def latest(self) -> LaserScan | None:
        """The last scan; None before the first."""

    def doubt(self, reason: str) -> None:
        """Report that the last scan cannot be true: the lidar is at fault until it sends another."""


def _array(values: tuple[float, ...]) -> "Floats":
    import numpy as np

    return np.array(values, dtype=np.float64)
