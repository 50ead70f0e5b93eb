import math

import pytest

from robrain.plugins.device.ros2.ros2_base import read_odometry
from robrain.plugins.device.ros2.topic_device import BadMessage
from robrain.protocol.model.geometry import Pose2D, Twist2D
from tests.plugins.device.ros2.ros_words import odometry

PLACE = Pose2D(1.0, -2.0, 0.5)


def test_place_yaw_velocity_and_stamp_are_those_of_the_message():
    stamp_ns, told = read_odometry(odometry(PLACE, Twist2D(0.3, 0.1, -0.2), stamp_ns=12_345_678_901))
    assert stamp_ns == 12_345_678_901
    assert told.velocity == Twist2D(0.3, 0.1, -0.2)
    assert (told.pose.x_m, told.pose.y_m) == (1.0, -2.0)
    assert told.pose.yaw_rad == pytest.approx(0.5)


def test_a_robot_on_a_ramp_has_the_yaw_that_is_seen_from_above():
    message = odometry(PLACE)
    half = math.radians(5.0)
    # Yaw of 90°, then 10° of pitch about its own y axis.
    orientation = message.pose.pose.orientation
    cos, sin = math.cos(math.pi / 4), math.sin(math.pi / 4)
    orientation.w, orientation.x = cos * math.cos(half), -sin * math.sin(half)
    orientation.y, orientation.z = cos * math.sin(half), sin * math.cos(half)
    assert read_odometry(message)[1].pose.yaw_rad == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30])
@pytest.mark.parametrize(
    "where",
    [
        lambda message: (message.pose.pose.position, "x"),
        lambda message: (message.pose.pose.position, "y"),
        lambda message: (message.pose.pose.orientation, "z"),
        lambda message: (message.pose.pose.orientation, "w"),
        lambda message: (message.twist.twist.linear, "x"),
        lambda message: (message.twist.twist.linear, "y"),
        lambda message: (message.twist.twist.angular, "z"),
    ],
)
def test_a_number_that_cannot_be_is_refused_wherever_it_is(where, value):
    message = odometry(PLACE)
    part, name = where(message)
    setattr(part, name, value)
    with pytest.raises(BadMessage, match="expected"):
        read_odometry(message)


def test_a_message_whose_orientation_was_never_set_is_refused():
    message = odometry(PLACE)
    message.pose.pose.orientation.w = message.pose.pose.orientation.z = 0.0
    with pytest.raises(BadMessage, match="quaternion of length 1"):
        read_odometry(message)
