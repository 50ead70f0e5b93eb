"""Zones on the cells of a map."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.mapping.zone_grid import ZoneGrid, cells_in
from robrain.algorithms.navigation.separation import Separation
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry
from robrain.protocol.model.zone import Zone, ZoneKind, check_zones

GEOMETRY = GridGeometry(0.25, -3.0, -2.0, 24, 16)
SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0))


def keep_out(name="shut", corners_m=SQUARE):
    return Zone(name=name, kind=ZoneKind.KEEP_OUT, corners_m=corners_m)


def slow(speed_m_s, corners_m=SQUARE):
    return Zone(name=f"slow{speed_m_s}", kind=ZoneKind.SPEED_LIMIT, corners_m=corners_m, speed_m_s=speed_m_s)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"kind": ZoneKind.SPEED_LIMIT}, "zone z: expected speed_m_s with kind = 'speed_limit'"),
        ({"kind": ZoneKind.KEEP_OUT, "cost_m": 2.0}, "zone z: expected no cost_m"),
        ({"kind": ZoneKind.DIRECTED}, "zone z: expected direction_rad with kind = 'one_way'"),
        ({"kind": ZoneKind.KEEP_OUT, "corners_m": ((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))}, "expected corners_m around"),
    ],
)
def test_a_zone_that_makes_no_sense_is_refused(fields, expected):
    with pytest.raises(ValueError, match=expected):
        Zone(**{"name": "z", "corners_m": SQUARE, **fields})


def test_each_zone_needs_a_name_of_its_own():
    with pytest.raises(ValueError, match="got shut twice"):
        check_zones([keep_out(), keep_out()])


def test_a_concave_zone_does_not_hold_its_notch():
    zone = keep_out(corners_m=((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 1.0), (0.0, 4.0)))
    assert zone.holds(Point2D(0.5, 2.0))
    assert zone.holds(Point2D(3.5, 2.0))
    assert not zone.holds(Point2D(2.0, 2.0))
    assert zone.area_m2 == 10.0


@given(st.lists(st.tuples(st.floats(-4.0, 4.0), st.floats(-3.0, 3.0)), min_size=3, max_size=7))
def test_a_cell_is_in_a_zone_if_the_zone_holds_its_centre(corners):
    try:
        zone = keep_out(corners_m=tuple(corners))
    except ValueError:
        return
    inside = cells_in(zone, GEOMETRY)
    for row, column in np.ndindex(inside.shape):
        assert inside[row, column] == zone.holds(GEOMETRY.center_of(row, column))


@pytest.mark.parametrize("tiny", [2.2e-313, 5e-324, 1e-300])
def test_a_side_that_is_almost_level_is_on_both_sides_of_no_place(tiny):
    zone = keep_out(corners_m=((0.0, 1.0), (0.0, tiny), (1.0, 0.0)))
    inside = cells_in(zone, GEOMETRY)
    for row, column in np.ndindex(inside.shape):
        assert inside[row, column] == zone.holds(GEOMETRY.center_of(row, column))
    assert inside.any()


def test_a_side_that_is_passed_twice_does_not_count():
    """Two squares with a bridge between them, the second with a hole."""
    near, far = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), ((1.5, -1.5), (2.5, -1.5), (2.5, 1.5), (1.5, 1.5))
    hole = ((1.75, -0.5), (1.75, 0.5), (2.25, 0.5), (2.25, -0.5))
    zone = keep_out(corners_m=(*near, near[0], *far, far[0], *hole, hole[0], far[0], near[0]))
    assert len(zone.sides) == 12
    assert zone.area_m2 == pytest.approx(1.0 + 3.0 - 0.5)
    held = [zone.holds(Point2D(x_m, 0.25)) for x_m in (0.5, 1.25, 1.6, 2.0, 2.4, 2.6)]
    assert held == [True, False, True, False, True, False]


def test_a_robot_waits_before_a_zone_without_stopping():
    quick = Zone(name="quick", kind=ZoneKind.NO_STOPPING, corners_m=SQUARE)
    grid = ZoneGrid([quick], GEOMETRY)
    ahead = np.array([(x_m, 0.5) for x_m in (-0.5, -0.3, 0.3, 0.9, 1.5, 2.4)])
    assert [grid.waits_at(ahead[:count]) for count in (2, 3, 5, 6)] == [2, 2, 2, 6]
    assert grid.waits_at(ahead[2:4]) == 2  # it is inside, so it drives on
    assert grid.forbids_rest(Point2D(1.0, 0.5))
    assert not grid.shuts(Point2D(1.0, 0.5))


def test_limits_delay_from_a_metre_before_their_zone():
    grid = ZoneGrid([slow(0.1, ((0.0, -2.0), (1.0, -2.0), (1.0, 2.0), (0.0, 2.0)))], GEOMETRY)
    ahead = np.array([(-2.5 + 0.1 * k, 0.0) for k in range(50)])
    assert grid.delay_s(ahead, 0.1, 0.5) == pytest.approx(2.0 / 0.1 - 2.0 / 0.5, rel=0.1)
    assert grid.delay_s(ahead[40:], 0.1, 0.5) == 0.0


def test_the_lowest_limit_on_the_way_counts():
    grid = ZoneGrid([slow(0.4), slow(0.2, ((1.0, 0.0), (2.0, 0.0), (2.0, 1.0)))], GEOMETRY)
    assert grid.fastest_m_s(np.array([(-1.0, 0.5), (0.3, 0.5)])) == 0.4
    assert grid.fastest_m_s(np.array([(0.3, 0.5), (1.9, 0.3)])) == 0.2
    assert grid.fastest_m_s(np.array([(-1.0, 0.5), (90.0, 0.5)])) == math.inf


def test_keep_out_zones_are_occupied_and_penalties_cost():
    avoid = Zone(name="avoid", kind=ZoneKind.PENALTY, corners_m=SQUARE, cost_m=3.0)
    grid = ZoneGrid([keep_out(), avoid], GEOMETRY)
    classes = grid.close(np.full(GEOMETRY.shape, FREE, np.int8))
    assert (classes[cells_in(avoid, GEOMETRY)] == OCCUPIED).all()
    assert grid.surcharge.sum() == 3.0 * (classes == OCCUPIED).sum() > 0
    assert grid.shuts(Point2D(1.0, 0.5))
    assert not grid.shuts(Point2D(1.0, 1.5))


HALL = GridGeometry(0.1, 0.0, 0.0, 100, 30)
"""10 m × 3 m."""


def bar(name, x0, x1, y1=3.0):
    return keep_out(name, ((x0, 0.0), (x1, 0.0), (x1, y1), (x0, y1)))


def separates(*zones, place=(9.0, 1.5), robot=(1.0, 1.5)):
    classes = np.full(HALL.shape, FREE, np.int8)
    return Separation(classes, HALL, zones, [Point2D(*robot)], 0.2).zones_before(Point2D(*place), 0.8)


def test_the_zones_that_separate_a_place_from_all_robots_are_named():
    assert separates(bar("a", 3.0, 4.0, 2.0)) == []
    assert separates(bar("a", 3.0, 4.0), bar("b", 6.0, 7.0, 2.0)) == ["a"]
    assert separates(bar("a", 3.0, 4.0), bar("b", 6.0, 7.0)) == ["a", "b"]
    assert separates(bar("a", 3.0, 4.0), robot=(8.0, 1.0)) == []
    assert separates(bar("a", 3.0, 4.0), robot=(3.5, 1.0)) == []


def test_a_door_is_free_where_its_leaf_was_seen_and_closed_while_it_does_not_open():
    door = Zone(name="gate", kind=ZoneKind.DOOR, corners_m=SQUARE)
    shut = Zone(name="gate", kind=ZoneKind.DOOR, corners_m=SQUARE, is_shut=True)
    inside = cells_in(door, GEOMETRY)
    seen = np.full(GEOMETRY.shape, OCCUPIED, np.int8)
    assert (ZoneGrid([door], GEOMETRY).close(seen)[inside] == FREE).all()
    assert (ZoneGrid([door], GEOMETRY).close(seen)[~inside] == OCCUPIED).all()
    assert (ZoneGrid([shut], GEOMETRY).close(np.zeros_like(seen))[inside] == OCCUPIED).all()
    with pytest.raises(ValueError, match="expected corners_m around an area"):
        Zone(name="gate", kind=ZoneKind.PLACE, corners_m=SQUARE[:1], is_shut=True)
