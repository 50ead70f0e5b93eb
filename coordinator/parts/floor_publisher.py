"""Publishes the floor that was known before the run."""

import logging
from typing import TYPE_CHECKING

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.protocol.messages.maps.map_messages import FLOOR, ROBOT_MAP, MapPatch

if TYPE_CHECKING:  # loads kernels
    from robrain.algorithms.slam.floor_map import FloorMap

logger = logging.getLogger(__name__)


class FloorPublisher(CoordinatorPart):
    """Publishes a known floor on the grid of the first robot that maps, and again whenever robots appear.

    Args:
        core: the team.
        floor: the floor.

    """

    def __init__(self, core: Core, floor: "FloorMap") -> None:
        super().__init__(core)
        self._floor: FloorMap | None = floor
        self._patch: MapPatch | None = None
        self._publisher = core.wire.publisher(ROBOT_MAP, robot=FLOOR)
        self._present: set[str] = set()
        """Robots for which it has been published."""

    def check(self, now_ns: int) -> None:
        """Publish the floor if a robot may not have received it."""
        seen = self.core.team_map.seen
        if seen is None:
            return
        if self._floor is not None:
            from robrain.algorithms.slam.floor_map import floor_patch

            self._patch, self._floor = floor_patch(self._floor, seen.geometry), None
            if self._patch is None:
                logger.warning("the known floor lies outside the grid on which the robots map, %s", seen.geometry)
        present = {name for name, robot in self.core.roster.robots.items() if robot.has_token}
        if self._patch is not None and present - self._present:
            self._publisher.put(self._patch)
        self._present = present
