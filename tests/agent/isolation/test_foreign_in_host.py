"""Foreign plugins in a robot's host: its own plugins use them, and it relays calls from outside."""

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from robrain.agent.errors import AccessDenied
from robrain.agent.host.agent_host import AgentHost
from robrain.agent.host.robot_file import RobotFile, RobotTable
from robrain.agent.manifest import COMMAND
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.host_messages import HOST_COMMAND, CommandRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.wire.session import listening_at
from tests.agent.conftest import Bench, refused, stock_alone
from tests.agent.isolation.test_foreign import Process, info
from tests.patient_endpoint import PatientEndpoint
from tests.waiting import until

LAB = """
    from tests.agent.isolation.test_foreign import GaugeInterface

    class Meter(Unit):
        interface = GaugeInterface
        period_s = 0.02
        measuring = False
        def activate(self): self.gauge = self.env.use("gauge", GaugeInterface)
        def step(self):
            if self.measuring: self.gauge.read()
        def emergency_halt(self): self.gauge.read()
        @external
        def read(self) -> float: return 10 * self.gauge.read()
        @external
        def where(self, sensor: int) -> float: return self.gauge.place(sensor, offset_m=0.5).y_m

    class Chip(Device):
        def activate(self): self.gauge = self.env.use("gauge", GaugeInterface)
"""
PLUGINS = {"meter": "Meter", "chip": "Chip", "stranger": "Meter"}


class Robot:
    """A host in live, stepped by the test, and an operator beside it; foreign processes are clients of its session."""

    def __init__(self, hub, place: Path, *load: str) -> None:
        self.connect = listening_at(hub)
        robot_file = RobotFile(robot=RobotTable("r1", team="t", places=[str(place)], load=list(load)))
        self.host = AgentHost(robot_file, Path(), hub, LiveClock(), Drive.LIVE, **stock_alone())
        self.wire = PatientEndpoint(hub, "t", LiveClock(), Drive.LIVE)
        self.processes: list[Process] = []
        self.host.start()

    def join(self, name="gauge", visibility=(COMMAND, "meter", "chip"), **told):
        process = Process(self.connect, info(name=name, visibility=visibility, **told), name)
        self.processes.append(process)
        self.until(lambda: name in self.host.manager.registry.foreign)
        return process

    def leave(self, process):
        self.processes.remove(process)
        process.leave()
        self.until(lambda: "gauge" not in self.host.manager.registry.foreign)

    def until(self, condition):
        until(condition, step=self.host.step)

    def call(self, plugin, function, arguments=None):
        return msgspec.json.decode(self.wire.ask(ROBOT_CALL, arguments, robot="r1", plugin=plugin, function=function))

    def command(self, text):
        return self.wire.ask(HOST_COMMAND, CommandRequest(text=text), robot="r1")

    def tag(self, name):
        return self.host.manager.get(name)

    def close(self) -> None:
        for process in self.processes:
            process.leave()
        self.wire.close()
        self.host.close()


@pytest.fixture
def start(bench: Bench, hub) -> Iterator[Callable[..., Robot]]:
    bench.code("lab", LAB)
    for name, class_name in PLUGINS.items():
        bench.manifest(name, f"lab:{class_name}", requires=["gauge"], visibility=[COMMAND])
    bench.manifest("loner", "lab:Meter")
    robots = []

    def start(*load):
        robots.append(Robot(hub, bench.place, *load))
        return robots[-1]

    yield start
    for robot in robots:
        robot.close()


@pytest.fixture
def robot(start):
    return start()


@pytest.fixture
def gauge(robot):
    return robot.join()


@pytest.fixture
def meter(robot, gauge):
    robot.host.manager.load("meter")
    return robot.tag("meter")


# -- from inside ------------------------------------------------------------------------------------------------


def test_a_plugin_of_the_robot_uses_a_foreign_one_like_its_own(robot, gauge, meter):
    assert robot.call("meter", "read") == 15.0
    assert robot.call("meter", "where", [2]) == 2.0
    assert gauge.asked == [b"{}", b'{"sensor":2,"offset_m":0.5}']


@pytest.mark.parametrize(
    ("name", "level", "text"),
    [
        ("chip", "device", r"chip \(device\) may not call gauge \(device\)"),
        ("stranger", "device", "stranger is not in the visibility of gauge"),
        ("loner", "device", r"loner must name gauge in \[tag\] requires"),
    ],
)
def test_who_may_not_use_it_is_not_loaded_and_told_why(robot, name, level, text):
    process = robot.join(level=level)
    with pytest.raises(AccessDenied, match=text) as denied:
        robot.host.manager.load(name)
    assert denied.value.plugin == "gauge"
    assert name not in robot.host.manager.plugins
    assert process.asked == []


def test_a_plugin_that_needs_it_is_left_out_of_the_start_and_picked_up_when_it_is_there(start):
    robot = start("meter")
    assert robot.tag("meter").state_reason == "no plugin gauge; there are: meter"
    robot.join()
    robot.until(lambda: robot.tag("meter").state == "active")
    assert robot.call("meter", "read") == 15.0


def test_a_handle_on_one_that_has_gone_says_so_faults_nobody_and_works_when_it_is_back(robot, gauge, meter):
    meter.plugin.measuring = True
    meter.run(steps=True)
    robot.leave(gauge)
    with pytest.raises(CallError, match="gauge has gone") as gone:
        robot.call("meter", "read")
    assert gone.value.code is ErrorCode.UNLOADED
    meter.run(steps=True)
    assert meter.state == "active"
    robot.join()
    assert robot.call("meter", "read") == 15.0


def test_a_halted_robot_calls_no_foreign_plugin_from_inside_and_relays_no_calls(robot, gauge, meter):
    robot.host.manager.halt()
    assert gauge.asked == []
    assert refused(robot.call, "gauge", "read").code is ErrorCode.HALTED
    robot.host.manager.resume()
    assert robot.call("gauge", "read") == 1.5
    assert gauge.asked == [b""]


# -- from outside -----------------------------------------------------------------------------------------------


def test_a_process_under_the_name_of_a_plugin_of_the_robot_is_neither_listed_nor_called(robot, gauge, meter):
    impostor = robot.join("meter")
    infos = robot.wire.ask(ROBOT_PLUGINS, robot="r1")
    assert [(each.name, each.level) for each in infos] == [("meter", "unit"), ("gauge", "device")]
    assert robot.call("meter", "read") == 15.0
    assert impostor.asked == []


def test_the_text_form_reaches_it_too(robot, gauge):
    assert robot.command("list") == "gauge"
    assert robot.command("call gauge read()") == "1.5"
