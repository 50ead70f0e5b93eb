"""Which submap a scan is laid on next, in search of a loop closure."""

import math

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.mapping.submap_atlas import SubmapAtlas, SubmapKey
from robrain.protocol.model.mapping.submap_graph import SubmapGraph

OCCUPIED_MIN = 60
"""A submap with fewer occupied cells holds no scan."""
TRIED_APART_M = 0.7
"""A submap is not tried again before the robot has moved so far."""
TRIED_MAX = 4096
INSIDE_M = 1.5
"""The sensor is to be so far inside a submap's box."""


class ClosureSearch:
    """Chooses submaps that should show the place where the robot is, one after the other.

    Args:
        robot: whose scans are laid.
        graph: the robot's own part of the pose graph.
        atlas: all submaps that the robot knows.

    """

    def __init__(self, robot: str, graph: SubmapGraph, atlas: SubmapAtlas) -> None:
        self._robot = robot
        self._graph = graph
        self._atlas = atlas
        self._tried: dict[SubmapKey, Pose2D] = {}
        """Where the robot was when a submap was tried last."""

    def candidate(self, sensor: Pose2D) -> SubmapKey | None:
        """The submap to try next from here (arena frame); None if there is none."""
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
            # Those never tried first; of others, the one tried farthest away.
            at = -math.inf if tried is None else -tried.distance_m(sensor)
            if at < best_at or best is None:
                best, best_at = key, at
        if best is not None:
            self._tried[best] = sensor
            if len(self._tried) > TRIED_MAX:
                del self._tried[next(iter(self._tried))]
        return best

    def forget(self) -> None:
        """The robot may be anywhere now."""
        self._tried.clear()

    def _recent(self) -> set[SubmapKey]:
        """The submap that is being made and the one before: the robot goes by them already."""
        return {(self._robot, number) for number in list(self._graph.own)[-2:]}

    def _is_inside(self, key: SubmapKey, place: Pose2D) -> bool:
        submap, geometry = self._atlas.submaps[key], self._atlas.grid.geometry
        inside = INSIDE_M / geometry.resolution_m
        row, column = geometry.cell_of(place.x_m, place.y_m)
        height, width = submap.evidence.shape
        at_row, at_column = row - submap.row, column - submap.column
        return bool(inside <= at_row <= height - inside and inside <= at_column <= width - inside)
