"""The Rust plugin as its robot sees it; `make test-rust` builds and runs it."""

import os
import subprocess
import time
from pathlib import Path
from typing import Protocol

import pytest

from robrain.agent.isolation.foreign_plugins import ForeignPlugins
from robrain.agent.plugin import Level
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.wire.topics import ROBOT_FOREIGN_CALL

PATIENCE_S = 10.0
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", Path(__file__).parents[2] / ".cache" / "rust-target"))
BINARY = TARGET / "release" / "gauge"


class GaugeInterface(Protocol):
    def read(self) -> float: ...

    def add(self, a: int, b: int) -> int: ...


class Robot:
    """A hub, the Rust process, and what the host of the robot r1 has of foreign plugins."""

    def __init__(self):
        self.hub = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
        self.wire = Endpoint(self.hub, "default", WallClock(), Drive.LIVE)
        self.foreign = ForeignPlugins(self.wire, "r1")
        environment = {**os.environ, "ROBRAIN_CONNECT": ",".join(listening_at(self.hub))}
        self.gauge = subprocess.Popen([BINARY, "r1"], env=environment, stdout=subprocess.PIPE, text=True)
        assert self.gauge.stdout.readline() == "gauge of r1 is up\n"
        self.until(lambda: "gauge" in self.foreign)

    def until(self, condition):
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline_s, "it has not come to pass"
            self.foreign.follow()
            time.sleep(0.005)

    def close(self):
        self.gauge.kill()
        self.gauge.communicate()
        self.wire.close()
        self.hub.close()


@pytest.fixture(scope="module")
def shared():
    robot = Robot()
    yield robot
    robot.close()


@pytest.fixture
def gauge(shared):
    return shared.foreign


def test_it_is_listed_with_its_functions_and_their_types(gauge):
    (info,) = gauge.infos()
    assert (info.name, info.level, info.state, info.visibility) == ("gauge", "device", "active", ["command", "*"])
    functions = {function.name: function for function in info.functions}
    assert functions["read"].returns == {"type": "number"}
    assert functions["add"].parameters["required"] == ["a", "b"]
    assert functions["add"].signature == "(a: int, b: int) -> int"


def test_it_is_called_from_outside(gauge):
    assert 19.0 <= gauge.call("gauge", "read") <= 21.0
    assert gauge.call("gauge", "add", [2, 3]) == 5
    assert gauge.call("gauge", "add", {"b": 2, "a": -3}) == -1


def test_it_is_called_from_inside_by_an_interface(gauge):
    handle = gauge.use("driver", Level.UNIT, "gauge", GaugeInterface)
    assert isinstance(handle.read(), float)
    assert handle.add(2, b=40) == 42


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([1], "argument b is missing"),
        ([1, "two"], 'argument b: expected an integer, got "two"'),
        ([1, 2.5], "argument b: expected an integer, got 2.5"),
        ([1, 2, 3], "takes 2 arguments, got 3"),
        ({"a": 1, "c": 2}, "no argument c"),
        (7, "expected an array or an object"),
        ([2**63 - 1, 1], "is too large"),
    ],
)
def test_bad_arguments_are_named(gauge, arguments, text):
    with pytest.raises(CallError) as caught:
        gauge.call("gauge", "add", arguments)
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS
    assert text in caught.value.message


def test_what_is_no_json_is_a_bad_argument(gauge):
    with pytest.raises(CallError) as caught:
        gauge.relay("gauge", "add", b"[1, \xff")
    assert caught.value.code is ErrorCode.BAD_ARGUMENTS


def test_a_function_that_it_has_not_is_its_own_error_too(shared):
    with pytest.raises(CallError, match="gauge has no function wipe; it has: read, add") as caught:
        shared.wire.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="gauge", function="wipe")
    assert caught.value.code is ErrorCode.UNKNOWN_FUNCTION


def test_it_is_gone_when_it_is_killed():
    robot = Robot()
    try:
        robot.gauge.kill()
        robot.until(lambda: "gauge" not in robot.foreign)
        with pytest.raises(NobodyThere):
            robot.wire.ask(ROBOT_FOREIGN_CALL, robot="r1", plugin="gauge", function="read")
    finally:
        robot.close()
