"""The map as a picture."""

import io
import math

import numpy as np
import pytest
from PIL import Image

from robrain.algorithms.mapping.occupancy_grid import PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.deploy.assistant.team_reader import MARGIN_M, SIDE_PX, map_png
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.model import grid_geometry
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.recording.drawing.drawn_map import ComposedMap
from robrain.recording.drawing.palette import FREE, OCCUPIED, UNKNOWN

WIDTH_M, HEIGHT_M = 12.0, 6.0
ORIGIN = (-20.0, -10.0)


@pytest.fixture(scope="module")
def floor() -> ComposedMap:
    """A free room from (0, 0) to (12, 6) with a wall one metre thick on the right, on a larger grid."""
    classes = np.full((60, 120), grid_geometry.FREE, np.int8)
    classes[:, 110:] = grid_geometry.OCCUPIED
    view = ComposedMap()
    geometry = GridGeometry(0.1, *ORIGIN, 400, 300)
    view.merge(to_message("r1", geometry, PatchCells(100, 200, classes, 1000)))
    return view


def pixel(png: bytes, x_m: float, y_m: float, bounds: tuple[float, float, float, float]) -> tuple[int, ...]:
    """The colour at a place of the arena, for a map with these bounds."""
    with Image.open(io.BytesIO(png)) as image:
        px_per_m = image.width / (bounds[2] - bounds[0] + 2 * MARGIN_M)
        at = int((x_m - bounds[0] + MARGIN_M) * px_per_m), int((bounds[3] + MARGIN_M - y_m) * px_per_m)
        found = image.convert("RGB").getpixel(at)
    assert isinstance(found, tuple)
    return found


def test_floor_walls_and_unknown_lie_where_they_are_in_the_arena(floor: ComposedMap) -> None:
    bounds = floor.known_bounds_m()
    assert bounds == pytest.approx((0.0, 0.0, WIDTH_M, HEIGHT_M))
    png = map_png(floor, [], [])
    assert pixel(png, 0.53, 0.53, bounds) == FREE
    assert pixel(png, 10.53, 5.53, bounds) == FREE
    assert pixel(png, 11.53, 0.53, bounds) == OCCUPIED
    assert pixel(png, -0.53, 3.53, bounds) == UNKNOWN
    assert pixel(png, 12.53, 3.53, bounds) == UNKNOWN
    with Image.open(io.BytesIO(png)) as image:
        assert max(image.size) == pytest.approx(min(SIDE_PX, 60 * (WIDTH_M + 2 * MARGIN_M)), abs=1)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e300])
def test_places_that_are_none_do_not_spoil_the_picture(bad: float) -> None:
    far = RobotState(robot="r\u00e4\u2603" * 100, pose=Pose2D(bad, 0.0, 0.0), radius_m=1e9)
    near = RobotState(robot="r2", pose=Pose2D(1.0, 1.0, 0.0), radius_m=0.2)
    with Image.open(io.BytesIO(map_png(ComposedMap(), [near, far], []))) as image:
        assert max(image.size) <= SIDE_PX + 1
