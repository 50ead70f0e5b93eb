"""How a lidar moved between two scans, without a map: in a room, in a corridor, with a mirrored scan."""

import math

import numpy as np
import pytest

from robrain.algorithms.localization.wheel_calibration import followed, scan_motion, still_points
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.protocol.model.geometry import Pose2D

ANGLES_RAD = np.linspace(-math.pi, math.pi, 240, endpoint=False) + 0.003
ROOM = ((-2.0, 3.0), (-1.5, 2.5))
"""x and y of its walls."""


def seen(pose: Pose2D, noise_m: float = 0.0, *, seed: int = 0, is_corridor: bool = False) -> Floats:
    """Points of a scan from `pose` in a rectangular room, sensor's frame."""
    (x_min, x_max), (y_min, y_max) = ROOM
    directions = ANGLES_RAD + pose.yaw_rad
    cos, sin = np.cos(directions), np.sin(directions)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (x_max - pose.x_m) / cos, (x_min - pose.x_m) / cos)
        to_y = np.where(sin > 0, (y_max - pose.y_m) / sin, (y_min - pose.y_m) / sin)
    ranges_m = to_y if is_corridor else np.minimum(to_x, to_y)
    angles_rad = ANGLES_RAD
    if is_corridor:
        near = ranges_m < 8.0
        ranges_m, angles_rad = ranges_m[near], angles_rad[near]
    ranges_m = ranges_m + noise_m * np.random.default_rng(seed).standard_normal(len(ranges_m))
    points: Floats = np.column_stack((ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)))
    return points


@pytest.mark.parametrize("true", [Pose2D(0.2, 0.0, 0.0), Pose2D(-0.1, 0.2, 0.25), Pose2D(0.0, 0.0, -0.3)])
def test_a_motion_is_found_to_millimetres(true: Pose2D) -> None:
    found = scan_motion(seen(Pose2D(0.0, 0.0, 0.0), 0.01), seen(true, 0.01, seed=1), Pose2D(0.0, 0.0, 0.0))
    assert found is not None
    assert found.is_held
    assert found.pose.distance_m(true) < 0.006
    assert found.pose.yaw_rad == pytest.approx(true.yaw_rad, abs=0.004)


def test_a_corridor_does_not_hold_the_motion_along_it() -> None:
    first, second = (
        seen(Pose2D(x_m, 0.0, 0.0), 0.005, seed=seed, is_corridor=True) for seed, x_m in enumerate((0, 0.1))
    )
    found = scan_motion(first, second, Pose2D(0.0, 0.0, 0.0))
    assert found is None or not found.is_held


def test_too_few_points_are_no_motion() -> None:
    points = seen(Pose2D(0.0, 0.0, 0.0))
    assert scan_motion(points[:10], points, Pose2D(0.0, 0.0, 0.0)) is None
    assert scan_motion(points, points[:10], Pose2D(0.0, 0.0, 0.0)) is None
    scattered = np.random.default_rng(3).uniform(-3, 3, (200, 2))
    assert scan_motion(scattered, points, Pose2D(0.0, 0.0, 0.0)) is None


@pytest.mark.slow
@pytest.mark.parametrize("turns", [1.0, -1.75, 2.5])
def test_a_turn_is_followed_past_half_a_turn_and_more(turns: float) -> None:
    yaws_rad = np.linspace(0.0, turns * math.tau, 100)
    scans = [seen(Pose2D(0.1 * yaw, 0.0, float(yaw)), 0.01, seed=seed) for seed, yaw in enumerate(yaws_rad)]
    way = followed(scans[0], scans[1:-1], scans[-1])
    assert way is not None
    pose, yaw_rad = way
    assert yaw_rad == pytest.approx(turns * math.tau, abs=0.01)
    assert pose.x_m == pytest.approx(0.1 * turns * math.tau, abs=0.02)


def test_a_thread_that_breaks_is_said_to_be_lost() -> None:
    scans = [seen(Pose2D(0.0, 0.0, 0.0)), seen(Pose2D(0.0, 0.0, 0.05)), np.zeros((0, 2)), seen(Pose2D(0.0, 0.0, 0.1))]
    assert followed(scans[0], scans[1:-1], scans[-1]) is None


def test_directions_that_are_mostly_silent_are_left_out_and_outliers_do_not_count() -> None:
    angles_rad = np.linspace(-math.pi, math.pi, 3, endpoint=False)
    ranges_m = [np.array([1.0, 6.0, 2.0]), np.array([1.04, 6.0, 2.0]), np.array([0.1, 3.0, 2.0])]
    points = still_points([(angles_rad, ranges) for ranges in ranges_m], 6.0)
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx([1.02, 2.0])
