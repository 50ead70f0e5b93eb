import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Point2D, Pose2D, Twist2D
from robrain.protocol.model.omni_drive import OmniBase
from robrain.protocol.wire.topics import ROBOT_STATE

BASE = OmniBase()
WHEELS = ("wheel_1_ticks", "wheel_2_ticks", "wheel_3_ticks")
COORDINATE_M = st.floats(-50.0, 50.0)


def roll(one, bus, displacement):
    """Encoder frames of a displacement (m, m, rad), in a hundred small steps."""
    turns = BASE.wheel_speeds_rad_s(displacement)
    for step in range(101):
        counts = [round(turn_rad / BASE.rad_per_tick * step / 100) % 65536 for turn_rad in turns]
        bus.send(codec("WheelEncoders").pack(step, **dict(zip(WHEELS, counts, strict=True))))
        one.run(0.02)
    one.run(0.2)


def test_a_robot_that_has_not_moved_is_where_it_started(stage):
    one = stage()
    one.host("localisation", localisation={"x_m": 3.0, "y_m": -1.0, "yaw_rad": 0.5})
    states = one.inbox(ROBOT_STATE)
    one.run(0.3)
    state = states.drain()[-1].message
    assert state.pose == Pose2D(3.0, -1.0, 0.5)
    assert state.radius_m == 0.2


def test_odometry_is_added_in_the_direction_of_the_start(stage):
    one = stage()
    one.host("localisation", localisation={"x_m": 3.0, "y_m": -1.0, "yaw_rad": math.pi / 2})
    states = one.inbox(ROBOT_STATE)
    roll(one, one.bus(), Twist2D(1.0))
    pose = states.drain()[-1].message.pose
    assert (pose.x_m, pose.y_m, pose.yaw_rad) == pytest.approx((3.0, 0.0, math.pi / 2), abs=0.005)


def test_the_velocity_of_the_state_is_that_of_the_wheels(stage):
    one = stage()
    one.host("localisation")
    states = one.inbox(ROBOT_STATE)
    roll(one, one.bus(), Twist2D(0.6, 0.2, 0.4))
    velocities = [received.message.velocity for received in states.drain()]
    driving = velocities[len(velocities) // 2]
    assert (driving.forward_m_s, driving.left_m_s, driving.yaw_rad_s) == pytest.approx((0.3, 0.1, 0.2), abs=0.03)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(x_m=COORDINATE_M, y_m=COORDINATE_M, yaw_rad=st.floats(-3.1, 3.1), point=st.tuples(COORDINATE_M, COORDINATE_M))
def test_a_point_in_the_odom_frame_is_the_same_place(stage, x_m, y_m, yaw_rad, point):
    one = stage()
    host = one.host("localisation", localisation={"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad})
    localisation = host.manager.get("localisation").plugin
    (moved,) = localisation.to_odom([Point2D(*point)])
    back = Pose2D(x_m, y_m, yaw_rad).compose(Pose2D(moved.x_m, moved.y_m, 0.0))
    assert (back.x_m, back.y_m) == pytest.approx(point, abs=1e-9)
    one.hosts.remove(host)
    host.close()
