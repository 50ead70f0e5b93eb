"""Choose the submap that a scan is matched against next, to find a loop closure."""

import math

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.slam.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.model.slam.submap_graph import SubmapGraph

OCCUPIED_MIN = 60
"""Least number of occupied cells of a submap: fewer do not determine a pose."""
TRIED_APART_M = 0.7
"""Metres that the robot moves before the same submap is tried again."""
TRIED_MAX = 4096
"""Number of submaps whose last attempt is remembered."""
INSIDE_M = 1.5
"""Least distance of the sensor from the edge of a submap's box, metres."""


class ClosureSearch:
    """Chooses submaps that cover the robot's place, one after the other.

    Args:
        robot: name of this robot.
        graph: its part of the pose graph.
        atlas: all submaps that it knows.

    """

    def __init__(self, robot: str, graph: SubmapGraph, atlas: SubmapAtlas) -> None:
        self._robot = robot
        self._graph = graph
        self._atlas = atlas
        self._tried: dict[SubmapKey, Pose2D] = {}
        """Pose of the sensor when a submap was tried last, arena frame."""

    def candidate(self, sensor: Pose2D) -> SubmapKey | None:
        """The submap to try next from this pose of the sensor, arena frame; None if there is none."""
        best, best_at = None, math.inf
        recent = self._recent()
        for key, submap in self._atlas.submaps.items():
            if key in recent or submap.frame != self._atlas.frame:
                continue
            if submap.surfaces is None or submap.occupied < OCCUPIED_MIN:
                continue
            tried = self._tried.get(key)
            if tried is not None and tried.distance_m(sensor) < TRIED_APART_M:
                continue
            place = submap.T_arena_local.inverse().compose(sensor)
            if not self._is_inside(key, place):
                continue
            # Submaps that were never tried come first, then the one that was tried farthest from here.
            at = -math.inf if tried is None else -tried.distance_m(sensor)
            if at < best_at or best is None:
                best, best_at = key, at
        if best is not None:
            self._tried[best] = sensor
            if len(self._tried) > TRIED_MAX:
                del self._tried[next(iter(self._tried))]
        return best

    def forget(self) -> None:
        """Forget all attempts, because the robot may be anywhere now."""
        self._tried.clear()

    def _recent(self) -> set[SubmapKey]:
        """The current submap and the one before: localisation matches scans against them already."""
        return {(self._robot, number) for number in list(self._graph.own)[-2:]}

    def _is_inside(self, key: SubmapKey, place: Pose2D) -> bool:
        submap, geometry = self._atlas.submaps[key], self._atlas.grid.geometry
        inside = INSIDE_M / geometry.resolution_m
        row, column = geometry.cell_of(place.x_m, place.y_m)
        height, width = submap.evidence.shape
        at_row, at_column = row - submap.row, column - submap.column
        return bool(inside <= at_row <= height - inside and inside <= at_column <= width - inside)
