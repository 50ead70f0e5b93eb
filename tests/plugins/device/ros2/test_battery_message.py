import math

import pytest

from robrain.plugins.device.ros2_battery.battery_message import BadBattery, read_battery
from tests.plugins.device.ros2.ros_words import battery


def test_the_current_is_positive_while_discharging():
    told = read_battery(battery(15.5, -1.25, 24.0, stamp_ns=7), None, 25.0)
    assert told == (7, 15.5, 1.25, 24.0, True)


def test_what_the_robot_does_not_measure_is_what_the_parameters_say():
    assert read_battery(battery(current=math.nan, temperature=math.nan), 0.8, 21.0)[2:] == (0.8, 21.0, False)


def test_a_robot_that_does_not_measure_its_current_is_refused_without_one():
    with pytest.raises(BadBattery, match="give current_a"):
        read_battery(battery(current=math.nan), None, 25.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"voltage": math.nan},
        {"voltage": math.inf},
        {"voltage": 0.0},
        {"voltage": -12.0},
        {"current": math.inf},
        {"current": -1e9},
        {"temperature": math.inf},
        {"temperature": 1e9},
    ],
)
def test_a_number_that_cannot_be_is_refused(wrong):
    with pytest.raises(BadBattery, match="expected"):
        read_battery(battery(**wrong), 1.0, 25.0)
