"""Lanes over an area, and the place from which most of it is seen."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.area_coverage import (
    centres_of,
    covered_share,
    floor_of,
    lanes_over,
    ordered_lanes,
    overlook,
)
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry

GEOMETRY = GridGeometry(0.1, -1.0, -1.0, 100, 60)
HALL = [Point2D(-1.0, -1.0), Point2D(9.0, -1.0), Point2D(9.0, 5.0), Point2D(-1.0, 5.0)]
OPEN = np.ones(GEOMETRY.shape, np.bool_)


def with_block(rows, columns):
    ground = OPEN.copy()
    ground[rows, columns] = False
    return ground


def straight(start, goals):
    return [start.distance_m(goal) for goal in goals]


def xy(place):
    return np.array([place.x_m, place.y_m])


def driven(lanes):
    """Positions along lanes, (N, 2)."""
    shares = np.linspace(0.0, 1.0, 101)[:, np.newaxis]
    return np.concatenate([xy(start) + shares * (xy(end) - xy(start)) for start, end in lanes])


def test_an_open_hall_is_one_strip_of_lanes_along_its_longer_side():
    (strip,) = lanes_over(HALL, floor_of(HALL, OPEN, GEOMETRY), GEOMETRY, 0.7)
    assert len(strip) == 9  # 6 m in lanes of at most 0.7 m
    assert all(start.y_m == pytest.approx(end.y_m) for start, end in strip)
    lanes = ordered_lanes([strip], Point2D(9.0, 5.0), straight)
    assert lanes[0][0].distance_m(Point2D(9.0, 4.67)) < 0.1
    assert all(near[1].distance_m(far[0]) < 0.8 for near, far in itertools.pairwise(lanes)), "to and fro"


def test_a_block_in_a_hall_splits_the_lanes_into_four_strips():
    floor = floor_of(HALL, with_block(slice(20, 40), slice(30, 60)), GEOMETRY)
    strips = lanes_over(HALL, floor, GEOMETRY, 0.5)
    assert [len(strip) for strip in strips] == [4, 4, 4, 4]
    lanes = ordered_lanes(strips, Point2D(0.0, 0.0), straight)
    assert covered_share(floor, GEOMETRY, driven(lanes), 0.5) == 1.0


def test_a_slot_beside_a_block_that_is_narrower_than_a_lane_gets_one_lane_along_it():
    floor = floor_of(HALL, with_block(slice(0, 60), slice(2, 100)), GEOMETRY)
    assert [len(strip) for strip in lanes_over(HALL, floor, GEOMETRY, 0.9)] == [1]
    floor = floor_of(HALL, with_block(slice(0, 30), slice(2, 100)), GEOMETRY)
    lanes = [lane for strip in lanes_over(HALL, floor, GEOMETRY, 0.9) for lane in strip]
    assert len(lanes) == 5
    assert covered_share(floor, GEOMETRY, driven(lanes), 0.9) == 1.0


def test_strips_without_a_path_to_them_are_left_out():
    strips = lanes_over(HALL, floor_of(HALL, with_block(slice(0, 60), slice(50, 52)), GEOMETRY), GEOMETRY, 1.0)
    lanes = ordered_lanes(
        strips, Point2D(0.0, 0.0), lambda _, goals: [0.0 if goal.x_m < 4.0 else float("inf") for goal in goals]
    )
    assert lanes
    assert all(end.x_m < 4.0 for lane in lanes for end in lane)


@pytest.mark.slow
@given(
    corner=st.tuples(st.floats(-1.0, 5.0), st.floats(-1.0, 2.0)),
    sides_m=st.tuples(st.floats(1.5, 4.0), st.floats(1.5, 3.0)),
    block=st.tuples(st.integers(0, 40), st.integers(0, 80), st.integers(0, 20), st.integers(0, 30)),
    width_m=st.floats(0.3, 1.0),
)
def test_lanes_cover_any_box_around_a_block(corner, sides_m, block, width_m):
    (x_m, y_m), (length_m, depth_m), (row, column, rows, columns) = corner, sides_m, block
    right_m, top_m = x_m + length_m, y_m + depth_m
    area = [Point2D(x_m, y_m), Point2D(right_m, y_m), Point2D(right_m, top_m), Point2D(x_m, top_m)]
    floor = floor_of(area, with_block(slice(row, row + rows), slice(column, column + columns)), GEOMETRY)
    strips = lanes_over(area, floor, GEOMETRY, width_m)
    lanes = ordered_lanes(strips, area[0], straight)
    assert {frozenset(lane) for lane in lanes} == {frozenset(lane) for strip in strips for lane in strip}
    if lanes:
        # A corner beside a block may be smaller than half a working width.
        assert covered_share(floor, GEOMETRY, driven(lanes), width_m) > (0.8 if rows * columns else 0.99)
    else:
        assert floor.sum() * GEOMETRY.resolution_m**2 < width_m**2


def test_most_of_a_hall_is_seen_from_beside_its_block():
    ground = with_block(slice(20, 40), slice(30, 60))
    classes = np.where(ground, FREE, OCCUPIED).astype(np.int8)
    found = overlook(classes, ground, GEOMETRY, HALL, 12.0)
    assert found is not None
    place, share = found
    assert 0.7 < share < 0.95
    centres = centres_of(ground, GEOMETRY)
    seen = [
        all(
            classes[GEOMETRY.cell_of(*(xy(place) + step * (centre - xy(place))))] != OCCUPIED
            for step in np.linspace(0.0, 1.0, 60)
        )
        for centre in centres[::23]
    ]
    assert np.mean(seen) == pytest.approx(share, abs=0.06)


def test_an_area_without_known_floor_is_not_seen():
    classes = np.full(GEOMETRY.shape, OCCUPIED, np.int8)
    assert overlook(classes, OPEN, GEOMETRY, HALL, 12.0) is None


def test_a_place_beyond_the_range_of_view_sees_nothing():
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    stands = np.zeros(GEOMETRY.shape, np.bool_)
    stands[30, 0] = True
    corner = [Point2D(8.0, 1.0), Point2D(9.0, 1.0), Point2D(9.0, 2.0)]
    assert overlook(classes, stands, GEOMETRY, corner, 4.0) is None
    assert overlook(classes, stands, GEOMETRY, corner, 12.0) is not None
