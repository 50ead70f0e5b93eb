"""How far a direction is free, by lidar, range sensors and bump contacts, in numbers."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest

from robrain.algorithms.navigation import obstacles
from robrain.plugins.device.range_sensors import Bump, RangeRing
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.unit import obstacle_distance
from robrain.plugins.unit.obstacle_distance import (
    BUMPED_RAD,
    FROZEN_M,
    FROZEN_RAD,
    RING_FRESH_NS,
    SCAN_FRESH_NS,
    LidarMonitor,
    Lookout,
    ObstaclePoints,
    ring_points_m,
    scan_points_m,
)
from robrain.protocol.can.frames import codec
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.model.geometry import Pose2D

RADIUS_M, STOP_M, SURE_M = 0.2, 0.08, 0.03
HERE = Pose2D(1.0, 2.0, math.pi / 2)
AHEAD_RAD = HERE.yaw_rad


class Senses:
    """The devices of a robot at `HERE`: its lidar and range sensors say what the test puts into them."""

    def __init__(self, pressed_rad=()):
        self.doubts = []
        self.scan = self.ring = None
        moc = SimpleNamespace(pose_at=lambda stamp_ns: HERE, radius_m=lambda: RADIUS_M)
        lidar = SimpleNamespace(latest=lambda: self.scan, doubt=self.doubts.append)
        ranges = SimpleNamespace(latest=lambda: self.ring, pressed_rad=lambda: pressed_rad)
        self.lookout = Lookout(moc, lidar, ranges, STOP_M)

    def see(self, *hits, now_ns=1):
        """The lidar hits something in these directions, robot's frame, at these distances."""
        angles_rad, ranges_m = np.array(hits).reshape(-1, 2).T
        self.scan = LaserScan(now_ns, tuple(angles_rad.tolist()), tuple(ranges_m.tolist()), 6.0)
        return self.lookout.check(now_ns)

    def hear(self, range_m, angle_rad=0.0, now_ns=1):
        self.ring = RangeRing(now_ns, (angle_rad,), (range_m,), 2.55, RADIUS_M)
        return self.lookout.check(now_ns)


@pytest.mark.parametrize("angle_rad", [0.0, 1.0, -2.0, math.pi])
def test_free_way_ends_the_stop_distance_before_what_the_lidar_sees(angle_rad):
    senses = Senses()
    assert senses.see((angle_rad, 0.5)) == ""
    assert senses.lookout.free_m(HERE, AHEAD_RAD + angle_rad) == pytest.approx(0.5 - RADIUS_M - STOP_M)
    assert senses.lookout.free_m(HERE, AHEAD_RAD + angle_rad + math.pi / 2) == math.inf


def test_nearer_one_of_lidar_and_range_sensor_counts():
    senses = Senses()
    senses.see((0.0, 0.9))
    senses.hear(0.3)
    assert senses.lookout.free_m(HERE, AHEAD_RAD) == pytest.approx(0.3 - STOP_M)
    senses.see((0.0, 0.4), now_ns=2)
    assert senses.lookout.free_m(HERE, AHEAD_RAD) == pytest.approx(0.2 - STOP_M)


@pytest.mark.parametrize("touched_rad", [0.0, 2.0, -3.0])
def test_robot_goes_nowhere_near_a_touched_direction_until_it_is_released(touched_rad):
    senses = Senses()
    senses.see((0.0, 6.0))
    senses.lookout.feel(Bump(1, (touched_rad,)))
    for aside_rad, is_free in ((0.0, False), (0.99, False), (-0.99, False), (1.01, True), (-1.01, True)):
        heading_rad = AHEAD_RAD + touched_rad + aside_rad * BUMPED_RAD
        velocity_m_s = (0.3 * math.cos(heading_rad), 0.3 * math.sin(heading_rad))
        expected_m = math.inf if is_free else 0.0
        assert senses.lookout.free_m(HERE, heading_rad) == expected_m
        assert senses.lookout.passage(HERE, heading_rad).free_m == expected_m
        assert senses.lookout.hold_off(HERE, velocity_m_s, 0.01, 1.5) == (velocity_m_s if is_free else (0.0, 0.0))
    senses.lookout.feel(Bump(2, (0.0,)))
    assert senses.lookout.free_m(Pose2D(0.0, 0.0, 0.0), BUMPED_RAD) == math.inf
    senses.lookout.feel(Bump(3, ()))
    assert senses.lookout.free_m(HERE, AHEAD_RAD + touched_rad) == math.inf


def test_lidar_that_is_frozen_is_doubted_and_one_that_is_silent_blinds():
    senses = Senses()
    assert senses.lookout.check(1) == "there has been no fresh scan"
    assert senses.doubts == []
    senses.lookout._obstacles.is_frozen = True
    assert senses.lookout.check(1) == "the lidar has been frozen"
    assert senses.doubts == ["the lidar is frozen: its ranges stay equal to the millimetre while the robot moves"]


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


FAR = [0.0] * 180
"""A lidar that hits nothing."""


@pytest.fixture
def robot(stage):
    """A robot whose sensors say what the test has them say."""
    one = stage()
    one.host("obstacle_distance")
    bus, count = one.bus(), itertools.count()

    def ring(*ranges_m):
        values = {f"range_{sensor}_m": range_m for sensor, range_m in enumerate(ranges_m, 1)}
        bus.send(codec("RangeRing1").pack(next(count), **values))

    one.ring = ring
    return one


def scan_with(direction_deg, range_m):
    ranges_m = list(FAR)
    ranges_m[round((direction_deg + 180) / 2) % 180] = range_m
    return ranges_m


def test_before_any_sensor_has_spoken_nothing_is_known(robot):
    robot.run(0.5)
    view = robot.call("obstacle_distance", "view")
    assert view == {"distances_m": [None] * 12, "sees": [], "nearest_m": None, "nearest_rad": None, "touched_rad": []}


def test_of_two_sensors_the_nearer_counts(robot):
    robot.scan(scan_with(0, 1.0))
    robot.ring(0.4, 2.55, 2.55, 0.9, 2.55, 2.55)
    robot.run(0.1)
    view = robot.call("obstacle_distance", "view", 6)
    assert view["distances_m"] == [0.4, None, None, 0.9, None, None]
    assert view["sees"] == ["scan", "range_sensors"]


@pytest.mark.parametrize("sectors", [0, -1, 361])
def test_a_number_of_sectors_that_is_none_is_refused(robot, sectors):
    with pytest.raises(CallError, match="expected 1 to 360 sectors") as refusal:
        robot.call("obstacle_distance", "view", sectors)
    assert refusal.value.code is ErrorCode.BAD_ARGUMENTS
