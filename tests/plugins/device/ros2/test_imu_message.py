import math

import pytest

from robrain.plugins.device.imu import ImuMotion
from robrain.plugins.device.ros2.ros2_imu import read_imu
from robrain.plugins.device.ros2.topic_device import BadMessage
from tests.plugins.device.ros2.ros_words import imu


def test_rate_and_acceleration_are_those_of_the_message():
    assert read_imu(imu(0.5, 1.0, -2.0, stamp_ns=7)) == (7, ImuMotion(0.5, 1.0, -2.0))


def test_what_the_unit_does_not_measure_is_left_out_or_refused():
    assert read_imu(imu(0.5, 1.0, 2.0, has_acceleration=False))[1] == ImuMotion(0.5)
    with pytest.raises(BadMessage, match="does not measure its angular velocity"):
        read_imu(imu(0.5, has_rate=False))


@pytest.mark.parametrize(
    "wrong", [imu(math.nan), imu(math.inf), imu(-41.0), imu(0.0, math.nan), imu(0.0, 0.0, math.inf), imu(0.0, 3000.0)]
)
def test_a_number_that_cannot_be_is_refused(wrong):
    with pytest.raises(BadMessage, match="expected"):
        read_imu(wrong)
