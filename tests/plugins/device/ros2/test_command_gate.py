import pytest

from robrain.plugins.device.ros2.ros2_base import TICK_S, ZEROS, CommandGate
from robrain.protocol.clock import to_ns
from robrain.protocol.model.geometry import Twist2D

DRIVING, STANDING = Twist2D(0.4, 0.0, 0.1), Twist2D()


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
    wheels.gate.drive(DRIVING)
    assert wheels.said == [DRIVING]
    assert wheels.pass_s(0.15) == []
    assert wheels.pass_s(0.05) == [STANDING]


def test_a_velocity_that_is_repeated_goes_on(wheels):
    for _ in range(30):
        wheels.gate.drive(DRIVING)
        assert wheels.pass_s(0.1) == []


def test_a_stop_is_said_some_times_and_then_no_more_so_that_others_may_drive_the_robot(wheels):
    wheels.gate.stop()
    assert wheels.pass_s(60.0) == [STANDING] * ZEROS
    assert wheels.said == [STANDING] * (ZEROS + 1)


def test_before_the_first_command_nothing_is_said(wheels):
    assert wheels.pass_s(5.0) == []


def test_a_halted_robot_is_told_to_stand_for_as_long_as_it_is_halted(wheels):
    wheels.gate.drive(DRIVING)
    wheels.gate.hold()
    assert wheels.said == [DRIVING, STANDING]
    assert wheels.pass_s(60.0) == [STANDING] * round(60.0 / TICK_S)


def test_a_command_that_a_halt_overtakes_is_not_passed_on(wheels):
    wheels.gate.hold()
    wheels.gate.drive(DRIVING)
    assert DRIVING not in wheels.said


def test_a_step_that_began_before_the_halt_does_not_end_it(wheels):
    wheels.gate.hold()
    wheels.gate.release()
    wheels.gate.drive(DRIVING)
    assert wheels.pass_s(5.0) == [STANDING] * round(5.0 / TICK_S)


def test_after_the_halt_the_robot_drives_again(wheels):
    wheels.gate.hold()
    wheels.pass_s(1.0)
    wheels.gate.release()
    wheels.gate.drive(DRIVING)
    assert wheels.said[-1] == DRIVING


def test_the_end_says_zero_and_nothing_comes_after_it(wheels):
    wheels.gate.drive(DRIVING)
    wheels.gate.close()
    wheels.gate.drive(DRIVING)
    wheels.gate.stop()
    wheels.gate.close()
    wheels.pass_s(1.0)
    assert wheels.said == [DRIVING, STANDING]
