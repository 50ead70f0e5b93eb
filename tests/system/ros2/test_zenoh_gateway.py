"""`robrain ros2 gateway --zenoh` shows a live team to a node of ROS 2, which sends a task and halts all."""

import json
import time
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
import zenoh

from robrain.protocol.ros2 import message_types as ros
from robrain.protocol.ros2.message_types import Nothing, String, TaskText
from robrain.protocol.ros2.qos import LATCHED, SENSOR_DATA
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.wire.session import open_session
from tests.protocol.ros2.other_node import NoReply, ask, response, tokens
from tests.waiting import until

pytestmark = pytest.mark.system


@pytest.fixture
def session(commands) -> Iterator[zenoh.Session]:
    """Of a node, beside a team of one robot and its gateway."""
    endpoint = commands.team(1)
    gateway = commands.start("ros2", "gateway", "--zenoh", "--connect", endpoint, "--domain", "3")
    assert "in ROS domain 3; orders" in commands.line_with(gateway, "ros2 gateway: team default")
    with closing(open_session(connect=(endpoint,))) as opened:
        yield opened


def heard(reader: Any, wanted: Any = lambda message: True) -> Any:
    """The first message that is as wanted."""
    found: list[Any] = []
    until(lambda: found.extend(each.message for each in reader.read() if wanted(each.message)) or found)
    return found[0]


def text_of(shown: Any) -> set[str]:
    return {each.text for each in shown.markers}


def called(session: zenoh.Session, name: str, kind: ros.ServiceType[Any, Any], request: Any) -> Any:
    """A response; it is asked again until there is one, since on a busy machine one may be late."""

    def call() -> list[Any]:
        try:
            return [response(ask(session, name, kind, request, domain=3), kind)]
        except NoReply:
            return []

    return until(call)[0]


def test_a_node_sees_the_team_sends_a_task_and_halts_all(session) -> None:
    with closing(RosNode(session, "rviz", domain=3, now_ns=time.time_ns)) as node:
        maps = node.subscribe("/robrain/map", ros.OCCUPANCY_GRID, LATCHED)
        poses = node.subscribe("/robrain/r1/pose", ros.POSE_STAMPED)
        scans = node.subscribe("/robrain/r1/scan", ros.LASER_SCAN, SENSOR_DATA)
        transforms = node.subscribe("/tf", ros.TF_MESSAGE)
        paths = node.subscribe("/robrain/r1/path", ros.PATH, LATCHED)
        markers = node.subscribe("/robrain/markers", ros.MARKER_ARRAY, LATCHED)
        batteries = node.subscribe("/robrain/r1/battery", ros.BATTERY_STATE)
        node_answers = node.subscribe("/robrain/task_answers", ros.STRING)
        events = node.subscribe("/robrain/task_events", ros.STRING)
        grid = heard(maps, lambda grid: (grid.data == 100).any())
        assert grid.data.size == grid.info.width * grid.info.height
        assert heard(poses).header.frame_id == "map"
        assert heard(scans).header.frame_id == "r1/base_link"
        assert heard(transforms).transforms[0].child_frame_id == "r1/base_link"
        assert 0.0 < heard(batteries).percentage <= 1.0
        heard(markers, lambda shown: "r1" in text_of(shown))
        assert [token for token in tokens(session, "NN", domain=3) if token.endswith("%robrain/gateway")]

        tasks = (session, "/robrain/submit_task", ros.SUBMIT_TASK)
        visit = TaskText('{"kind": "visit", "place": [2, 1], "id": "from-ros"}')
        answer = until(lambda: (end := called(*tasks, visit)).accepted and end)
        assert json.loads(answer.answer)["by"] == "ros2"
        assert heard(paths, lambda path: len(path.poses) > 1).header.frame_id == "map"
        assert heard(events, lambda event: '"from-ros"' in event.data)
        refused = called(*tasks, TaskText('{"kind": "dance", "place": [2, 1]}'))
        assert (refused.accepted, "dance" in refused.answer) == (False, True)
        node.advertise("/robrain/submit_task", ros.STRING).publish(String("dance"))
        assert '"accepted":false' in heard(node_answers).data

        until(lambda: called(session, "/robrain/halt", ros.TRIGGER, Nothing()).success)
        heard(markers, lambda shown: "r1 halted" in text_of(shown))
