"""The motor controller of described wheels, here of two, on a bus with a host that speaks its frames."""

import math
from collections.abc import Iterator

import can
import pytest

from robrain.algorithms.navigation.wheel_bases import Differential, OmniBase
from robrain.plugins.device.mocdevice.frame_map import read_dbc
from robrain.protocol.can.zenoh_bus import ZenohBus
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.firmware.described_controller import TWO_WHEELS, FrameController
from robrain.sim.firmware.motor_controller import NEVER, WATCHDOG_S, MotorState

TICK_S = 0.02
WATCHDOG_TICKS = round(WATCHDOG_S / TICK_S)
STANDING = (0.0, 0.0, 0.0)
BASE, HULL = Differential(wheel_radius_m=0.1, track_m=0.4, encoder_ticks_per_turn=1000), OmniBase()


class Desk:
    """The controller, and a host beside it."""

    def __init__(self, board: can.BusABC, host: can.BusABC) -> None:
        self.host = host
        self.controller = FrameController(board, BASE, HULL, TICK_S, lambda: 0)

    def command(self, left_rpm: float, right_rpm: float) -> None:
        message = read_dbc(TWO_WHEELS.dbc).get_message_by_name("DriveCommand")
        data = message.encode({"left_rpm": left_rpm, "right_rpm": right_rpm})
        self.host.send(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.controller.receive()


@pytest.fixture
def desk() -> Iterator[Desk]:
    session = open_lockstep_session()
    board = ZenohBus("r1/can0", session=session, direct=True)
    host = ZenohBus("r1/can0", session=session, direct=True)
    yield Desk(board, host)
    host.shutdown()
    board.shutdown()
    session.close()


def test_the_hull_moves_as_the_two_wheels_would(desk: Desk) -> None:
    desk.command(30.0, 60.0)
    desk.tick()
    twist = HULL.twist(*desk.controller.wheel_speeds_rad_s)
    left_m_s, right_m_s = 0.1 * math.pi, 0.1 * 2 * math.pi
    assert twist.forward_m_s == pytest.approx((left_m_s + right_m_s) / 2, rel=1e-3)
    assert twist.left_m_s == pytest.approx(0.0, abs=1e-9)
    assert twist.yaw_rad_s == pytest.approx((right_m_s - left_m_s) / 0.4, rel=1e-3)
    assert desk.controller.state is MotorState.RUNNING


def test_the_wheels_stop_200_ms_after_the_last_command(desk: Desk) -> None:
    desk.command(30.0, 60.0)
    desk.tick(WATCHDOG_TICKS)
    assert desk.controller.state is MotorState.RUNNING
    desk.controller.has_news = False
    desk.tick()
    assert desk.controller.wheel_speeds_rad_s == STANDING
    assert (desk.controller.state, desk.controller.due_tick) == (MotorState.WATCHDOG, NEVER)
    assert desk.controller.has_news
    desk.command(30.0, 60.0)
    desk.tick()
    assert desk.controller.state is MotorState.RUNNING


def test_every_command_winds_the_watchdog_up_again(desk: Desk) -> None:
    for _ in range(5):
        desk.command(30.0, 30.0)
        desk.tick(WATCHDOG_TICKS)
        assert desk.controller.state is MotorState.RUNNING


def test_after_a_failure_the_wheels_stand_until_a_command_of_nothing_acknowledges_it(desk: Desk) -> None:
    desk.command(30.0, 30.0)
    desk.tick()
    desk.controller.has_failed = True
    desk.command(30.0, 30.0)
    desk.tick()
    assert (desk.controller.state, desk.controller.wheel_speeds_rad_s) == (MotorState.ERROR, STANDING)
    desk.command(0.0, 0.0)
    desk.tick()
    assert desk.controller.state is MotorState.ERROR  # the cause is still there
    desk.controller.has_failed = False
    desk.command(30.0, 30.0)
    desk.tick()
    assert (desk.controller.state, desk.controller.wheel_speeds_rad_s) == (MotorState.ERROR, STANDING)
    desk.command(0.0, 0.0)
    desk.command(30.0, 30.0)
    desk.tick()
    assert desk.controller.state is MotorState.RUNNING
