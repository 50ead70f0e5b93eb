import math

import msgspec
import pytest

from robrain.plugins.device.bm2.interface import BadReading
from robrain.plugins.device.ros2.ros2_battery import read_battery
from tests.plugins.device.ros2.ros_words import battery


@pytest.mark.parametrize(
    ("current", "status", "drawn_a"),
    [(-1.25, 0, 1.25), (1.25, 0, -1.25), (1.25, 2, 1.25), (-1.25, 1, -1.25), (-1.25, 3, 1.25)],
)
def test_the_status_decides_the_sign_of_the_current_where_it_is_known(current, status, drawn_a):
    told = read_battery(battery(15.5, current, 24.0, stamp_ns=7, status=status), None, 25.0)
    assert told == (7, (15.5, drawn_a, 24.0, msgspec.UNSET))


def test_what_the_robot_does_not_measure_is_what_the_parameters_say():
    _, reading = read_battery(battery(current=math.nan, temperature=math.nan), 0.8, 21.0)
    assert (reading.current_a, reading.temperature_c, reading.report.has_current) == (0.8, 21.0, False)


def test_a_robot_that_does_not_measure_its_current_is_refused_without_one():
    with pytest.raises(BadReading, match="give current_a"):
        read_battery(battery(current=math.nan), None, 25.0)
