import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from robrain.algorithms.localization.scan_match import beam_ends
from robrain.algorithms.slam.robots_in_scan import MARGIN_M, REACH_M, robot_circles, sees_through, wall_ends
from robrain.protocol.model.geometry import Pose2D
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, NOBODY, RANGE_M, LidarFloor

RADIUS_M = 0.2
WALLS = (
    (0.0, 0.0, 12.0, 0.2),
    (0.0, 7.8, 12.0, 8.0),
    (0.0, 0.0, 0.2, 8.0),
    (11.8, 0.0, 12.0, 8.0),
)
HALL = LidarFloor(*WALLS)
SENSOR = Pose2D(5.0, 4.0, 0.4)


def circle(x_m, y_m, radius_m=RADIUS_M):
    return np.array([(x_m, y_m, radius_m)])


def circles_for(told, ranges_m, sensor=SENSOR):
    return robot_circles(ANGLES_RAD, ranges_m, RANGE_M, sensor, told)


def left_of(circles, ranges_m, sensor=SENSOR):
    """(n, 2) ends of beams, arena frame, that are taken for walls."""
    points = wall_ends(ANGLES_RAD, ranges_m, RANGE_M, sensor, circles)
    cos, sin = math.cos(sensor.yaw_rad), math.sin(sensor.yaw_rad)
    return np.column_stack(
        (sensor.x_m + cos * points[:, 0] - sin * points[:, 1], sensor.y_m + sin * points[:, 0] + cos * points[:, 1])
    )


def nearest_m(points, x_m, y_m):
    return float(np.hypot(points[:, 0] - x_m, points[:, 1] - y_m).min())


def test_without_mates_every_beam_counts():
    ranges_m = HALL.ranges_m(SENSOR)
    circles = circles_for(NOBODY, ranges_m)
    assert circles.shape == (0, 3)
    assert len(left_of(circles, ranges_m)) == len(beam_ends(ANGLES_RAD, ranges_m, RANGE_M))


@settings(deadline=None, max_examples=60)
@given(bearing_rad=st.floats(-2.7, 2.7), away_m=st.floats(0.6, 2.4))
def test_a_mate_where_it_says_is_no_wall(bearing_rad, away_m):
    x_m = SENSOR.x_m + away_m * math.cos(SENSOR.yaw_rad + bearing_rad)
    y_m = SENSOR.y_m + away_m * math.sin(SENSOR.yaw_rad + bearing_rad)
    ranges_m = HALL.ranges_m(SENSOR, circle(x_m, y_m))
    left = left_of(circles_for(circle(x_m, y_m), ranges_m), ranges_m)
    assert nearest_m(left, x_m, y_m) > RADIUS_M + MARGIN_M
    assert len(left) > 150


@settings(deadline=None, max_examples=60)
@given(
    bearing_rad=st.floats(-2.7, 2.7), away_m=st.floats(0.8, 2.4), off_m=st.floats(0.3, 0.7), to_rad=st.floats(-3.1, 3.1)
)
def test_a_mate_that_is_not_quite_where_it_says_is_known_by_its_shape(bearing_rad, away_m, off_m, to_rad):
    x_m = SENSOR.x_m + away_m * math.cos(SENSOR.yaw_rad + bearing_rad)
    y_m = SENSOR.y_m + away_m * math.sin(SENSOR.yaw_rad + bearing_rad)
    ranges_m = HALL.ranges_m(SENSOR, circle(x_m, y_m))
    told = circle(x_m + off_m * math.cos(to_rad), y_m + off_m * math.sin(to_rad))
    circles = circles_for(told, ranges_m)
    assert len(circles) == 2
    assert circles[1] == pytest.approx((x_m, y_m, RADIUS_M + MARGIN_M), abs=0.08)
    assert nearest_m(left_of(circles, ranges_m), x_m, y_m) > RADIUS_M + 0.05


def test_a_pillar_of_a_mates_size_far_from_the_mate_stays_a_wall():
    pillar = (6.5, 4.0)
    ranges_m = HALL.ranges_m(SENSOR, circle(*pillar))
    circles = circles_for(circle(pillar[0], pillar[1] + REACH_M + 0.2), ranges_m)
    assert len(circles) == 1
    assert nearest_m(left_of(circles, ranges_m), *pillar) < RADIUS_M + 0.05


def test_of_two_round_things_the_one_nearer_to_the_place_told_is_the_mate():
    mate, pillar = (6.5, 4.6), (6.5, 3.4)
    both = np.array([(*mate, RADIUS_M), (*pillar, RADIUS_M)])
    ranges_m = HALL.ranges_m(SENSOR, both)
    circles = circles_for(circle(6.5, 4.2), ranges_m)
    left = left_of(circles, ranges_m)
    assert nearest_m(left, *mate) > RADIUS_M + 0.05
    assert nearest_m(left, *pillar) < RADIUS_M + 0.05


@pytest.mark.parametrize(
    "box",
    [
        (6.2, 3.4, 6.3, 4.6),  # a board, wider than the mate
        (6.3, 3.95, 6.4, 4.05),  # a post, much thinner
        (6.2, 2.0, 6.9, 7.8),  # a wall that goes on
    ],
)
def test_what_is_not_round_or_not_of_the_mates_size_stays_a_wall(box):
    floor = LidarFloor(*WALLS, box)
    ranges_m = floor.ranges_m(SENSOR)
    circles = circles_for(circle(6.4, 4.9), ranges_m)
    assert len(circles) == 1


def test_a_mate_of_whom_only_an_edge_is_seen_behind_a_corner_is_not_guessed_at():
    floor = LidarFloor(*WALLS, (5.8, 3.0, 6.0, 4.3))
    mate = (6.6, 4.45)
    ranges_m = floor.ranges_m(Pose2D(5.0, 4.0, 0.0), circle(*mate))
    assert len(circles_for(circle(6.6, 5.0), ranges_m, Pose2D(5.0, 4.0, 0.0))) == 1


def test_a_mate_out_of_the_lidars_reach_takes_no_circle():
    ranges_m = HALL.ranges_m(SENSOR)
    far = np.array([(SENSOR.x_m + RANGE_M + REACH_M + RADIUS_M + 0.1, SENSOR.y_m, RADIUS_M), (6.0, 4.0, RADIUS_M)])
    assert circles_for(far, ranges_m)[:, :2].tolist() == [[6.0, 4.0]]


def test_beams_that_returned_nothing_are_no_edges_of_a_mate():
    """In the open, where only the mate returns anything."""
    nothing = LidarFloor()
    ranges_m = nothing.ranges_m(SENSOR, circle(6.5, 4.0))
    for none in (RANGE_M, math.inf):
        seen_m = np.where(ranges_m >= RANGE_M, none, ranges_m)
        circles = circles_for(circle(6.5, 4.4), seen_m)
        assert len(circles) == 2
        assert circles[1, :2] == pytest.approx((6.5, 4.0), abs=0.08)


def front(sensor, mate):
    """Bearings and ranges of a lidar that looks ahead only, over a third of a turn."""
    ahead = np.abs(ANGLES_RAD) < math.pi / 3
    return ANGLES_RAD[ahead], HALL.ranges_m(sensor, mate)[ahead]


@pytest.mark.parametrize("bearing_rad", [0.0, 0.7, -0.7])
def test_a_lidar_that_looks_ahead_knows_a_mate_that_it_sees_as_a_whole(bearing_rad):
    mate = SENSOR.compose(Pose2D(1.2 * math.cos(bearing_rad), 1.2 * math.sin(bearing_rad), 0.0))
    angles_rad, ranges_m = front(SENSOR, circle(mate.x_m, mate.y_m))
    circles = robot_circles(angles_rad, ranges_m, RANGE_M, SENSOR, circle(mate.x_m + 0.4, mate.y_m))
    assert len(circles) == 2
    assert circles[1] == pytest.approx((mate.x_m, mate.y_m, RADIUS_M + MARGIN_M), abs=0.05)


def test_each_of_several_mates_has_its_circles():
    mates = np.array([(6.5, 4.6, 0.2), (3.5, 3.4, 0.2), (5.0, 5.5, 0.3)])
    ranges_m = HALL.ranges_m(SENSOR, mates)
    told = mates + np.array((0.3, 0.0, 0.0))
    found = circles_for(told, ranges_m)
    assert found[::2] == pytest.approx(told + np.array((0.0, 0.0, MARGIN_M)))
    assert found[1::2] == pytest.approx(mates + np.array((0.0, 0.0, MARGIN_M)), abs=0.08)


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_points_in_circles_of_the_arena_are_left_out_wherever_the_sensor_is(seed):
    rng = np.random.default_rng(seed)
    sensor = Pose2D(*rng.uniform(-3.0, 3.0, 3).tolist())
    points, circles = rng.uniform(-4.0, 4.0, (50, 2)), rng.uniform((-4.0, -4.0, 0.2), (4.0, 4.0, 2.0), (4, 3))
    kept = []
    for point in points.tolist():
        at = sensor.compose(Pose2D(*point, 0.0))
        if all(math.dist((at.x_m, at.y_m), one[:2]) > one[2] for one in circles.tolist()):
            kept.append(point)
    angles_rad, ranges_m = np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1])
    left = wall_ends(angles_rad, ranges_m, 10.0, sensor, circles)
    np.testing.assert_allclose(left, np.array(kept).reshape(-1, 2), atol=1e-12)


def test_beams_that_hit_nothing_have_no_ends_and_arrays_that_do_not_fit_are_refused():
    ranges_m = np.array([1.0, RANGE_M, np.inf, np.nan, 0.0, -1.0])
    angles_rad = np.zeros(6)
    assert wall_ends(angles_rad, ranges_m, RANGE_M, SENSOR, NOBODY).tolist() == [[1.0, 0.0]]
    with pytest.raises(ValueError, match="angles and ranges"):
        wall_ends(angles_rad[1:], ranges_m, RANGE_M, SENSOR, NOBODY)


def goes_through(told, ranges_m, sensor=SENSOR):
    return sees_through(ANGLES_RAD, ranges_m, RANGE_M, sensor, told)


@settings(deadline=None, max_examples=60)
@given(bearing_rad=st.floats(-math.pi, math.pi), away_m=st.floats(0.8, 2.4), yaw_rad=st.floats(-math.pi, math.pi))
@example(bearing_rad=0.0, away_m=1.0, yaw_rad=-5e-324)
def test_a_place_that_beams_go_through_is_that_of_no_mate(bearing_rad, away_m, yaw_rad):
    sensor = Pose2D(SENSOR.x_m, SENSOR.y_m, yaw_rad)
    x_m, y_m = sensor.x_m + away_m * math.cos(bearing_rad), sensor.y_m + away_m * math.sin(bearing_rad)
    assert goes_through(circle(x_m, y_m), HALL.ranges_m(sensor), sensor)
    assert not goes_through(circle(x_m, y_m), HALL.ranges_m(sensor, circle(x_m, y_m)), sensor)


@settings(deadline=None, max_examples=40)
@given(bearing_rad=st.floats(-math.pi, math.pi), off_m=st.floats(0.0, 0.45), off_rad=st.floats(-math.pi, math.pi))
def test_a_mate_that_has_moved_a_little_since_it_told_is_where_it_says(bearing_rad, off_m, off_rad):
    told = circle(SENSOR.x_m + 2.0 * math.cos(bearing_rad), SENSOR.y_m + 2.0 * math.sin(bearing_rad))
    (x_m, y_m, _) = told[0]
    along_m = off_m * math.cos(off_rad)
    stands = circle(x_m + along_m * math.cos(bearing_rad), y_m + along_m * math.sin(bearing_rad))
    assert not goes_through(told, HALL.ranges_m(SENSOR, stands))


def test_what_is_hidden_is_not_seen_through():
    told = circle(5.0, 6.0)
    assert goes_through(told, HALL.ranges_m(SENSOR))
    assert not goes_through(told, HALL.ranges_m(SENSOR, circle(5.0, 5.0, 0.4))), "another robot stands before it"
    assert not goes_through(circle(5.0, 7.6), HALL.ranges_m(SENSOR)), "a wall is just behind it"
    assert not goes_through(circle(5.0, 9.0), HALL.ranges_m(SENSOR)), "it is behind a wall"


@pytest.mark.parametrize(
    ("away_m", "is_seen"),
    [(0.5, False), (0.69, False), (0.71, True), (3.0, True), (5.4, True), (5.6, False), (7.0, False)],
)
def test_places_that_are_too_near_or_beyond_the_lidars_range_say_nothing(away_m, is_seen):
    nothing = LidarFloor()
    assert goes_through(circle(SENSOR.x_m + away_m, SENSOR.y_m), nothing.ranges_m(SENSOR)) == is_seen


def test_half_of_the_beams_in_the_middle_have_to_go_through():
    """A mate that is hit on one side of its middle is there."""
    ranges_m = HALL.ranges_m(SENSOR)
    told = circle(SENSOR.x_m + 2.0, SENSOR.y_m)
    bearings_rad = np.abs(np.remainder(ANGLES_RAD + SENSOR.yaw_rad + math.pi, math.tau) - math.pi)
    for beam in np.flatnonzero(bearings_rad < 0.5 * RADIUS_M / 2.0):
        hit = ranges_m.copy()
        hit[beam] = 1.9
        assert not goes_through(told, hit)
    hit = ranges_m.copy()
    hit[bearings_rad > 0.5 * RADIUS_M / 2.0] = 1.9
    assert goes_through(told, hit)


@pytest.mark.parametrize(("told_m", "circles"), [(5.9, 2), (6.05, 2), (6.95, 1), (7.05, 0)])
def test_a_mate_that_may_be_within_the_lidars_range_is_looked_for(told_m, circles):
    """It stands 5.4 m away. One that says to be farther than it could be seen, even if it erred, is not asked about."""
    sensor = Pose2D(2.0, 4.0, 0.0)
    ranges_m = HALL.ranges_m(sensor, circle(2.0 + 5.4, 4.0))
    found = circles_for(circle(2.0 + told_m, 4.3), ranges_m, sensor)
    assert len(found) == circles
    if circles == 2:
        assert found[1] == pytest.approx((7.4, 4.0, RADIUS_M + MARGIN_M), abs=0.12)
