"""How far a direction is free, by lidar, range sensors and bump contacts, in numbers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from robrain.plugins.device.range_sensors import Bump, RangeRing
from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.unit.obstacle_distance import BUMPED_RAD, SQUEEZED_GAP_M, Lookout
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


def test_squeezing_robot_keeps_a_small_gap_to_what_is_ahead():
    senses = Senses()
    senses.see((0.0, 0.5))
    found = senses.lookout.passage(HERE, AHEAD_RAD)
    # A single point counts where it overlaps the hull's track by more than the lidar's noise.
    assert found.free_m == pytest.approx(0.5 - (RADIUS_M - SURE_M) - SQUEEZED_GAP_M)
    senses.hear(0.1)
    assert senses.lookout.passage(HERE, AHEAD_RAD).free_m == pytest.approx(0.1 - SQUEEZED_GAP_M)


def test_squeezing_robot_minds_a_range_sensor_only_straight_ahead():
    senses = Senses()
    senses.see((0.3, 6.0))
    senses.hear(0.0, angle_rad=math.asin(0.6))  # 0.12 m aside: within the hull's track, and no nearer to its middle
    assert senses.lookout.passage(HERE, AHEAD_RAD).free_m == math.inf
    senses.hear(0.0, angle_rad=math.asin(0.4), now_ns=2)
    assert senses.lookout.passage(HERE, AHEAD_RAD).free_m < 0.1


def test_room_on_either_side_is_told_while_the_way_ahead_is_touched():
    senses = Senses(pressed_rad=(0.0,))
    beside = [(side * math.atan2(0.25, ahead_m), math.hypot(0.25, ahead_m)) for side in (1, -1) for ahead_m in (0, 0.1)]
    senses.see(*beside, (math.pi / 2, 0.25), (-math.pi / 2, 0.25))
    found = senses.lookout.passage(HERE, AHEAD_RAD)
    assert found == pytest.approx((0.0, 0.25, 0.25))


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
    senses.lookout.feel(Bump(2, ()))
    assert senses.lookout.free_m(HERE, AHEAD_RAD + touched_rad) == math.inf


def test_robot_that_stands_at_a_wall_is_pushed_off_although_it_is_touched():
    senses = Senses(pressed_rad=(0.0, -math.pi / 2))
    senses.see((0.0, 0.205))
    x_m_s, y_m_s = senses.lookout.hold_off(HERE, (0.0, 0.0), 0.01, 1.5)
    assert (x_m_s, y_m_s) == pytest.approx((0.0, -1.5 * 0.005))


def test_lidar_that_is_frozen_is_doubted_and_one_that_is_silent_blinds():
    senses = Senses()
    assert senses.lookout.check(1) == "there has been no fresh scan"
    assert senses.doubts == []
    senses.lookout._obstacles.is_frozen = True
    assert senses.lookout.check(1) == "the lidar has been frozen"
    assert senses.doubts == ["the lidar is frozen: its ranges stay equal to the millimetre while the robot moves"]
