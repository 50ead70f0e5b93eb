import itertools
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation.navigation_grid import NavigationGrid, Zone
from robrain.plugins.skill.mapper.mapper import MapView
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

RESOLUTION_M = 0.1
GEOMETRY = GridGeometry(RESOLUTION_M, -1.0, -2.0, 60, 40)
NEEDED_M = 0.28
START, GOAL = Point2D(0.0, 0.0), Point2D(4.0, 0.0)


def view(version=1, fill=FREE):
    classes = np.full(GEOMETRY.shape, fill, np.int8)
    classes[[0, -1], :] = OCCUPIED
    classes[:, [0, -1]] = OCCUPIED
    return MapView(version, GEOMETRY, classes)


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


def length_m(start, path):
    return sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in itertools.pairwise([start, *path]))


def clearance_m(one, path, start=START):
    """The least distance of a path from the middle of an occupied cell."""
    rows, columns = np.nonzero(one.classes == OCCUPIED)
    x_m = GEOMETRY.origin_x_m + (columns + 0.5) * RESOLUTION_M
    y_m = GEOMETRY.origin_y_m + (rows + 0.5) * RESOLUTION_M
    return min(float(np.hypot(x_m - x, y_m - y).min()) for x, y in sampled(start, path))


def test_on_open_floor_the_path_is_straight(planner):
    path = planner.plan(view(), START, GOAL, [])
    assert math.hypot(path[-1].x_m - GOAL.x_m, path[-1].y_m - GOAL.y_m) < RESOLUTION_M
    assert length_m(START, path) == pytest.approx(4.0, abs=0.15)


def test_a_path_leads_around_a_wall_and_keeps_its_distance(planner):
    one = view()
    draw(one, 1.9, -2.0, 2.1, 1.0, OCCUPIED)
    path = planner.plan(one, START, GOAL, [])
    assert length_m(START, path) > 4.4
    assert clearance_m(one, path) > NEEDED_M - 0.5 * RESOLUTION_M


def test_a_gap_that_is_too_narrow_is_no_way(planner):
    one = view()
    draw(one, 1.9, -2.0, 2.1, 2.0, OCCUPIED)
    draw(one, 1.9, -0.2, 2.1, 0.2, FREE)
    assert planner.plan(one, START, GOAL, []) is None


def test_nothing_leads_through_unknown_floor(planner):
    one = view()
    draw(one, 1.5, -2.0, 2.5, 2.0, UNKNOWN)
    assert planner.plan(one, START, GOAL, []) is None


def test_a_goal_in_a_wall_is_approached_as_near_as_the_robot_can_stand(planner):
    one = view()
    draw(one, 3.9, -0.2, 4.3, 0.2, OCCUPIED)
    path = planner.plan(one, START, GOAL, [])
    assert 0.2 < math.hypot(path[-1].x_m - GOAL.x_m, path[-1].y_m - GOAL.y_m) <= 0.8
    assert clearance_m(one, path) > NEEDED_M - 0.5 * RESOLUTION_M


def test_a_goal_far_from_any_place_to_stand_has_no_path(planner):
    one = view()
    draw(one, 2.5, -2.0, 5.0, 2.0, OCCUPIED)
    assert planner.plan(one, START, GOAL, []) is None


def test_circles_are_not_driven_through(planner):
    path = planner.plan(view(), START, GOAL, [(2.0, 0.1, 0.6)])
    assert min(math.hypot(x - 2.0, y - 0.1) for x, y in sampled(START, path)) > 0.6 - RESOLUTION_M


def test_a_new_version_of_the_map_is_looked_at(planner):
    assert planner.plan(view(1), START, GOAL, [])
    changed = view(2)
    draw(changed, 1.9, -2.0, 2.1, 2.0, OCCUPIED)
    assert planner.plan(changed, START, GOAL, []) is None


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


@pytest.mark.parametrize("name", ["margin_m", "snap_m"])
def test_a_planner_with_a_size_that_is_none_is_left_out_with_the_reason(stage, name):
    one = stage()
    one.host("planner", planner={name: 0.0})
    assert f"expected {name} > 0, got 0.0" in one.infos()["planner"].why


@pytest.mark.parametrize(("unknown", "is_straight"), [("free", True), ("dear", False)])
def test_unknown_floor_may_be_driven_on_if_the_manifest_says_so(stage, unknown, is_straight):
    """A strip of unknown floor lies across the way; around it, it is 1.3 m farther."""
    one = view()
    draw(one, 1.0, -1.0, 3.0, 1.0, UNKNOWN)
    host = stage().host("planner", planner={"unknown": unknown, "unknown_cost": 10.0})
    path = host.manager.get("planner").plugin.plan(one, START, GOAL, [])
    assert (length_m(START, path) < 4.2) == is_straight


def test_the_radius_is_that_of_the_driver(stage):
    one = view()
    draw(one, 1.9, -2.0, 2.1, 2.0, OCCUPIED)
    draw(one, 1.9, -0.4, 2.1, 0.4, FREE)
    for radius_m, has_way in ((0.2, True), (0.35, False)):
        host = stage().host("planner", mocdevice={"radius_m": radius_m})
        path = host.manager.get("planner").plugin.plan(one, START, GOAL, [])
        assert (path is not None) == has_way


def test_zones_are_left_to_others_where_there_is_room(planner):
    zone = Zone(np.array([(x, 0.0) for x in np.arange(0.5, 3.6, 0.1)]), 0.5)
    path = planner.plan(view(), START, GOAL, [], [zone])
    assert max(abs(point.y_m) for point in path) > 0.4
    narrow = view()
    draw(narrow, 1.0, -2.0, 3.0, -0.4, OCCUPIED)
    draw(narrow, 1.0, 0.4, 3.0, 2.0, OCCUPIED)
    assert planner.plan(narrow, START, GOAL, [], [zone])


def test_a_wall_that_turns_up_on_the_way_is_noticed_before_the_map_is_planned_on_again(planner):
    positions = np.array([(x, 0.0) for x in np.arange(0.0, 4.0, 0.1)])
    planner.plan(view(1), START, GOAL, [])
    assert planner.safe_positions(view(1), positions) == len(positions)
    changed = view(2)
    draw(changed, 1.9, -0.5, 2.1, 0.5, OCCUPIED)
    safe = planner.safe_positions(changed, positions)
    assert 1.4 < positions[safe - 1][0] < 1.8


def test_in_a_corridor_the_path_keeps_to_its_middle(planner):
    one = view()
    draw(one, 0.5, -2.0, 3.5, -0.3, OCCUPIED)
    draw(one, 0.5, 0.3, 3.5, 2.0, OCCUPIED)
    path = planner.plan(one, START, GOAL, [])
    rows = np.flatnonzero(one.classes[:, GEOMETRY.cell_of(2.0, 0.0)[1]] == FREE)
    middle_m = GEOMETRY.origin_y_m + (rows.mean() + 0.5) * RESOLUTION_M
    assert all(abs(y - middle_m) < 0.03 for x, y in sampled(START, path) if 0.8 < x < 3.2)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(
        st.lists(
            st.tuples(
                st.integers(0, 59), st.integers(0, 39), st.integers(1, 6), st.sampled_from([FREE, OCCUPIED, UNKNOWN])
            ),
            max_size=3,
        ),
        min_size=1,
        max_size=4,
    )
)
def test_looking_only_where_the_map_has_changed_is_as_good_as_looking_everywhere(changes):
    classes = view().classes
    grid = NavigationGrid(classes, GEOMETRY, NEEDED_M)
    for boxes in changes:
        classes = classes.copy()
        for column, row, size, kind in boxes:
            classes[row : row + size, column : column + size] = kind
        grid.update(classes)
        fresh = NavigationGrid(classes, GEOMETRY, NEEDED_M)
        assert np.array_equal(grid.traversable, fresh.traversable)
        assert np.array_equal(grid.cost, fresh.cost)
