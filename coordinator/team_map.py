"""The team's map: the robots' patches, merged."""

import logging
from collections import deque
from typing import TYPE_CHECKING

from robrain.protocol.wire.messages import MapPatch

if TYPE_CHECKING:
    from robrain.protocol.model.occupancy_grid import OccupancyGrid

logger = logging.getLogger(__name__)

HELD_PATCHES = 16384
"""As many as wait in the coordinator's inbox."""


class TeamMap:
    """What the team knows of the floor. The first patch says which grid the team maps on."""

    def __init__(self) -> None:
        self.grid: OccupancyGrid | None = None
        self.dropped = 0
        """Patches that were too many to be held."""
        self._held: deque[MapPatch] | None = None
        self._refused: set[str] = set()

    @property
    def version(self) -> int:
        """Grows whenever the class of a cell changes; 0 while nothing is known."""
        return 0 if self.grid is None else self.grid.version

    @property
    def known_area_m2(self) -> float:
        """Area of what is known, walls included."""
        return 0.0 if self.grid is None else self.grid.known_count * self.grid.geometry.resolution_m**2

    def hold(self) -> None:
        """Take nothing in until `release`: patches wait, the last 16384 of them."""
        self._held = deque(maxlen=HELD_PATCHES)

    def release(self) -> None:
        """Take in what was held, and from now on whatever comes."""
        held, self._held = self._held, None
        for patch in held or ():
            self.merge(patch)
        if self.dropped:
            logger.warning("%d patches of the map were too many to be held, and are missing", self.dropped)

    def merge(self, patch: MapPatch) -> None:
        """Take a robot's patch in; one that does not fit is refused and logged once a robot."""
        if self._held is not None:
            self.dropped += len(self._held) == HELD_PATCHES
            self._held.append(patch)
            return
        # Here: they bring the map's kernels, which a coordinator loads when it is up (coordinator/live.py).
        from robrain.protocol.model.occupancy_grid import OccupancyGrid
        from robrain.protocol.wire.map_patch import MAX_CELLS, geometry_of, merge_message

        try:
            grid = self.grid
            if grid is None:
                geometry = geometry_of(patch)
                cells = geometry.width * geometry.height
                if cells > MAX_CELLS:
                    size = f"{geometry.width} x {geometry.height}"
                    raise ValueError(f"expected a grid of at most {MAX_CELLS} cells, got {size}")
                grid = OccupancyGrid(geometry)
            merge_message(grid, patch)
            self.grid = grid  # not before: a first patch that is broken must not say which grid it is
        except ValueError as error:
            if patch.robot not in self._refused:
                self._refused.add(patch.robot)
                logger.warning("the map of %s cannot be merged: %s", patch.robot, error)
