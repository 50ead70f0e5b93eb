"""The same device on other buses than the simulator's: `interface`, `channel` and `options` of the manifest differ."""

import time

import can
import pytest

from robrain.agent.authoring.testing import PluginBench
from robrain.algorithms.navigation.wheel_bases import OmniBase
from robrain.protocol.can.frames import codec
from robrain.protocol.model.geometry import Twist2D
from robrain.sim.firmware.motor_controller import MotorState
from tests.sim.firmware.controller_node import ControllerNode

TICK_S = 0.02
"""The group of python-can's documentation for IPv4; `hop_limit = 0` keeps it on this computer."""


def bench_on(**parameters):
    return PluginBench(load=["mocdevice"], parameters={"mocdevice": parameters})


def test_on_a_virtual_bus_the_robot_drives_as_it_is_told():
    board = can.Bus(interface="virtual", channel="test_can_backends")
    node = ControllerNode(board, OmniBase(), TICK_S)
    controller = node.controller
    turns_rad = [0.0, 0.0, 0.0]
    with bench_on(interface="virtual", channel="test_can_backends", options={"preserve_timestamps": False}) as bench:
        device = bench.plugin("mocdevice")
        for _ in range(100):
            device.drive(Twist2D(0.25, 0.0, 0.0))
            controller.receive()
            turns_rad = [
                turn + TICK_S * speed for turn, speed in zip(turns_rad, controller.wheel_speeds_rad_s, strict=True)
            ]
            node.report(turns_rad)
            bench.run(TICK_S)
        assert controller.state is MotorState.RUNNING
        assert device.pose().x_m == pytest.approx(0.5, abs=0.01)
        assert bench.call("mocdevice", "counters") == {
            "believed": 100,
            "rejected": 0,
            "foreign": 0,
            "lost": 0,
            "errors": 0,
        }
    board.shutdown()


def test_on_socketcan_the_robot_drives_where_the_kernel_has_a_virtual_can():
    try:
        board = can.Bus(interface="socketcan", channel="vcan0")
    except (can.CanError, OSError) as error:
        with bench_on(interface="socketcan", channel="vcan0") as bench:
            info = bench.info("mocdevice")
            assert info.state == "faulted"
            assert info.why.startswith("hardware absent: no CAN bus at socketcan:vcan0: ")
        pytest.skip(f"this kernel has no vcan0: {error}")
    with bench_on(interface="socketcan", channel="vcan0") as bench:
        board.send(codec("WheelEncoders").pack(0, wheel_1_ticks=0, wheel_2_ticks=0, wheel_3_ticks=0))
        time.sleep(0.1)
        bench.run(TICK_S)
        assert bench.call("mocdevice", "counters")["believed"] == 1
    board.shutdown()


def test_a_log_in_candump_format_replayed_into_the_device_is_the_odometry_of_that_drive(tmp_path):
    log = tmp_path / "drive.log"
    turns_rad = [0.0, 0.0, 0.0]
    with can.CanutilsLogWriter(log) as writer:
        for tick in range(100):
            counts = [int(turn / OmniBase().rad_per_tick) & 0xFFFF for turn in turns_rad]
            frame = codec("WheelEncoders").pack(
                tick, wheel_1_ticks=counts[0], wheel_2_ticks=counts[1], wheel_3_ticks=counts[2]
            )
            frame.timestamp = TICK_S * tick
            writer.on_message_received(frame)
            step = OmniBase().wheel_speeds_rad_s(Twist2D(0.01, 0.0, 0.0))
            turns_rad = [turn + more for turn, more in zip(turns_rad, step, strict=True)]
    assert log.read_text().splitlines()[0].split()[2] == "180#00000000000000A5"
    board = can.Bus(interface="virtual", channel="test_can_replay")
    with bench_on(interface="virtual", channel="test_can_replay") as bench:
        with can.CanutilsLogReader(log) as reader:
            for frame in reader:
                board.send(frame)
                bench.run(TICK_S)
        assert bench.plugin("mocdevice").pose().x_m == pytest.approx(0.99, abs=0.005)
        assert bench.call("mocdevice", "counters")["lost"] == 0
    board.shutdown()
