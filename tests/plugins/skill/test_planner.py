import itertools
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.plugins.skill.mapper.mapper import MapCells
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry

RESOLUTION_M = 0.1
GEOMETRY = GridGeometry(RESOLUTION_M, -1.0, -2.0, 60, 40)
NEEDED_M = 0.28
START, GOAL = Point2D(0.0, 0.0), Point2D(4.0, 0.0)


def view(version=1, fill=FREE):
    classes = np.full(GEOMETRY.shape, fill, np.int8)
    classes[[0, -1], :] = OCCUPIED
    classes[:, [0, -1]] = OCCUPIED
    return MapCells(version, GEOMETRY, classes)


def draw(one, x0, y0, x1, y1, kind):
    """Cells of a box in metres, arena frame."""
    row0, column0 = GEOMETRY.cell_of(x0, y0)
    row1, column1 = GEOMETRY.cell_of(x1, y1)
    one.classes[max(row0, 0) : row1, max(column0, 0) : column1] = kind


@pytest.fixture
def planner(stage):
    return stage().host("planner").manager.get("planner").plugin


def sampled(start, path):
    """Places every 2 cm along a path."""
    points = [start, *path]
    for a, b in itertools.pairwise(points):
        steps = max(1, round(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) / 0.02))
        for share in np.linspace(0.0, 1.0, steps + 1):
            yield a.x_m + share * (b.x_m - a.x_m), a.y_m + share * (b.y_m - a.y_m)


def clearance_m(one, path, start=START):
    """The least distance of a path from the middle of an occupied cell."""
    rows, columns = np.nonzero(one.classes == OCCUPIED)
    x_m = GEOMETRY.origin_x_m + (columns + 0.5) * RESOLUTION_M
    y_m = GEOMETRY.origin_y_m + (rows + 0.5) * RESOLUTION_M
    return min(float(np.hypot(x_m - x, y_m - y).min()) for x, y in sampled(start, path))


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    blocks=st.lists(st.tuples(st.integers(4, 50), st.integers(3, 30), st.integers(1, 8), st.integers(1, 8)), max_size=6)
)
def test_no_path_ever_comes_closer_to_a_known_obstacle_than_the_robot_needs(stage, blocks):
    one = view()
    for column, row, width, height in blocks:
        one.classes[row : row + height, column : column + width] = OCCUPIED
    planner = stage().host("planner").manager.get("planner").plugin
    path = planner.plan(one, START, GOAL, [])
    if path is None:
        return
    assert clearance_m(one, path, start=path[0]) > NEEDED_M - 0.5 * RESOLUTION_M


def test_a_wall_that_turns_up_on_the_way_is_noticed_before_the_map_is_planned_on_again(planner):
    positions = np.array([(x, 0.0) for x in np.arange(0.0, 4.0, 0.1)])
    planner.plan(view(1), START, GOAL, [])
    assert planner.safe_positions(view(1), positions) == len(positions)
    changed = view(2)
    draw(changed, 1.9, -0.5, 2.1, 0.5, OCCUPIED)
    safe = planner.safe_positions(changed, positions)
    assert 1.4 < positions[safe - 1][0] < 1.8
