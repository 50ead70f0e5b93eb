"""A known floor on a team's grid."""

import numpy as np
import pytest

from robrain.algorithms.slam.floor_map import FloorMap, floor_of_cells, floor_patch
from robrain.algorithms.slam.map_patch import merge_message
from robrain.algorithms.slam.submap_atlas import SubmapAtlas
from robrain.protocol.messages.maps.map_messages import FLOOR
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

SIZE_M = 30.0
"""Of a square room with a wall in the middle, whose image has no margin."""


def room(resolution_m: float) -> FloorMap:
    cells = round(SIZE_M / resolution_m)
    classes = np.full((cells, cells), FREE)
    classes[:, cells // 2 : cells // 2 + round(0.8 / resolution_m)] = OCCUPIED
    classes[: cells // 4, : cells // 4] = UNKNOWN
    return floor_of_cells(GridGeometry(resolution_m, 0.0, 0.0, cells, cells), classes)


def composed(floor: FloorMap, team: GridGeometry) -> SubmapAtlas:
    patch, atlas = floor_patch(floor, team), SubmapAtlas(team)
    assert patch is not None
    merge_message(atlas, patch)
    return atlas


@pytest.mark.parametrize("resolution_m", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("offset_m", [0.0, 0.03])
def test_floor_is_drawn_on_any_grid_with_its_walls_as_robots_see_them(resolution_m: float, offset_m: float) -> None:
    team = GridGeometry(0.1, -0.5 - offset_m, -0.5 - offset_m, 312, 312)
    atlas = composed(room(resolution_m), team)
    classes = atlas.grid.classes()

    def kind(x_m: float, y_m: float) -> int:
        return int(classes[team.cell_of(x_m, y_m)])

    assert kind(20.0, 20.0) == kind(1.0, 20.0) == FREE
    assert kind(1.0, 1.0) == UNKNOWN
    assert kind(15.04, 20.0) == kind(15.79, 20.0) == OCCUPIED
    assert kind(15.4, 20.0) == UNKNOWN  # no robot sees the inside of a wall
    assert kind(30.03, 20.0) == kind(20.0, -0.01) == OCCUPIED  # all beyond the image is wall
    assert kind(30.4, 20.0) == UNKNOWN
    for (robot, _), submap in atlas.submaps.items():
        assert robot == FLOOR
        assert submap.surfaces is not None
        x_m = team.origin_x_m + (submap.surfaces["column"] + 0.5 + submap.surfaces["right"] / 64) * 0.1
        off_m = np.minimum(abs(x_m - 15.0), abs(x_m - 15.8))
        assert off_m.max(initial=0.0) <= 0.5 * resolution_m + 0.002
    assert len(atlas.submaps) > 1
    assert sum(len(submap.surfaces) for submap in atlas.submaps.values() if submap.surfaces is not None) > 250


def test_floor_outside_the_grid_is_no_patch() -> None:
    assert floor_patch(room(0.1), GridGeometry(0.1, 100.0, 0.0, 50, 50)) is None
