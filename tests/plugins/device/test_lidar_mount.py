"""Points of a turn become beams: each at its own angle, the nearest of a beam, in the order of their angles."""

import math

import pytest

from robrain.plugins.device.scan.interface import LaserScan
from robrain.plugins.device.scan.lidar_device import Mount, ScanMaker
from robrain.protocol.lidar.points import Point
from robrain.protocol.model.geometry import Pose2D

HERE = Pose2D(0.0, 0.0, 0.0)
BEAMS = 18
"""Of 20° each; the first looks back."""


def scan_of(*points: Point, before: tuple[Point, ...] = ()) -> LaserScan:
    return ScanMaker(BEAMS, 8.0, Mount()).scan([(HERE, points)], [(HERE, before)], 0)


def test_each_point_counts_at_its_own_angle_and_not_at_that_of_its_beam() -> None:
    angles_rad = [-3.13, -0.7, 0.01, 0.3, 1.55, 2.9]
    scan = scan_of(*[Point(angle_rad, 2.0) for angle_rad in angles_rad])
    assert scan.beam_angles_rad == pytest.approx(angles_rad)


def test_a_point_right_behind_keeps_its_angle_and_the_beams_their_order() -> None:
    scan = scan_of(Point(3.1, 2.0), Point(-1.0, 3.0))
    assert scan.beam_angles_rad == pytest.approx([3.1 - math.tau, -1.0])
    assert scan.beam_ranges_m == (2.0, 3.0)


def test_of_the_points_in_a_beam_the_nearest_counts_with_its_angle() -> None:
    scan = scan_of(Point(0.10, 3.0), Point(0.02, 1.0), Point(-0.05, 2.0))
    assert (scan.beam_angles_rad, scan.beam_ranges_m) == (pytest.approx([0.02]), (1.0,))


def test_a_beam_that_this_turn_lacks_is_that_of_the_turn_before_with_its_angle() -> None:
    scan = scan_of(Point(0.02, 1.0), before=(Point(0.04, 0.5), Point(0.72, 2.0)))
    assert scan.beam_angles_rad == pytest.approx([0.02, 0.72])
    assert scan.beam_ranges_m == (1.0, 2.0)


@pytest.mark.parametrize("range_m", [0.0, 2.0])
def test_points_of_a_robot_that_has_turned_since_are_turned_as_well(range_m: float) -> None:
    turned = Pose2D(0.0, 0.0, 0.5)
    scan = ScanMaker(BEAMS, 8.0, Mount()).scan([(turned, (Point(0.3, range_m),))], (), 0)
    assert (scan.beam_angles_rad, scan.beam_ranges_m) == (pytest.approx([0.8]), (range_m or 8.0,))
