"""The motor controller: what it obeys, its watchdog, its error states, and the line that it sits on."""

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.bus_state import BusState, state_in, state_of
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.bus_line import BusLine, LineFault
from robrain.sim.firmware.motor_controller import MotorState
from tests.sim.firmware.controller_node import ControllerNode

TICK_S = 0.02
COMMAND = {"wheel_1_rad_s": 1.0, "wheel_2_rad_s": -2.0, "wheel_3_rad_s": 3.5}
SPEEDS = (1.0, -2.0, 3.5)
STANDING = (0.0, 0.0, 0.0)


class Desk:
    """A motor controller on a line, and a host beside it."""

    def __init__(self, session):
        self.line = BusLine(ZenohBus("r1/can0", session=session, direct=True))
        self.host = ZenohBus("r1/can0", session=session, direct=True)
        self.node = ControllerNode(self.line, OmniBase(), TICK_S, lambda: self.line.transmit_errors)
        self.controller = self.node.controller
        self.turns_rad = [0.0, 0.0, 0.0]
        self.sent = 0

    def command(self):
        self.host.send(codec("WheelCommand").pack(self.sent, **COMMAND))
        self.sent += 1

    def stop(self, *, latched=False):
        self.host.send(codec("Stop").pack(self.sent, latched=latched))
        self.sent += 1

    def tick(self, count=1):
        for _ in range(count):
            self.controller.receive()
            self.node.report(self.turns_rad)

    def frames(self):
        return list(iter(lambda: self.host.recv(timeout=0), None))

    def received(self, name):
        frames = self.frames()
        return [codec(name).unpack(frame) for frame in frames if frame.arbitration_id == codec(name).arbitration_id]

    def statuses(self):
        return self.received("MotorStatus")


@pytest.fixture
def desk():
    session = open_lockstep_session()
    desk = Desk(session)
    yield desk
    desk.host.shutdown()
    desk.line.shutdown()
    session.close()


def test_wheels_do_what_a_command_says(desk):
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)
    assert desk.controller.state is MotorState.RUNNING


def test_wheels_stop_200_ms_after_the_last_command(desk):
    desk.command()
    desk.tick(10)
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.received("MotorStatus")[-1]["state"] == MotorState.WATCHDOG


def test_every_command_winds_the_watchdog_up_again(desk):
    for _ in range(5):
        desk.command()
        desk.tick(10)
        assert desk.controller.state is MotorState.RUNNING


def test_corrupt_frames_are_counted_and_not_believed(desk):
    for position in range(8):
        frame = codec("WheelCommand").pack(0, **COMMAND)
        frame.data[position] ^= 0x10
        desk.host.send(frame)
    short = codec("WheelCommand").pack(0, **COMMAND)
    desk.host.send(can.Message(arbitration_id=short.arbitration_id, data=short.data[:7], is_extended_id=False))
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.received("MotorStatus")[-1]["rejected_frames"] == 9


def test_a_corrupt_stop_is_counted_and_does_not_stop(desk):
    desk.command()
    frame = codec("Stop").pack(0, latched=1)
    frame.data[0] ^= 0x02
    desk.host.send(frame)
    desk.tick()
    assert desk.controller.state is MotorState.RUNNING
    assert desk.controller.rejected_frames == 1


def test_frames_of_others_are_ignored(desk):
    desk.host.send(can.Message(arbitration_id=0x123, data=b"anything", is_extended_id=False))
    desk.host.send(can.Message(arbitration_id=codec("WheelCommand").arbitration_id, data=b"x", is_extended_id=True))
    desk.tick()
    assert desk.controller.rejected_frames == 0
    assert desk.controller.state is MotorState.WATCHDOG


def test_a_latched_stop_refuses_commands_until_it_is_released(desk):
    desk.command()
    desk.stop(latched=True)
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert desk.received("MotorStatus")[-1]["state"] == MotorState.LATCHED
    desk.stop(latched=False)
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)


def test_a_plain_stop_lets_the_next_command_drive(desk):
    desk.command()
    desk.stop(latched=False)
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == pytest.approx(SPEEDS)


def test_wheels_without_power_stand_whatever_is_commanded(desk):
    desk.controller.powered = False
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING


def test_encoders_count_at_50_hz_and_the_status_comes_at_5_hz_and_on_change(desk):
    desk.tick(50)
    frames = list(iter(lambda: desk.host.recv(timeout=0), None))
    ids = [frame.arbitration_id for frame in frames]
    assert ids.count(codec("WheelEncoders").arbitration_id) == 50
    assert ids.count(codec("MotorStatus").arbitration_id) == 5
    desk.tick(3)
    desk.command()
    desk.tick()
    assert [status["state"] for status in desk.received("MotorStatus")] == [MotorState.WATCHDOG, MotorState.RUNNING]


def test_encoders_wrap_at_65536_in_both_directions(desk):
    per_tick_rad = OmniBase().rad_per_tick
    desk.turns_rad = [65536.5 * per_tick_rad, -0.5 * per_tick_rad, 10.5 * per_tick_rad]
    desk.tick()
    counts = desk.received("WheelEncoders")[0]
    assert [counts[f"wheel_{wheel}_ticks"] for wheel in (1, 2, 3)] == [0, 65535, 10]


def test_the_watchdog_bites_at_its_tick_when_the_ticks_between_are_left_out(desk):
    desk.command()
    desk.controller.receive(7)
    assert desk.controller.due_tick == 17
    assert desk.controller.state is MotorState.RUNNING
    desk.controller.receive(16)
    assert desk.controller.state is MotorState.RUNNING
    desk.controller.send_status()
    assert not desk.controller.has_news
    desk.controller.receive(17)
    assert desk.controller.state is MotorState.WATCHDOG
    assert desk.controller.has_news


def test_a_power_stage_that_fails_stands_and_says_so_at_once(desk):
    desk.command()
    desk.tick()
    desk.statuses()
    desk.controller.has_failed = True
    desk.command()
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert [status["state"] for status in desk.statuses()] == [MotorState.ERROR]


def test_an_error_lasts_until_it_is_acknowledged_and_its_cause_has_gone(desk):
    desk.controller.has_failed = True
    desk.tick()
    desk.stop()
    desk.tick()
    assert desk.controller.state is MotorState.ERROR  # the cause is still there
    desk.controller.has_failed = False
    desk.command()
    desk.tick()
    assert desk.controller.state is MotorState.ERROR  # nobody has acknowledged it
    desk.stop()
    desk.command()
    desk.tick()
    assert desk.controller.state is MotorState.RUNNING


def test_commands_that_never_came_are_counted(desk):
    for _ in range(3):
        desk.command()
        desk.sent += 2
    desk.stop()
    desk.tick()
    assert desk.statuses()[-1]["lost_commands"] == 6


def test_on_a_cut_line_nothing_passes_either_way_and_the_watchdog_stops_the_wheels(desk):
    desk.command()
    desk.tick()
    desk.frames()
    desk.line.break_down(LineFault.CUT)
    desk.command()
    desk.tick(12)
    assert desk.frames() == []
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert state_of(desk.line.transmit_errors, 0) is BusState.PASSIVE
    desk.line.break_down(LineFault.NONE)
    desk.tick(10)
    first = desk.statuses()[0]
    assert first["bus_state"] == BusState.PASSIVE  # it has been, since the last status
    assert 110 < first["transmit_errors"] < 128
    assert desk.controller.state is MotorState.WATCHDOG  # what was sent meanwhile is lost


def test_errors_are_forgiven_one_for_each_frame_that_is_sent(desk):
    desk.line.break_down(LineFault.CUT)
    desk.tick()
    desk.line.break_down(LineFault.NONE)
    desk.tick(60)
    assert desk.statuses()[-1]["bus_state"] == BusState.ACTIVE
    desk.tick(80)
    assert desk.line.transmit_errors == 0


def test_a_shorted_line_puts_every_controller_off_the_bus_and_tells_the_host(desk):
    desk.line.break_down(LineFault.SHORTED)
    desk.tick(3)
    assert state_of(desk.line.transmit_errors, 0) is BusState.OFF
    assert [state_in(frame.arbitration_id, frame.data) for frame in desk.frames()] == [BusState.OFF]
    desk.line.break_down(LineFault.NONE)
    (restarted,) = desk.frames()
    assert state_in(restarted.arbitration_id, restarted.data) is BusState.ACTIVE
    desk.tick(10)
    assert desk.statuses()[-1]["transmit_errors"] == 0
