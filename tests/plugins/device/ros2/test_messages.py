import math

import msgspec
import pytest

from robrain.plugins.device.bm2.interface import BadReading
from robrain.plugins.device.imu import ImuMotion
from robrain.plugins.device.ros2.ros2_base import read_odometry
from robrain.plugins.device.ros2.ros2_battery import read_battery
from robrain.plugins.device.ros2.ros2_imu import read_imu
from robrain.plugins.device.ros2.scan_reader import ScanReader
from robrain.plugins.device.ros2.topic_device import BadMessage
from robrain.plugins.device.scan.lidar_device import Mount
from robrain.protocol.model.geometry import Pose2D
from tests.plugins.device.ros2.ros_words import battery, header, imu, odometry, scan

CENTRE = Mount()


def read(message, mount=CENTRE, beams=0, range_max_m=0.0):
    return ScanReader(mount, beams, range_max_m).read(message)[1]


def test_infinity_and_ranges_beyond_the_reach_are_no_return_and_those_too_near_the_least_range():
    assert read(scan([-math.inf, math.inf, 8.5, 8.0])).ranges_m == (0.1, 8.0, 8.0, 8.0)


@pytest.mark.parametrize("range_max", [math.inf, 3.4e38, 5000.0])
def test_a_lidar_that_reports_no_limit_is_read_up_to_ten_metres(range_max):
    told = read(scan([1.0, 40.0, math.inf, 1.0], range_max=range_max))
    assert told.range_max_m == 10.0
    assert sorted(told.ranges_m) == [1.0, 1.0, 10.0, 10.0]
    assert read(scan([1.0, 40.0, 20.0, 1.0], range_max=range_max), range_max_m=30.0).range_max_m == 30.0


@pytest.mark.parametrize(
    ("mount", "beams", "sides"),
    [
        (Mount(yaw_rad=math.pi), 4, (0, 90, 180, 270)),
        (Mount(upside_down=True), 0, (180, 90, 0, 270)),
        (Mount(upside_down=True), 4, (180, 90, 0, 270)),
    ],
)
def test_a_lidar_mounted_backwards_or_upside_down_sees_in_the_robots_frame(mount, beams, sides):
    told = read(scan([1.0, 2.0, 3.0, 4.0]), mount=mount, beams=beams)
    found = {range_m: round(math.degrees(angle)) % 360 for angle, range_m in zip(*told[:2], strict=True)}
    assert found == dict(zip((1.0, 2.0, 3.0, 4.0), sides, strict=True))


@pytest.mark.parametrize("beams", [0, 360])
def test_parts_of_the_robot_itself_are_left_out(beams):
    told = read(scan([0.15, 2.0, math.inf, 0.15]), mount=Mount(hidden_within_m=0.2), beams=beams)
    assert sorted(told.ranges_m) == [2.0, told.range_max_m]


def test_a_covered_lidar_is_refused_although_it_measures():
    with pytest.raises(BadMessage, match="beyond the robot itself"):
        read(scan([0.1] * 90), mount=Mount(hidden_within_m=0.15), beams=360)


def test_a_stamp_is_that_of_the_first_beam_and_the_turn_counts_as_of_its_middle():
    reader = ScanReader(CENTRE, 0, 0.0)
    assert reader.read(scan([1.0] * 101, header=header(1_000_000_000), time_increment=0.001))[0] == 1_050_000_000
    assert reader.read(scan([1.0] * 101, time_increment=0.001))[0] == 0


@pytest.mark.parametrize(
    "message",
    [
        scan([]),
        scan([1.0] * 4, angle_min=math.nan),
        scan([1.0] * 4, angle_increment=0.0),
        scan([1.0] * 4, angle_increment=math.nan),
        scan([1.0] * 4, angle_increment=math.inf),
        scan([1.0] * 4, angle_max=9.0),
        scan([1.0] * 4, angle_max=math.nan),
        scan([1.0] * 9, angle_increment=1.0, angle_max=8.0 - math.pi),  # more than a turn
        scan([1.0] * 4, ranges=[1.0] * 9),
        scan([1.0] * 4, range_min=math.nan),
        scan([1.0] * 4, range_min=-1.0),
        scan([1.0] * 4, range_min=9.0),
        scan([1.0] * 4, range_max=0.0),
        scan([math.nan] * 4),
        scan([0.0] * 4),
    ],
)
def test_a_turn_that_cannot_be_is_refused(message):
    with pytest.raises(BadMessage, match="expected"):
        read(message)


def test_what_the_unit_does_not_measure_is_left_out_or_refused():
    assert read_imu(imu(0.5, 1.0, 2.0, has_acceleration=False))[1] == ImuMotion(0.5)
    with pytest.raises(BadMessage, match="does not measure angular velocity"):
        read_imu(imu(0.5, has_rate=False))


@pytest.mark.parametrize(
    "wrong", [imu(math.nan), imu(math.inf), imu(-41.0), imu(0.0, math.nan), imu(0.0, 0.0, math.inf), imu(0.0, 3000.0)]
)
def test_a_number_that_cannot_be_is_refused(wrong):
    with pytest.raises(BadMessage, match="expected"):
        read_imu(wrong)


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


PLACE = Pose2D(1.0, -2.0, 0.5)


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
