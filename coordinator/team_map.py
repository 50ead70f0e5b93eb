"""The team's map: the robots' patches, merged."""

import logging

from robrain.protocol.model.occupancy_grid import GridGeometry, OccupancyGrid
from robrain.protocol.wire.map_patch import MAX_CELLS, geometry_of, merge_message
from robrain.protocol.wire.messages import MapPatch

logger = logging.getLogger(__name__)


class TeamMap:
    """What the team knows of the floor. The first patch says which grid the team maps on."""

    def __init__(self) -> None:
        self.grid: OccupancyGrid | None = None
        self._refused: set[str] = set()

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        return 0 if self.grid is None else self.grid.version

    @property
    def known_area_m2(self) -> float:
        """Area of what is known, walls included."""
        return 0.0 if self.grid is None else self.grid.known_count * self.grid.geometry.resolution_m**2

    def merge(self, patch: MapPatch) -> None:
        """Take a robot's patch in; one that does not fit is refused and logged once a robot."""
        try:
            grid = self.grid if self.grid is not None else OccupancyGrid(_affordable(geometry_of(patch)))
            merge_message(grid, patch)
            self.grid = grid  # not before: a first patch that is broken must not say which grid it is
        except ValueError as error:
            if patch.robot not in self._refused:
                self._refused.add(patch.robot)
                logger.warning("the map of %s cannot be merged: %s", patch.robot, error)


def _affordable(geometry: GridGeometry) -> GridGeometry:
    if geometry.width * geometry.height > MAX_CELLS:
        raise ValueError(f"expected a grid of at most {MAX_CELLS} cells, got {geometry.width} x {geometry.height}")
    return geometry
