"""The emergency stop's button in live."""

import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.live_drive import PluginThreads
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.plugins.device import gpio
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.host_messages import HOST_RESUME, ResumeRequest
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import open_session
from tests.patient_endpoint import PatientEndpoint
from tests.plugins.device.gpio_chip import GpioChip
from tests.waiting import until

WHEELS = """
    import time
    from robrain.agent.plugin import Device

    class Wheels(Device):
        halted_s = 0.0
        def emergency_halt(self):
            self.halted_s = time.monotonic()
"""
MANIFEST = '[plugin]\nclass = "wheels:Wheels"\n'


class Robot:
    """A host in live with a button, and an operator beside it."""

    def __init__(self, place: Path) -> None:
        (place / "wheels.py").write_text(textwrap.dedent(WHEELS))
        (place / "wheels.toml").write_text(MANIFEST)
        self.session = open_session(mode="peer", listen=["tcp/127.0.0.1:0"])
        roles = {"emergency_stop": "gpio_emergency_stop"}
        table = RobotTable("r1", places=[str(place)], load=["emergency_stop", "wheels"], roles=roles)
        self.host = AgentHost(RobotFile(robot=table), Path(), self.session, LiveClock(), Drive.LIVE)
        self.wire = PatientEndpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self.threads = PluginThreads(self.host)
        self.host.start()
        self.threads.follow()

    @property
    def wheels(self) -> Any:
        return self.host.manager.get("wheels").plugin

    def resume(self) -> None:
        self.wire.ask(HOST_RESUME, ResumeRequest(by="operator"), robot="r1")

    def close(self) -> None:
        self.threads.stop()
        self.host.close()
        self.wire.close()
        self.session.close()


@pytest.fixture
def chip(monkeypatch: pytest.MonkeyPatch) -> GpioChip:
    one = GpioChip()
    one.levels[27] = False
    monkeypatch.setattr(gpio.gpiod, "request_lines", one.request_lines)
    return one


@pytest.fixture
def robot(tmp_path: Path, chip: GpioChip) -> Iterator[Robot]:
    one = Robot(tmp_path)
    yield one
    one.close()


@pytest.mark.slow
def test_a_pressed_button_stops_the_wheels_again_and_again_and_lets_go_when_an_operator_says_so(
    robot: Robot, chip: GpioChip
) -> None:
    for _ in range(30):
        time.sleep(0.013)
        pressed_s = time.monotonic()
        del chip.levels[27]
        until(lambda: robot.host.manager.halted and robot.wheels.halted_s >= pressed_s)  # noqa: B023 - called at once
        with pytest.raises(CallError, match="the emergency stop is pressed"):
            robot.resume()
        chip.levels[27] = False
        robot.resume()
        assert not robot.host.manager.halted
