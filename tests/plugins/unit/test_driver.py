import itertools
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.plugins.unit.driver.interface import Motion
from robrain.protocol.model.geometry import Point2D, Pose2D


def driver(host):
    return host.manager.get("driver").plugin


def drive(host, *places):
    """Send a robot along these places, arena frame."""
    localisation = host.manager.get("localisation").plugin
    driver(host).follow(localisation.to_odom([Point2D(*place) for place in places]))


def stands(one):
    return one.call("driver", "motion") == Motion.STANDING


def off_path_m(pose, corners):
    """Distance of a pose from a line through these corners."""
    best = math.inf
    for (ax, ay), (bx, by) in itertools.pairwise(corners):
        length = math.hypot(bx - ax, by - ay)
        share = max(0.0, min(1.0, ((pose.x_m - ax) * (bx - ax) + (pose.y_m - ay) * (by - ay)) / length**2))
        best = min(best, math.hypot(pose.x_m - ax - share * (bx - ax), pose.y_m - ay - share * (by - ay)))
    return best


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -3.0])
def test_a_robot_arrives_at_the_end_of_its_path_within_a_tenth_of_a_metre(stage, room, yaw_rad):
    one = stage(room(6.0, 4.0), r1=Pose2D(1.0, 1.0, yaw_rad))
    host = one.host("localisation")
    one.run(0.4)
    drive(host, (4.5, 1.0), (4.5, 3.0))
    one.run_until(lambda: stands(one), 30.0)
    one.run(0.5)
    assert one.truth().pose.distance_m(Point2D(4.5, 3.0)) < 0.1
    assert one.truth().collisions == 0


def test_on_the_way_it_keeps_to_the_path(stage, room):
    one = stage(room(6.0, 4.0), r1=Pose2D(1.0, 1.0, 0.0))
    host = one.host("localisation")
    one.run(0.4)
    corners = [(1.0, 1.0), (4.5, 1.0), (4.5, 3.0), (2.0, 3.0)]
    drive(host, *corners[1:])
    aside_m = []
    one.run(20.0, lambda: aside_m.append(off_path_m(one.truth().pose, corners)))
    assert one.truth().pose.distance_m(Point2D(2.0, 3.0)) < 0.1
    # Corners are rounded off by up to a quarter of a metre.
    assert max(aside_m) < 0.25
    assert np.median(aside_m) < 0.1


@pytest.mark.slow
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.6, 5.4), st.floats(0.6, 3.4)), min_size=1, max_size=3))
def test_whatever_the_path_its_end_is_reached_without_touching_a_wall(stage, room, places):
    one = stage(room(6.0, 4.0), r1=Pose2D(3.0, 2.0, 0.0))
    host = one.host("localisation")
    one.run(0.4)
    drive(host, *places)
    one.run_until(lambda: stands(one), 60.0)
    one.run(0.5)
    assert one.truth().pose.distance_m(Point2D(*places[-1])) < 0.1
    assert one.truth().collisions == 0
    one.hosts.remove(host)
    host.close()


def test_a_wall_across_the_path_is_stopped_at_and_not_touched(stage, room):
    one = stage(room(6.0, 4.0, (3.0, 0.0, 3.2, 4.0)), r1=Pose2D(1.0, 2.0, 0.0))
    host = one.host("localisation")
    one.run(0.4)
    drive(host, (5.0, 2.0))
    one.run(10.0)
    gap_m = 3.0 - one.truth().pose.x_m - 0.2
    assert one.truth().collisions == 0
    assert 0.02 < gap_m < 0.3
    assert one.call("driver", "motion") == Motion.BLOCKED
    assert driver(host).blocked_s() > 3.0


def test_a_halted_robot_stands_and_does_not_drive_on_when_it_is_resumed(stage, room):
    one = stage(room(), r1=Pose2D(1.0, 2.0, 0.0))
    host = one.host("localisation")
    one.run(0.4)
    drive(host, (3.0, 2.0))
    one.run(1.0)
    one.halt()
    one.run(1.0)
    before = one.truth().pose
    one.halt(halted=False)
    one.run(2.0)
    assert one.truth().pose == before
