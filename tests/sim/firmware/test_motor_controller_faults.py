"""The motor controller's error states, and the line that it sits on."""

import pytest

from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.bus_state import BusState, state_in, state_of
from robrain.protocol.can.frames import codec
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.bus_line import BusLine, LineFault
from robrain.sim.firmware.motor_controller import MotorState
from tests.sim.firmware.controller_node import ControllerNode

SPEEDS = {"wheel_1_rad_s": 1.0, "wheel_2_rad_s": 2.0, "wheel_3_rad_s": 3.0}
STANDING = (0.0, 0.0, 0.0)


class Desk:
    def __init__(self, session):
        self.line = BusLine(ZenohBus("r1/can0", session=session, direct=True))
        self.host = ZenohBus("r1/can0", session=session, direct=True)
        self.node = ControllerNode(self.line, OmniBase(), 0.02, lambda: self.line.transmit_errors)
        self.controller = self.node.controller
        self.sent = 0

    def command(self):
        self.host.send(codec("WheelCommand").pack(self.sent, **SPEEDS))
        self.sent += 1

    def stop(self):
        self.host.send(codec("Stop").pack(self.sent, latched=0))
        self.sent += 1

    def tick(self, count=1):
        for _ in range(count):
            self.controller.receive()
            self.node.report([0.0, 0.0, 0.0])

    def heard(self):
        return list(iter(lambda: self.host.recv(timeout=0), None))

    def statuses(self):
        wanted = codec("MotorStatus")
        return [wanted.unpack(frame) for frame in self.heard() if frame.arbitration_id == wanted.arbitration_id]


@pytest.fixture
def desk():
    session = open_lockstep_session()
    desk = Desk(session)
    yield desk
    desk.host.shutdown()
    desk.line.shutdown()
    session.close()


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
    desk.heard()
    desk.line.break_down(LineFault.CUT)
    desk.command()
    desk.tick(12)
    assert desk.heard() == []
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
    assert [state_in(frame.arbitration_id, frame.data) for frame in desk.heard()] == [BusState.OFF]
    desk.line.break_down(LineFault.NONE)
    (restarted,) = desk.heard()
    assert state_in(restarted.arbitration_id, restarted.data) is BusState.ACTIVE
    desk.tick(10)
    assert desk.statuses()[-1]["transmit_errors"] == 0
