"""A simulated motor controller on a serial line: what it obeys and answers, and what it does not understand."""

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.navigation.wheel_bases import Differential, OmniBase
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SERIAL_TX
from robrain.sim.firmware.described_controller import LineController, SerialPort
from robrain.sim.firmware.motor_controller import WATCHDOG_S, MotorState

TICK_S = 0.02


class SilentBus(can.BusABC):
    """The bus of the robot's other nodes, which the controller is not on."""

    def __init__(self) -> None:
        super().__init__(channel="none")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError("it is not on the bus")


BASE = Differential(wheel_radius_m=0.05, track_m=0.3, encoder_ticks_per_turn=600)


class Line:
    """The controller, and the robot's end of its line."""

    def __init__(self) -> None:
        self.said: list[bytes] = []
        self._inbox = Inbox()
        port, bus = SerialPort(self._inbox, self.said.append), SilentBus()
        bus.shutdown()
        self.controller = LineController(port, bus, BASE, OmniBase(), TICK_S)

    def say(self, data: bytes) -> list[bytes]:
        """Send bytes, and let a tick pass; what it answers."""
        self._inbox.append(ARENA_SERIAL_TX, "line", data)
        self.said.clear()
        self.controller.receive()
        return list(self.said)

    @property
    def is_driven(self) -> bool:
        return any(self.controller.wheel_speeds_rad_s)


@pytest.fixture
def line() -> Line:
    return Line()


def test_counts_are_told_when_they_are_asked_for_and_can_be_set_back(line: Line) -> None:
    assert line.say(b"e\r") == [b"0 0\r\n"]
    for _ in range(50):
        line.controller.roll(0.01, 0.0, 0.0)
    ticks = int(0.5 / 0.05 // BASE.rad_per_tick)
    assert line.say(b"e\r") == [b"%d %d\r\n" % (ticks, ticks)]
    line.controller.roll(0.0, 0.0, 0.5)
    left, right = map(int, line.say(b"e\r")[0].split())
    assert left < ticks < right
    assert line.say(b"r\re\r") == [b"OK\r\n", b"0 0\r\n"]


def test_a_command_drives_until_commands_cease(line: Line) -> None:
    assert line.say(b"m 20 20\r") == [b"OK\r\n"]
    assert line.is_driven
    for _ in range(round(WATCHDOG_S / TICK_S) - 1):
        line.say(b"e\r")
        assert line.is_driven
    line.say(b"")
    assert not line.is_driven
    assert line.controller.state is MotorState.WATCHDOG


def test_a_command_of_zero_stops_at_once(line: Line) -> None:
    line.say(b"m -20 20\r")
    line.say(b"m 0 0\r")
    assert not line.is_driven


def test_a_line_may_come_in_pieces_and_several_at_once(line: Line) -> None:
    assert line.say(b"m 2") == []
    assert not line.is_driven
    assert line.say(b"0 20\re\r\r") == [b"OK\r\n", b"0 0\r\n"]
    assert line.is_driven


@pytest.mark.parametrize("wrong", [b"m 20\r", b"m 2.5 1\r", b"m 1 2 3\r", b"x\r", b"m 9999999 1\r", b"\xff\x00\r"])
def test_what_it_does_not_understand_is_answered_counted_and_moves_nothing(line: Line, wrong: bytes) -> None:
    assert line.say(wrong) == [b"Invalid Command\r\n"]
    assert line.controller.rejected_frames == 1
    assert not line.is_driven


def test_a_line_that_never_ends_is_given_up(line: Line) -> None:
    for _ in range(100):
        line.say(b"m" * 50)
    assert line.controller.rejected_frames > 10
    line.say(b"\r")
    assert line.say(b"e\r") == [b"0 0\r\n"]


def test_a_failed_power_stage_stands_still_until_it_works_again(line: Line) -> None:
    line.say(b"m 20 20\r")
    line.controller.has_failed = True
    line.say(b"m 20 20\r")
    assert (line.is_driven, line.controller.state) == (False, MotorState.ERROR)
    line.controller.has_failed = False
    line.say(b"m 20 20\r")
    assert line.is_driven


def test_what_was_sent_while_it_was_unplugged_is_dropped(line: Line) -> None:
    line._inbox.append(ARENA_SERIAL_TX, "line", b"m 20 20\rm 1")
    line.controller.forget()
    assert line.say(b"0 20\r") == [b"Invalid Command\r\n"]
    assert not line.is_driven


@given(st.lists(st.binary(max_size=80)))
def test_no_bytes_make_it_fail(said: list[bytes]) -> None:
    one = Line()
    for data in said:
        one.say(data)
    one.say(b"\r")
    assert one.say(b"e\r") == [b"0 0\r\n"]
