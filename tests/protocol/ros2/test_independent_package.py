"""Against `zenoh-ros2-sdk`, an independent package for rmw_zenoh's wire, in a process of its own."""

import importlib.util
import json
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any, NamedTuple

import numpy as np
import pytest
import zenoh

from robrain.protocol.ros2.message_types import (
    LASER_SCAN,
    OCCUPANCY_GRID,
    SET_BOOL,
    STRING,
    LaserScan,
    Switch,
    TriggerResponse,
)
from robrain.protocol.ros2.qos import LATCHED
from robrain.protocol.ros2.ros_node import EntityKind, RosNode, RosPublisher, RosServer
from robrain.protocol.wire.session import listening_at, open_session
from tests.protocol.ros2.other_node import ask, response, tokens
from tests.protocol.ros2.real_ros import HAS_RCLPY, NEEDED, SHARE
from tests.waiting import PATIENCE_S, until

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(importlib.util.find_spec("zenoh_ros2_sdk") is None, reason="needs zenoh-ros2-sdk: .[dev]"),
    pytest.mark.skipif(not HAS_RCLPY, reason=f"the sdk reads definitions of ROS's own packages: {NEEDED}"),
]


class Sdk:
    """The other program."""

    def __init__(self, port: str) -> None:
        command = [sys.executable, "-m", "tests.protocol.ros2.sdk_peer", port, str(SHARE)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._told: deque[dict[str, Any]] = deque()
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def said(self, field: str) -> dict[str, Any]:
        """The next that it prints with a field; what it printed before is forgotten."""

        def found() -> dict[str, Any] | None:
            while self._told:
                if field in (told := self._told.popleft()):
                    return told
            assert self.process.poll() is None or self._told, "the other program has ended"
            return None

        return until(found, f"the other program never said {field}") or {}

    def ask(self, what: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(what + "\n")
        self.process.stdin.flush()

    def end(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        try:
            self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.process.wait()
            self._reading.join()
            self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self._told.extend(json.loads(line) for line in self.process.stdout)


class Both(NamedTuple):
    """The other program, and a node of robrain."""

    sdk: Sdk
    node: RosNode
    session: zenoh.Session
    scans: RosPublisher[LaserScan]
    switches: RosServer[Switch, TriggerResponse]


@pytest.fixture(scope="module")
def both() -> Iterator[Both]:
    with ExitStack() as stack:
        router = stack.enter_context(closing(open_session(mode="router", listen=("tcp/127.0.0.1:0",))))
        endpoint = listening_at(router)[0]
        session = stack.enter_context(closing(open_session(connect=(endpoint,))))
        node = stack.enter_context(closing(RosNode(session, "robrain", now_ns=time.time_ns)))
        scans = node.advertise("/robrain/scan", LASER_SCAN)
        switches = node.serve("/robrain/switch", SET_BOOL)
        grid = OCCUPANCY_GRID.blank(data=np.array([0, 100, -1, 50, 0, 0], np.int8))
        grid.info.width, grid.info.height = 3, 2
        node.advertise("/map", OCCUPANCY_GRID, LATCHED).publish(grid)  # before the other program begins
        sdk = Sdk(endpoint.rpartition(":")[2])
        stack.callback(sdk.end)
        yield Both(sdk, node, session, scans, switches)


def test_it_gets_the_latched_map_though_it_came_later(both):
    assert both.sdk.said("map") == {"map": [0, 100, -1, 50, 0, 0], "size": [3, 2]}


def test_it_hears_a_scan(both):
    until(lambda: [token for token in tokens(both.session, EntityKind.SUBSCRIPTION) if "%robrain%scan" in token])
    scan = LASER_SCAN.blank(ranges=np.array([0.5, 1.5], np.float32))
    scan.header.frame_id = "r1/laser"
    both.scans.publish(scan)
    assert both.sdk.said("scan") == {"scan": [0.5, 1.5], "frame": "r1/laser"}


def test_it_is_heard(both):
    heard = both.node.subscribe("/sdk/chatter", STRING)
    messages = until(heard.read)
    assert (messages[0].message.data, len(messages[0].gid), heard.refused) == ("hello", 16, 0)
    numbers = [each.number for each in messages + until(heard.read)]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert abs(messages[0].stamp_ns - time.time_ns()) < 600e9


def test_it_calls_a_service(both):
    both.sdk.ask("call")
    request = until(both.switches.requests)[0]
    request.reply(TriggerResponse(request.request.data, "from robrain"))
    assert both.sdk.said("success") == {"success": True, "message": "from robrain"}


def test_its_service_is_called(both):
    until(lambda: [token for token in tokens(both.session, EntityKind.SERVER) if "%sdk%switch" in token])
    replies = ask(both.session, "/sdk/switch", SET_BOOL, Switch(True))
    assert response(replies, SET_BOOL) == TriggerResponse(True, "from the sdk")
