"""The same device on other buses than the simulator's: `interface`, `channel` and `options` of the manifest differ."""

import can
import pytest

from robrain.agent.authoring.testing import PluginBench
from robrain.algorithms.navigation.wheel_bases import OmniBase
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
