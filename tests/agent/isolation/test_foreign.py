"""A process in any language that announces itself is a plugin of its robot."""

import re
import time
from typing import Protocol

import msgspec
import pytest

from robrain.agent.errors import AccessDenied, PluginMissing
from robrain.agent.event import Event
from robrain.agent.isolation import foreign_plugins
from robrain.agent.isolation.foreign_plugins import RETRY_NS, ForeignPlugins
from robrain.agent.plugin import Level
from robrain.protocol.clock import LiveClock, VirtualClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots import plugin_messages
from robrain.protocol.messages.robots.plugin_messages import FunctionInfo, PluginInfo
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.wire.endpoint import Drive, Endpoint, Serve
from robrain.protocol.wire.session import listening_at, open_session
from tests.agent.conftest import refused
from tests.waiting import until


def function(name):
    return FunctionInfo(name=name, signature="()", doc="", parameters={"type": "object"}, returns={})


def info(name="gauge", level="device", visibility=("command", "driver"), functions=("read", "place")):
    return PluginInfo(
        name=name,
        level=level,
        state="active",
        visibility=list(visibility),
        functions=[function(each) for each in functions],
        holder="somebody",
    )


class GaugeInterface(Protocol):
    def read(self) -> float: ...

    def place(self, sensor: int, offset_m: float = 0.0) -> Point2D: ...


class Process:
    """What a foreign process does, here on a session of its own."""

    def __init__(self, connect, told, name="gauge"):
        self.asked = []
        self._session = open_session(connect=connect)
        self._wire = Endpoint(self._session, "t", LiveClock(), Drive.LIVE)
        self._wire.answer(plugin_messages.ROBOT_FOREIGN_INFO, lambda request: told, robot="r1", plugin=name)
        self._wire.answer(plugin_messages.ROBOT_FOREIGN_CALL, self._call, serve=Serve.POOL, robot="r1", plugin=name)
        self._wire.token(plugin_messages.ROBOT_FOREIGN, robot="r1", plugin=name)

    def _call(self, request):
        self.asked.append(request.asked)
        match request.names["function"]:
            case "read":
                return 1.5
            case "place":
                return {"x_m": 1.0, "y_m": 2.0}
            case "no_json":
                return b"{nothing"
            case "hang":
                time.sleep(0.5)
        raise CallError(ErrorCode.REFUSED, "not today", "rain")

    def leave(self):
        self._wire.close()
        self._session.close()


class Robot:
    """What the host of the robot r1 has of foreign plugins, on the session that the others are clients of."""

    def __init__(self, hub):
        self.hub = hub
        self.connect = listening_at(hub)
        self.wire = Endpoint(self.hub, "t", LiveClock(), Drive.LIVE)
        self.foreign = ForeignPlugins(self.wire, "r1")
        self.processes = []

    def join(self, told=None, name="gauge"):
        process = Process(self.connect, told if told is not None else info(), name)
        self.processes.append(process)
        return process

    def call(self, name, function, arguments=None, **named):
        payload = b"" if arguments is None else msgspec.json.encode(arguments)
        return msgspec.json.decode(self.foreign.relay(name, function, payload, **named))

    def until(self, condition):
        until(condition, step=self.foreign.follow)

    def close(self):
        for process in self.processes:
            process.leave()
        self.wire.close()


@pytest.fixture
def robot(hub):
    robot = Robot(hub)
    yield robot
    robot.close()


@pytest.fixture
def gauge(robot):
    process = robot.join()
    robot.until(lambda: "gauge" in robot.foreign)
    return process


def test_who_announces_itself_is_listed(robot, gauge):
    robot.join(info(name="driver"), name="other")  # not under another's name
    robot.until(lambda: "other" in robot.foreign)
    listed, other = robot.foreign.infos()
    assert other.name == "other"
    assert (listed.name, listed.level, listed.state) == ("gauge", "device", "active")
    assert [each.name for each in listed.functions] == ["read", "place"]
    assert listed.holder == ""  # that is not its to say


def test_silent_foreign_plugin_is_queried_again_only_after_a_pause(hub, monkeypatch):
    clock, asked = VirtualClock(), []
    wire = Endpoint(hub, "t", clock, Drive.LIVE)
    monkeypatch.setattr(wire, "ask_into", lambda *_, **names: asked.append(names["plugin"]))
    foreign = ForeignPlugins(wire, "r3")
    wire.token(plugin_messages.ROBOT_FOREIGN, robot="r3", plugin="mute")
    until(lambda: asked, step=foreign.follow)
    foreign.follow()
    assert asked == ["mute"]
    clock.advance_to(RETRY_NS)
    foreign.follow()
    assert asked == ["mute", "mute"]
    wire.close()


def test_who_leaves_has_gone_and_is_listed_no_more(robot, gauge):
    robot.processes.remove(gauge)
    gauge.leave()
    with pytest.raises(CallError, match="gauge has gone") as caught:  # the robot has not heard of it yet
        robot.call("gauge", "read")
    assert caught.value.code is ErrorCode.UNLOADED
    robot.until(lambda: not robot.foreign.infos())
    with pytest.raises(CallError, match="no foreign plugin gauge") as caught:
        robot.call("gauge", "read")
    assert caught.value.code is ErrorCode.UNKNOWN_PLUGIN
    with pytest.raises(PluginMissing, match="no foreign plugin gauge; there are: none"):
        robot.foreign.use("driver", Level.UNIT, "gauge", GaugeInterface)


def test_calls_are_relayed_with_their_arguments(robot, gauge):
    assert robot.call("gauge", "read") == 1.5
    assert robot.call("gauge", "place", [3]) == {"x_m": 1.0, "y_m": 2.0}
    assert gauge.asked == [b"", b"[3]"]


def test_its_errors_pass_and_an_answer_that_is_no_json_is_one(robot):
    robot.join(info(functions=["fail", "no_json"]))
    robot.until(lambda: "gauge" in robot.foreign)
    with pytest.raises(CallError, match="not today") as caught:
        robot.call("gauge", "fail")
    assert (caught.value.code, caught.value.detail) == (ErrorCode.REFUSED, "rain")
    with pytest.raises(CallError, match="gauge has not answered in JSON") as caught:
        robot.call("gauge", "no_json")
    assert caught.value.code is ErrorCode.FAILED


@pytest.mark.slow
def test_one_that_hangs_is_waited_for_no_longer_than_the_limit(robot, monkeypatch):
    monkeypatch.setattr(foreign_plugins, "CALL_TIMEOUT_S", 0.1)
    robot.join(info(functions=["hang"]))
    robot.until(lambda: "gauge" in robot.foreign)
    assert refused(robot.call, "gauge", "hang").code is ErrorCode.TIMEOUT


def test_a_function_that_was_not_announced_is_not_asked_for(robot, gauge):
    with pytest.raises(CallError, match="gauge has no function wipe; it has: read, place") as caught:
        robot.call("gauge", "wipe")
    assert caught.value.code is ErrorCode.UNKNOWN_FUNCTION
    assert gauge.asked == []


@pytest.mark.parametrize(
    ("visibility", "caller", "may"),
    [
        (["command"], "command", True),
        (["driver"], "command", False),
        (["*"], "command", False),  # anybody inside
        (["*"], "driver", True),
        (["command"], "driver", False),
    ],
)
def test_its_visibility_says_who_may_call(robot, visibility, caller, may):
    process = robot.join(info(visibility=visibility))
    robot.until(lambda: "gauge" in robot.foreign)
    if may:
        assert robot.call("gauge", "read", caller=caller) == 1.5
        return
    with pytest.raises(CallError, match="gauge is not open to") as caught:
        robot.call("gauge", "read", caller=caller)
    assert caught.value.code is ErrorCode.FORBIDDEN
    assert process.asked == []


def test_plugins_of_the_robot_call_it_by_an_interface(robot, gauge):
    handle = robot.foreign.use("driver", Level.UNIT, "gauge", GaugeInterface)
    assert handle.read() == 1.5
    assert handle.place(2, offset_m=0.5) == Point2D(1.0, 2.0)
    assert gauge.asked[-1] == b'{"sensor":2,"offset_m":0.5}'
    with pytest.raises(TypeError, match="too many positional arguments"):
        handle.read(1)
    with pytest.raises(AttributeError, match="wipe"):
        _ = handle.wipe


def test_a_result_of_another_type_is_its_error(robot, gauge):
    class WrongInterface(Protocol):
        def read(self) -> str: ...

    handle = robot.foreign.use("driver", Level.UNIT, "gauge", WrongInterface)
    with pytest.raises(CallError, match=r"gauge\.read has returned something else"):
        handle.read()


class WiderInterface(GaugeInterface, Protocol):
    def wipe(self) -> None: ...


class EventInterface(Protocol):
    measured: Event[float]

    def read(self) -> float: ...


@pytest.mark.parametrize(
    ("caller", "level", "interface", "text"),
    [
        ("driver", Level.DEVICE, GaugeInterface, "calls go to lower levels only"),
        ("mapper", Level.SKILL, GaugeInterface, "mapper is not in the visibility of gauge"),
        ("driver", Level.UNIT, WiderInterface, "gauge offers no wipe"),
        ("driver", Level.UNIT, EventInterface, "gauge offers no events"),
    ],
)
def test_handles_are_refused_with_the_reason(robot, gauge, caller, level, interface, text):
    with pytest.raises(AccessDenied, match=text):
        robot.foreign.use(caller, level, "gauge", interface)


DEEP = msgspec.json.encode(info()).replace(b'{"type":"object"}', b'{"a":' + b"[" * 100_000)


@pytest.mark.parametrize(
    ("told", "text"),
    [
        (b"{", "truncated"),
        (b'{"name": "gauge"}', "missing required field `level`"),
        (msgspec.json.encode(info(level="king")), "expected level device, unit, skill, behavior, got 'king'"),
        (DEEP, "recursion"),
    ],
)
def test_one_that_does_not_say_what_it_is_stays_out_with_the_reason(robot, caplog, told, text):
    robot.join(told)
    robot.until(lambda: text in caplog.text)
    assert re.search("gauge is not listed|1 of robot_foreign_info .*gauge/info.*malformed", caplog.text)
    assert robot.foreign.infos() == []


def test_one_that_answers_late_is_asked_again(robot):
    session = open_session(connect=robot.connect)
    wire = Endpoint(session, "t", LiveClock(), Drive.LIVE)
    wire.token(plugin_messages.ROBOT_FOREIGN, robot="r1", plugin="gauge")
    robot.until(lambda: "gauge" in robot.foreign._due_ns)
    assert robot.foreign.infos() == []
    wire.answer(plugin_messages.ROBOT_FOREIGN_INFO, lambda request: info(), robot="r1", plugin="gauge")
    robot.until(lambda: "gauge" in robot.foreign)
    wire.close()
    session.close()
