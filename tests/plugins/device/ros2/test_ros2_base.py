import math

import pytest

from robrain.plugins.device.ros2.ros2_base import TICK_S, ZEROS, CommandGate, OdometryReading, ReportedPath
from robrain.plugins.device.ros2.topic_device import StampClock
from robrain.protocol.clock import NS_PER_S, to_ns
from robrain.protocol.model.geometry import Pose2D, Twist2D

ORIGIN = Pose2D(0.0, 0.0, 0.0)
DRIVING = Twist2D(0.5, 0.0, 0.0)


def a_path(pose=ORIGIN, before=None):
    return ReportedPath(1.0, 2.0, pose, before)


def tell(path, pose, at_s, number=0):
    return path.follow(OdometryReading(pose, DRIVING), to_ns(at_s), number)


def test_odom_begins_where_the_robot_is_first_heard():
    path = a_path()
    assert tell(path, Pose2D(7.0, 3.0, math.pi / 2), 0.0)
    assert path.pose == ORIGIN
    assert tell(path, Pose2D(7.0, 3.5, math.pi / 2), 1.0)
    assert path.pose.x_m == pytest.approx(0.5)
    assert path.pose.y_m == pytest.approx(0.0)
    assert path.velocity == DRIVING


def test_odometry_that_jumps_farther_than_the_base_can_drive_leaves_the_pose():
    path = a_path()
    tell(path, ORIGIN, 0.0)
    tell(path, Pose2D(0.4, 0.0, 0.0), 0.5)
    assert not tell(path, Pose2D(-5.0, 0.0, 0.0), 0.55)
    assert path.pose.x_m == pytest.approx(0.4)
    assert path.velocity == Twist2D()
    assert tell(path, Pose2D(-4.9, 0.0, 0.0), 0.65)
    assert path.pose.x_m == pytest.approx(0.5)


def test_odometry_that_turns_faster_than_the_base_can_leaves_the_pose():
    path = a_path()
    tell(path, ORIGIN, 0.0)
    assert not tell(path, Pose2D(0.0, 0.0, 2.0), 0.05)
    assert path.pose == ORIGIN


def test_a_publisher_that_counts_anew_has_been_started_again_and_so_has_its_odometry():
    path = a_path(Pose2D(2.0, 0.0, 0.0), (Pose2D(0.3, 0.0, 0.0), 500))
    assert not tell(path, ORIGIN, 0.0, number=3)  # near enough to be taken for motion
    assert path.pose == Pose2D(2.0, 0.0, 0.0)
    assert tell(path, Pose2D(0.1, 0.0, 0.0), 0.1, number=4)
    assert path.pose.x_m == pytest.approx(2.1)


def test_what_the_robot_rolled_while_it_was_not_heard_counts():
    path = a_path(Pose2D(2.0, 0.0, 0.0), (Pose2D(0.3, 0.0, 0.0), 500))
    assert tell(path, Pose2D(0.6, 0.0, 0.0), 10.0, number=700)
    assert path.pose.x_m == pytest.approx(2.3)


COMMANDED, STANDING = Twist2D(0.4, 0.0, 0.1), Twist2D()


class Wheels:
    """A gate on a clock of the test's, and what it has published."""

    def __init__(self):
        self.now_ns = 0
        self.said = []
        self.gate = CommandGate(self.said.append, lambda: self.now_ns)

    def pass_s(self, seconds):
        """Let time pass; returns what was published meanwhile."""
        before = len(self.said)
        for _ in range(round(seconds / TICK_S)):
            self.now_ns += to_ns(TICK_S)
            self.gate.tick()
        return self.said[before:]


@pytest.fixture
def wheels():
    return Wheels()


def test_a_velocity_that_is_not_repeated_is_zero_after_200_ms(wheels):
    wheels.gate.drive(COMMANDED)
    assert wheels.said == [COMMANDED]
    assert wheels.pass_s(0.15) == []
    assert wheels.pass_s(0.05) == [STANDING]


def test_a_velocity_that_is_repeated_goes_on(wheels):
    for _ in range(30):
        wheels.gate.drive(COMMANDED)
        assert wheels.pass_s(0.1) == []


def test_a_stop_is_said_some_times_and_then_no_more_so_that_others_may_drive_the_robot(wheels):
    wheels.gate.stop()
    assert wheels.pass_s(60.0) == [STANDING] * ZEROS
    assert wheels.said == [STANDING] * (ZEROS + 1)


def test_a_halted_robot_is_told_to_stand_for_as_long_as_it_is_halted(wheels):
    wheels.gate.drive(COMMANDED)
    wheels.gate.hold()
    assert wheels.said == [COMMANDED, STANDING]
    assert wheels.pass_s(60.0) == [STANDING] * round(60.0 / TICK_S)


def test_a_command_that_a_halt_overtakes_is_not_passed_on(wheels):
    wheels.gate.hold()
    wheels.gate.drive(COMMANDED)
    assert COMMANDED not in wheels.said


def test_a_step_that_began_before_the_halt_does_not_end_it(wheels):
    wheels.gate.hold()
    wheels.gate.release()
    wheels.gate.drive(COMMANDED)
    assert wheels.pass_s(5.0) == [STANDING] * round(5.0 / TICK_S)


def test_after_the_halt_the_robot_drives_again(wheels):
    wheels.gate.hold()
    wheels.pass_s(1.0)
    wheels.gate.release()
    wheels.gate.drive(COMMANDED)
    assert wheels.said[-1] == COMMANDED


def test_the_end_says_zero_and_nothing_comes_after_it(wheels):
    wheels.gate.drive(COMMANDED)
    wheels.gate.close()
    wheels.gate.drive(COMMANDED)
    wheels.gate.stop()
    wheels.gate.close()
    wheels.pass_s(1.0)
    assert wheels.said == [COMMANDED, STANDING]


NOW_NS = 1_700_000_000 * NS_PER_S


@pytest.mark.parametrize("ahead_s", [40.0, -40.0, 0.02, -1_700_000_000.0 + 12.0])
def test_a_stamp_of_another_clock_is_converted_with_the_least_delay_of_late(ahead_s):
    clock = StampClock()
    for step in range(50):
        stamp_ns = NOW_NS + to_ns(0.1 * step)
        delay_ns = to_ns(0.002 if step % 5 == 0 else 0.06)
        measured_ns = clock.measured_ns(stamp_ns + to_ns(ahead_s), stamp_ns + delay_ns)
        assert measured_ns == stamp_ns + to_ns(0.002)
