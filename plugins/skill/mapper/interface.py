"""What the mapper offers."""

from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import UNKNOWN, GridGeometry


class MapView(msgspec.Struct, frozen=True, eq=False):
    """The map at one moment: (H, W) classes of `OccupancyGrid`, row 0 at the lowest y, arena frame."""

    version: int
    geometry: GridGeometry
    classes: NDArray[np.int8]

    def is_unexplored(self, place: Point2D) -> bool:
        """Whether a place, arena frame, lies within the map's borders and has not been seen."""
        row, column = self.geometry.cell_of(place.x_m, place.y_m)
        return self.geometry.contains(row, column) and bool(self.classes[row, column] == UNKNOWN)


class MapperCounters(msgspec.Struct, frozen=True, kw_only=True):
    """What became of what the mapper was told."""

    scans: int
    """Put into the map."""
    scans_left_out: int
    """Left out because the robot did not know well enough where it was."""
    why_left_out: str
    """Why they are left out now; empty if they are not."""
    patches_dropped: int
    """Patches of others that came faster than they could be merged."""
    submaps: int
    """Number of submaps of the map."""
    closures: int
    """Number of scans that matched a submap of another robot, or an old one of this robot: loop closures."""
    contradictions: int
    """Number of scans that contradicted a submap that covers the place."""


class MapperInterface(Protocol):
    """The map that the robot and its team have made."""

    def view(self) -> MapView:
        """The map as it is now; do not write to it."""
