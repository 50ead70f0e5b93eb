"""What a message for Foxglove says: of scans, points, grids, walls, logs, and of the entities of its scene."""

import math
from typing import Any

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model import grid_geometry as cells
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.drawing.palette import FREE, OCCUPIED, UNKNOWN
from robrain.recording.foxglove import channels as make


def scan(*ranges_mm: int, **fields: Any) -> Scan:
    told = {"robot": "r1", "angle_min_rad": 0.0, "angle_increment_rad": math.pi / 2, "range_max_m": 5.0, **fields}
    return Scan(ranges_mm=list(ranges_mm), **told)


def floats(cloud: Any) -> Any:
    assert (cloud.point_stride, [(field.name, field.offset, field.type) for field in cloud.fields]) == (
        12, [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)],
    )  # fmt: skip
    return np.frombuffer(cloud.data, np.float32).reshape(-1, 3)


def xyz(of: Any) -> tuple[float, float, float]:
    return round(of.x, 9), round(of.y, 9), round(of.z, 9)


def floor() -> OccupancyGrid:
    """Half metres from (10, 20): a free, an occupied and an unknown column, two rows."""
    grid = OccupancyGrid(GridGeometry(0.5, 10.0, 20.0, 3, 2))
    grid.merge_patch(0, 0, np.array([[cells.FREE, cells.OCCUPIED, cells.UNKNOWN]] * 2), 1)
    return grid


def test_the_hits_of_a_scan_are_points_in_the_robots_frame() -> None:
    found = make.scan_points(scan(1, 0, 2000, 3000), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("r1", 7)
    expected = [[0.001, 0.0, 0.1], [-2.0, 0.0, 0.1], [0.0, -3.0, 0.1]]
    assert floats(found) == pytest.approx(np.array(expected), abs=1e-6)
    assert xyz(found.pose.position) == (0.0, 0.0, 0.0)
    assert found.pose.orientation.w == 1.0


def test_the_map_is_a_grid_of_colours_of_which_the_unknown_is_clear() -> None:
    found = make.map_grid(floor(), 7)
    assert (found.frame_id, found.timestamp.nanos) == ("arena", 7)
    assert xyz(found.pose.position) == (10.0, 20.0, -0.01)
    assert (found.column_count, found.row_stride, found.cell_stride) == (3, 12, 4)
    assert (found.cell_size.x, found.cell_size.y) == (0.5, 0.5)
    assert [(field.name, field.offset, field.type) for field in found.fields] == [
        ("red", 0, 1), ("green", 1, 1), ("blue", 2, 1), ("alpha", 3, 1),
    ]  # fmt: skip
    drawn = np.frombuffer(found.data, np.uint8).reshape(2, 3, 4)
    assert drawn[:, 0].tolist() == [[*FREE, 255]] * 2
    assert drawn[:, 1].tolist() == [[*OCCUPIED, 255]] * 2
    assert drawn[:, 2].tolist() == [[*UNKNOWN, 0]] * 2


# -- entities of the scene --------------------------------------------------------------------------------------
