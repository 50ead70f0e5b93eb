"""What the mapper tells the team of its own submaps: cells, surfaces, where they lie, and which are withdrawn."""

import numpy as np
from numpy.typing import NDArray

from robrain.plugins.skill.mapper.own_submaps import OwnPatch, OwnSubmaps
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.occupancy_grid import GridGeometry
from robrain.protocol.model.slam.submap import IDENTITY
from robrain.protocol.model.slam.submap_graph import OwnSubmap
from robrain.protocol.wire.messages.map_messages import MapPatch
from robrain.protocol.wire.messages.map_patch import joined_message, pose_message, to_message


class MapTelling:
    """Collects messages about one robot's submaps until they are sent.

    Args:
        robot: whose submaps they are.
        geometry: the team's grid.

    """

    def __init__(self, robot: str, geometry: GridGeometry) -> None:
        self._robot = robot
        self._geometry = geometry
        self._untold: list[MapPatch] = []

    def patch(self, patch: OwnPatch, own: OwnSubmaps) -> None:
        """Cells of the submap that is being made have changed."""
        place, frame = own.T_arena_local, own.frame
        self._untold.append(to_message(self._robot, self._geometry, patch.cells, patch.submap, place, frame))

    def finished(self, number: int, own: OwnSubmaps, surfaces: NDArray[np.void]) -> None:
        """A submap is finished."""
        place, frame, variances = own.T_arena_local, own.frame, _variances(own.graph.own[number])
        message = pose_message(
            self._robot, self._geometry, number, place, frame, surfaces=surfaces, variances=variances
        )
        self._untold.append(message)

    def placed(self, nodes: list[OwnSubmap]) -> None:
        """Submaps of the pose graph have moved."""
        told = []
        for node in nodes:
            place, frame = node.T_arena_local, node.frame
            told.append(
                pose_message(self._robot, self._geometry, node.number, place, frame, variances=_variances(node))
            )
        self.moved(told)

    def moved(self, messages: list[MapPatch]) -> None:
        """Submaps have moved, as these messages say."""
        if messages:
            self._untold.append(joined_message(self._robot, self._geometry, messages))

    def withdrawn(self, numbers: list[int]) -> None:
        """Submaps are wrong. What was not sent of them is not sent any more."""
        self._untold = [each for each in self._untold if each.submap not in numbers or each.parts]
        nowhere: Pose2D = IDENTITY
        self.moved([pose_message(self._robot, self._geometry, each, nowhere, withdrawn=True) for each in numbers])

    def take(self) -> list[MapPatch]:
        """Return the queued messages in order, and empty the queue."""
        untold, self._untold = self._untold, []
        return untold


def _variances(node: OwnSubmap) -> tuple[float, float]:
    return max(float(node.covariance[0, 0]), float(node.covariance[1, 1])), float(node.covariance[2, 2])
