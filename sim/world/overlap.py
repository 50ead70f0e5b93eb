"""How much floor several robots have seen, although one would have been enough."""

from collections.abc import Mapping

import numpy as np

from robrain.algorithms.slam.submap import Submap
from robrain.protocol.model.grid_geometry import GridGeometry


def overlap(submaps: Mapping[tuple[str, int], Submap], geometry: GridGeometry) -> float:
    """Area that each robot has seen, summed over the robots, over the area that any has seen, less one.

    0: no cell was seen by two robots; 1: each cell by two on average. Cells are put where the team's map has them,
    to the nearest cell.

    Args:
        submaps: by robot and number.
        geometry: of the team's map.

    """
    seen: dict[str, np.ndarray] = {}
    for (robot, _number), submap in submaps.items():
        rows, columns = np.nonzero(submap.evidence)
        x_m = geometry.origin_x_m + (columns + submap.column + 0.5) * geometry.resolution_m
        y_m = geometry.origin_y_m + (rows + submap.row + 0.5) * geometry.resolution_m
        place = submap.T_arena_local
        cos, sin = np.cos(place.yaw_rad), np.sin(place.yaw_rad)
        at_x_m, at_y_m = place.x_m + cos * x_m - sin * y_m, place.y_m + sin * x_m + cos * y_m
        column = np.floor((at_x_m - geometry.origin_x_m) / geometry.resolution_m).astype(np.int64)
        row = np.floor((at_y_m - geometry.origin_y_m) / geometry.resolution_m).astype(np.int64)
        within = (row >= 0) & (row < geometry.height) & (column >= 0) & (column < geometry.width)
        mask = seen.setdefault(robot, np.zeros(geometry.shape, np.bool_))
        mask[row[within], column[within]] = True
    if not seen:
        return 0.0
    masks = np.array(list(seen.values()))
    any_seen = int(masks.any(axis=0).sum())
    return int(masks.sum()) / any_seen - 1.0 if any_seen else 0.0
