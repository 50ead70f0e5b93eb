"""Edge cases of paths and ramps."""

import itertools
import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robrain.plugins.unit.driver.driver import PERIOD_S
from robrain.plugins.unit.driver.path import CORNER_M, Path, Ramp, RampLimits, speed_to_stop
from robrain.protocol.model.geometry import Point2D, Pose2D

AT = Pose2D(0.0, 0.0, 0.0)


def test_goal_is_reached_only_when_no_corner_is_left_and_it_is_near_enough():
    path = Path([Point2D(1.0, 0.0), Point2D(0.0, 0.0)], 0.08)
    assert not path.is_at_goal(AT)
    alone = Path([Point2D(0.0, 0.0)], 0.08)
    assert alone.is_at_goal(Pose2D(0.079, 0.0, 0.0))
    assert not alone.is_at_goal(Pose2D(0.08, 0.0, 0.0))
    assert alone.is_done(Pose2D(0.0, 0.0, 3.0))
    looking = Path([Point2D(0.0, 0.0)], 0.08, 1.0, 0.01)
    assert looking.is_done(Pose2D(0.0, 0.0, 0.991))
    assert looking.is_done(Pose2D(0.0, 0.0, 1.009))
    assert not looking.is_done(Pose2D(0.0, 0.0, 0.98))
    assert not looking.is_done(Pose2D(1.0, 0.0, 1.0))


@pytest.mark.parametrize("degrees", [30.0, 90.0, -135.0, 180.0])
def test_corner_is_as_fast_as_its_angle_allows(degrees):
    turn_rad = math.radians(degrees)
    far = Point2D(0.6 + 9.0 * math.cos(turn_rad), 9.0 * math.sin(turn_rad))
    through_m_s = math.sqrt(0.8 * CORNER_M / abs(math.sin(0.5 * turn_rad)))
    expected_m_s = through_m_s + speed_to_stop(0.6 - 0.1 - CORNER_M, 0.8)
    assert Path([Point2D(0.6, 0.0), far], 0.08).speed_m_s(AT, 0.8, 0.1) == pytest.approx(expected_m_s)
    # Already at the corner, nothing is left to slow down in.
    at_corner = Path([Point2D(0.6, 0.0), far], 0.08).speed_m_s(Pose2D(0.4, 0.0, 0.0), 0.8, 0.0)
    assert at_corner == pytest.approx(through_m_s)


def test_part_of_a_ramp_along_a_direction_keeps_its_speed_and_its_acceleration():
    ramp = Ramp(RampLimits(acceleration=0.8, jerk=4.0))
    for _ in range(5):
        ramp.follow(0.5, 1.0)
    speed, ahead = 0.6 * ramp.x + 0.8 * ramp.y, ramp.ahead(0.6, 0.8)
    ramp.keep_along(0.6, 0.8, may_reverse=False)
    assert (ramp.x, ramp.y) == pytest.approx((0.6 * speed, 0.8 * speed))
    assert ramp.ahead(0.6, 0.8) == pytest.approx(ahead)


# -- ramps ------------------------------------------------------------------------------------------------------


def test_ramp_that_brakes_keeps_its_direction_ends_at_rest_and_forgets_its_acceleration():
    ramp = Ramp(RampLimits(0.8, 4.0))
    for _ in range(4):
        ramp.follow(3.0, 4.0)
    speed = ramp.speed
    ramp.brake(1.2)
    assert (ramp.x, ramp.y) == pytest.approx((0.6 * (speed - 0.072), 0.8 * (speed - 0.072)))
    assert ramp.ahead(0.6, 0.8) == pytest.approx((0.1 + 0.5 * PERIOD_S) * ramp.speed)
    for _ in range(20):
        ramp.brake(1.2)
    assert (ramp.x, ramp.y, ramp.speed) == (0.0, 0.0, 0.0)


CYCLE_S = 0.06
LIMITS = RampLimits(0.8, 4.0)
SPEEDS = st.floats(-0.6, 0.6)


@example([(0.0, 0.5, 1), (0.0, 0.0, 1)])
@given(st.lists(st.tuples(SPEEDS, SPEEDS, st.integers(1, 20)), min_size=1, max_size=6))
def test_whatever_is_wanted_acceleration_and_jerk_stay_within_their_limits(wanted):
    ramp = Ramp(LIMITS)
    speeds = [(0.0, 0.0), (0.0, 0.0)]
    for x, y, periods in wanted:
        for _ in range(periods):
            ramp.follow(x, y)
            speeds.append((ramp.x, ramp.y))
    accelerations = [((b[0] - a[0]) / CYCLE_S, (b[1] - a[1]) / CYCLE_S) for a, b in itertools.pairwise(speeds)]
    jerks = [math.hypot(b[0] - a[0], b[1] - a[1]) / CYCLE_S for a, b in itertools.pairwise(accelerations)]
    assert max(math.hypot(*each) for each in accelerations) <= LIMITS.acceleration + 1e-9
    # The last bit is taken in one step, from at most one step of acceleration: twice the jerk at the most.
    assert max(jerks) <= 2.01 * LIMITS.jerk
    # That is where a wish is reached, or given up for the next.
    assert sum(jerk > LIMITS.jerk + 1e-9 for jerk in jerks) <= len(wanted)


@given(SPEEDS, SPEEDS, SPEEDS, SPEEDS)
def test_the_wanted_velocity_is_reached_without_passing_it(x, y, to_x, to_y):
    ramp = Ramp(LIMITS)
    for _ in range(60):
        ramp.follow(x, y)
    assert (ramp.x, ramp.y) == (x, y)
    length = math.hypot(to_x - x, to_y - y)
    passed = 0.0
    for _ in range(60):
        ramp.follow(to_x, to_y)
        if length > 0.05:
            along = ((ramp.x - x) * (to_x - x) + (ramp.y - y) * (to_y - y)) / length
            passed = max(passed, along - length)
    assert (ramp.x, ramp.y) == (to_x, to_y)
    assert passed < 0.01


@example(0.0733)  # so short that the brakes are needed while it still speeds up
@given(st.floats(0.02, 5.0))
def test_who_drives_as_fast_as_the_distance_allows_stops_within_it(distance_m):
    ramp, left_m = Ramp(LIMITS), distance_m
    for _ in range(1000):
        speed = min(0.6, speed_to_stop(left_m - ramp.ahead(1.0, 0.0), LIMITS.acceleration))
        ramp.follow(speed, 0.0)
        left_m -= CYCLE_S * ramp.x
    assert -0.01 < left_m < 0.005


def velocities(one, seconds):
    """The robot's true velocity in the arena frame, and its yaw rate, each tick."""
    poses = [one.truth().pose]
    one.run(seconds, lambda: poses.append(one.truth().pose))
    return [
        ((b.x_m - a.x_m) / 0.02, (b.y_m - a.y_m) / 0.02, math.remainder(b.yaw_rad - a.yaw_rad, math.tau) / 0.02)
        for a, b in itertools.pairwise(poses)
    ]


@pytest.mark.parametrize(
    "action",
    [
        ("drive", 3.0),
        ("drive", -0.5),
        ("turn", 3.0),
        ("turn", -0.4),
        ("go_to", 2.0, 1.0, 2.0),
        ("go_to", 0.3, -1.0, -1.5),
    ],
)
def test_every_motion_keeps_the_limits_of_acceleration(stage, room, action):
    one = stage(room(6.0, 4.0), r1=Pose2D(1.0, 2.0, 0.0))
    one.host("localisation")
    one.run(0.4)
    one.call("driver", *action)
    moved = velocities(one, 10.0)
    assert one.call("driver", "motion") == "stopped"
    # The driver commands every third tick; the wheels follow within one, at the floor's 1.5 m/s².
    steps = range(0, len(moved) - 6, 3)
    linear = [math.hypot(moved[i + 3][0] - moved[i][0], moved[i + 3][1] - moved[i][1]) / 0.06 for i in steps]
    angular = [abs(moved[i + 3][2] - moved[i][2]) / 0.06 for i in steps]
    last = max(i for i, value in enumerate(linear) if value > 1e-6) if max(linear) > 1e-6 else 0
    # The stop frame at the very end, from some centimetres a second, is the floor's.
    assert max(linear[: max(1, last - 2)], default=0.0) < 0.8 * 1.35
    assert max(linear) < 1.6
    assert max(angular) < 6.1
    assert sorted(angular)[-4] < 3.0 * 1.25
