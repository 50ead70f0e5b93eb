"""Obstacle points from lidar and range sensors, and detection of a frozen lidar."""

import math

import numpy as np
import pytest

from robrain.algorithms.navigation import obstacles
from robrain.plugins.device.range_sensors import RangeRing
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.unit import obstacle_distance
from robrain.plugins.unit.obstacle_distance import (
    FROZEN_M,
    FROZEN_RAD,
    RING_FRESH_NS,
    SCAN_FRESH_NS,
    LidarMonitor,
    ObstaclePoints,
    ring_points_m,
    scan_points_m,
)
from robrain.protocol.model.geometry import Pose2D

SEEN_FROM = Pose2D(1.0, 2.0, math.pi / 2)
BLIND, FROZEN = "there has been no fresh scan", "the lidar has been frozen"


def scan(*ranges_m, stamp_ns=1):
    angles_rad = np.arange(len(ranges_m)) * math.pi / 2
    return LaserScan(stamp_ns, tuple(angles_rad.tolist()), tuple(map(float, ranges_m)), 6.0)


def ring(*ranges_m, stamp_ns=1):
    angles_rad = tuple(index * math.pi / 2 for index in range(len(ranges_m)))
    return RangeRing(stamp_ns, angles_rad, ranges_m, 2.0, 0.2)


def points(array):
    return [(round(x, 9), round(y, 9)) for x, y in array.T.tolist()]


# -- points -----------------------------------------------------------------------------------------------------


def test_scan_hits_lie_in_their_directions_and_what_is_not_hit_is_no_point():
    assert points(scan_points_m(scan(1.0, 2.0, 6.0, 5.999), SEEN_FROM)) == [(1.0, 3.0), (-1.0, 2.0), (6.999, 2.0)]


def test_echoes_lie_on_the_sensors_axes_from_the_hull_on():
    assert points(ring_points_m(ring(0.3, 2.0, 1.999), None, SEEN_FROM)) == [(1.0, 2.5), (1.0, -0.199)]


def test_echo_that_is_missing_once_does_not_open_the_way_and_a_nearer_one_counts_at_once():
    before = ring(0.3, 0.5, 2.0)
    assert points(ring_points_m(ring(2.0, 0.1, 2.0), before, SEEN_FROM)) == [(1.0, 2.5), (0.7, 2.0)]


# -- a frozen lidar ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "frozen_after"),
    [(Pose2D(0.5 * FROZEN_M, 0.0, 0.0), 3), (Pose2D(0.0, 0.0, -0.499 * FROZEN_RAD), 3), (Pose2D(0.0, 0.0, 0.0), None)],
)
def test_lidar_whose_ranges_stay_equal_while_the_robot_moves_is_frozen(step, frozen_after):
    watch, at, found = LidarMonitor(), Pose2D(0.0, 0.0, 3.1), []
    for _ in range(6):
        found.append(watch.is_frozen(scan(1.0, 2.0), at))
        at = at.compose(step)
    # Just as far as the limit is not yet beyond it.
    assert found == [frozen_after is not None and index >= frozen_after for index in range(6)]


def test_one_range_that_differs_is_enough_and_the_motion_counts_anew_from_there():
    watch, found = LidarMonitor(), []
    for number, ranges_m in enumerate([(1.0, 2.0), (1.0, 2.0), (1.0, 2.001), (1.0, 2.001), (1.0, 2.001)]):
        found.append(watch.is_frozen(scan(*ranges_m), Pose2D(0.06 * number, 0.0, 0.0)))
    assert found == [False, False, False, False, True]


def test_lidar_that_sees_nothing_is_not_frozen():
    watch = LidarMonitor()
    assert not any(watch.is_frozen(scan(6.0, 6.0), Pose2D(float(number), 0.0, 0.0)) for number in range(5))
    assert not watch.is_frozen(scan(1.0, 6.0), Pose2D(6.0, 0.0, 0.0))
    assert watch.is_frozen(scan(1.0, 6.0), Pose2D(7.0, 0.0, 0.0))


# -- both together ----------------------------------------------------------------------------------------------


@pytest.fixture
def near():
    """Obstacle points of a robot at a given pose."""
    one = ObstaclePoints(lambda stamp_ns: Pose2D(round(stamp_ns / 1e9, 3), 0.0, 0.0))
    assert one.points_m.shape == (2, 0)
    return one


def test_before_the_first_scan_the_robot_is_blind_whatever_the_ring_hears(near):
    assert near.update(None, ring(0.3), 1) == BLIND
    assert points(near.points_m) == [(0.5, 0.0)]


def test_points_are_those_of_the_last_scan_and_the_last_ring_where_each_was_taken(near):
    later_ns = 1_500_000_000
    assert near.update(scan(3.0, stamp_ns=10**9), ring(0.3, stamp_ns=later_ns), later_ns) == ""
    assert points(near.points_m) == [(4.0, 0.0), (2.0, 0.0)]
    near.update(scan(2.0, stamp_ns=later_ns), ring(0.3, stamp_ns=later_ns), later_ns)
    assert points(near.points_m) == [(3.5, 0.0), (2.0, 0.0)]
    near.update(scan(1.0, stamp_ns=3 * 10**9), None, later_ns + RING_FRESH_NS)
    assert points(near.points_m) == [(4.0, 0.0), (2.0, 0.0)]


def test_scan_counts_for_just_so_long(near):
    assert near.update(scan(3.0), None, 1 + SCAN_FRESH_NS) == ""
    assert near.update(scan(3.0), None, 2 + SCAN_FRESH_NS) == BLIND


def test_ring_counts_for_just_so_long_and_what_it_heard_before_is_forgotten_with_it(near):
    near.update(scan(3.0), ring(0.3), 1)
    near.update(scan(3.0), ring(0.3), 1 + RING_FRESH_NS)
    assert len(points(near.points_m)) == 2
    near.update(scan(3.0), ring(0.3), 2 + RING_FRESH_NS)
    assert points(near.points_m) == [(3.0, 0.0)]
    near.update(scan(3.0), ring(2.0, stamp_ns=3), 3)
    assert points(near.points_m) == [(3.0, 0.0)]


def test_echo_that_is_missing_once_stays_and_one_that_is_missing_twice_goes(near):
    for stamp_ns, range_m, count in ((1, 0.3, 2), (2, 2.0, 2), (3, 2.0, 1)):
        near.update(scan(3.0), ring(range_m, stamp_ns=stamp_ns), stamp_ns)
        assert len(points(near.points_m)) == count


def test_frozen_lidar_is_told_as_long_as_it_sends_the_same(near):
    for second in (0, 1, 2):
        told = near.update(scan(3.0, stamp_ns=second * 10**9), None, second * 10**9)
        assert (told, near.is_frozen) == ((FROZEN, True) if second else ("", False))
    assert near.update(scan(3.0, stamp_ns=2 * 10**9), None, 2 * 10**9) == FROZEN
    assert near.update(scan(2.5, stamp_ns=3 * 10**9), None, 3 * 10**9) == ""


def test_a_robot_without_arrays_sees_the_same_points(monkeypatch):
    seen, heard = scan(1.0, 2.0, 6.0, 5.999), ring(0.3, 2.0, 1.999)
    with_arrays = scan_points_m(seen, SEEN_FROM).tolist(), ring_points_m(heard, None, SEEN_FROM).tolist()
    both = np.concatenate([np.array(each) for each in with_arrays], axis=1).tolist()
    monkeypatch.setattr(obstacle_distance, "has_arrays", lambda: False)
    monkeypatch.setattr(obstacles, "has_arrays", lambda: False)
    without = scan_points_m(seen, SEEN_FROM), ring_points_m(heard, None, SEEN_FROM)
    assert [list(map(list, each)) for each in without] == list(with_arrays)
    assert list(map(list, obstacles.joined(*without))) == both
    assert obstacles.joined(without[0], np.array(with_arrays[1])).tolist() == both  # navigation was loaded meanwhile
