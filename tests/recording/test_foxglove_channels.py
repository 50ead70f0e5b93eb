"""Channels for Foxglove, Lichtblick and Rerun: by the recorded messages and the clock alone."""

import json
import socket
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from foxglove_schemas_protobuf.Log_pb2 import Log

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid, PatchCells
from robrain.algorithms.slam.map_patch import to_message
from robrain.protocol.errors import WireError
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.motes.mote_messages import MOTE_READING, MoteReading
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, LogRecord
from robrain.protocol.messages.robots.robot_messages import (
    ROBOT_PATH,
    ROBOT_STATE,
    BatteryState,
    PlannedPath,
    RobotState,
)
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team.arena_messages import ARENA_SCAN, Scan
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.grid_geometry import GridGeometry
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.foxglove.channels import FoxgloveChannels
from robrain.recording.foxglove.server import FoxgloveServer
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recovering import with_visual
from robrain.recording.reader.two_runs import first_difference
from tests.recording.stage import depot_run
from tests.waiting import until

NS_PER_S = 1_000_000_000
SCAN = Scan(robot="r1", angle_min_rad=0.0, angle_increment_rad=0.1, range_max_m=5.0, ranges_mm=[1])
BATTERY = BatteryState(voltage_v=24.0, current_a=2.0, temperature_c=30.0, soc=0.5, remaining_j=1e5)
READING = MoteReading(mote="m1", place=Point2D(1, 1), quantity="t", value=1.0, voltage_v=3.0, rssi_dbm=-60.0, via="r1")


def told(channels: FoxgloveChannels, now_s: float) -> list[str]:
    return [message.channel for message in channels.due(round(now_s * NS_PER_S))]


def say(channels: FoxgloveChannels, topic: Topic, message: msgspec.Struct, key: str = "key") -> None:
    channels.handle(topic, key, msgspec.json.encode(message))


def spoken(**fields: Any) -> FoxgloveChannels:
    channels = FoxgloveChannels()
    say(channels, ROBOT_STATE, RobotState(robot="r1", **fields))
    return channels


def test_each_channel_has_its_rate() -> None:
    channels = FoxgloveChannels()
    counts: Counter[str] = Counter()
    for tenth in range(100):
        say(channels, ROBOT_STATE, RobotState(robot="r1", pose=Pose2D(tenth / 4, 0.0, 0.0), battery=BATTERY))
        say(channels, ARENA_SCAN, SCAN)
        say(channels, ROBOT_PATH, PlannedPath(robot="r1", points=[Point2D(1.0, 2.0)]))
        say(channels, MOTE_READING, READING)
        counts.update(told(channels, tenth / 10))
    assert counts == {
        "/visual/tf": 50, "/visual/r1/scan": 10, "/visual/r1/points": 5, "/visual/robots": 10, "/visual/r1/pose": 10,
        "/visual/r1/battery": 10, "/visual/r1/path": 10, "/visual/motes": 5, "/visual/r1/trail": 2,
    }  # fmt: skip


def test_a_clock_that_is_set_back_is_followed_at_once() -> None:
    channels = spoken(pose=Pose2D(1.0, 2.0, 0.0))
    times_s = (100.0, 100.5, 99.5, 99.5, 5.0, 5.9, 6.0)
    drawn = ["/visual/robots" in told(channels, t_s) for t_s in times_s]
    assert drawn == [True, False, True, False, True, False, True]


def trail_of(channels: FoxgloveChannels, now_s: float) -> list[tuple[float, float]]:
    [trail] = [one.message for one in channels.due(round(now_s * NS_PER_S)) if one.channel == "/visual/r1/trail"]
    return [(pose.position.x, pose.position.y) for pose in trail.poses]  # type: ignore[union-attr]


def test_a_trail_has_a_point_each_quarter_of_a_metre_and_the_last_two_hundred() -> None:
    channels = FoxgloveChannels()
    for second, x_m in enumerate((0.0, 0.24, 0.25, 0.5, 0.5)):
        say(channels, ROBOT_STATE, RobotState(robot="r1", pose=Pose2D(x_m, 1.0, 0.0)))
        told(channels, float(second))
    assert trail_of(channels, 5.0) == [(0.0, 1.0), (0.25, 1.0), (0.5, 1.0)]
    for second in range(6, 306):
        say(channels, ROBOT_STATE, RobotState(robot="r1", pose=Pose2D(float(second), 1.0, 0.0)))
        list(channels.due(second * NS_PER_S))
    assert trail_of(channels, 310.0) == [(float(second), 1.0) for second in range(106, 306)]


def logged(channels: FoxgloveChannels, now_ns: int = 99) -> list[tuple[int, str, str, int]]:
    lines: list[Any] = [one.message for one in channels.due(now_ns) if one.channel == "/visual/log"]
    return [(line.level, line.name, line.message, line.timestamp.ToNanoseconds()) for line in lines]


def test_the_log_says_who_and_why() -> None:
    channels = FoxgloveChannels()
    task = Task(id="t1", kind="visit", place=Point2D(1.0, 2.0))
    say(channels, TASK_EVENT, TaskEvent(stamp_ns=7, task=task, state=TaskState.RUNNING, robot="r1", why="near"))
    say(channels, ROBOT_LOG, LogRecord(robot="r1", level="debug", source="scan", text="fine"))
    say(channels, ROBOT_LOG, LogRecord(stamp_ns=8, robot="r1", level="error", source="scan", text="burnt"))
    say(channels, HALT, Halt(halted=True, by="ann", reason="smoke"))
    say(channels, HALT, Halt(stamp_ns=9, halted=False, by="bob"))
    assert logged(channels) == [
        (Log.INFO, "task", "t1 running at r1: near", 7),
        (Log.DEBUG, "r1 scan", "fine", 99),
        (Log.ERROR, "r1 scan", "burnt", 8),
        (Log.ERROR, "team", "emergency halt by ann: smoke", 99),
        (Log.ERROR, "team", "resume by bob", 9),
    ]
    assert logged(channels) == []


def drawn_tasks(channels: FoxgloveChannels, now_s: float) -> list[list[str]]:
    """Entities of each scene of tasks."""
    drawn: list[Any] = [one.message for one in channels.due(round(now_s * NS_PER_S)) if one.channel == "/visual/tasks"]
    return [[entity.id for entity in scene.entities] for scene in drawn]


def test_open_tasks_are_drawn_when_one_changes_and_again_in_a_new_file() -> None:
    channels = FoxgloveChannels()
    task = Task(id="t1", kind="visit", place=Point2D(1.0, 2.0))
    say(channels, TASK_EVENT, TaskEvent(task=task, state=TaskState.QUEUED))
    assert drawn_tasks(channels, 0.0) == [["task t1"]]
    assert drawn_tasks(channels, 10.0) == []
    channels.restart()
    assert drawn_tasks(channels, 20.0) == [["task t1"]]
    say(channels, TASK_EVENT, TaskEvent(task=task, state=TaskState.DONE))
    assert drawn_tasks(channels, 30.0) == [[]]
    channels.restart()
    assert drawn_tasks(channels, 40.0) == []


def patch(value: int, width: int = 10) -> MapPatch:
    grid = OccupancyGrid(GridGeometry(0.5, 0.0, 0.0, width, width))
    grid.merge_patch(0, 0, np.full((value, 3), 100, np.int8), value)
    return to_message("r1", grid.geometry, PatchCells(0, 0, grid.classes(), value))


# -- of a recorded run ---------------------------------------------------------------------------------------


def visual_of(path: Path) -> list[tuple[str, int, bytes]]:
    return [(m.topic_key, m.log_time_ns, m.payload) for m in read_messages(path) if is_visual(m.topic_key)]


@pytest.mark.slow
def test_channels_change_no_digest_and_can_be_made_anew_from_the_recording(run: Path, tmp_path: Path) -> None:
    assert recording_info(run).digest == depot_run().digest
    again = tmp_path / "again.mcap"
    assert with_visual(run, again) == len(visual_of(again)) == len(visual_of(run)) > 0
    assert visual_of(again) == visual_of(run)
    assert first_difference(run, again)[0] is None


def test_what_does_not_decode_is_left_out() -> None:
    channels = FoxgloveChannels()
    for topic, key in ((ROBOT_STATE, "a"), (ROBOT_MAP, "b"), (MOTE_READING, "c"), (TASK_EVENT, "d"), (ROBOT_LOG, "e")):
        for payload in (b"", b"\xff", b"[]", b"{}", b'{"robot":"r1"}', b"[" * 5000):
            channels.handle(topic, key, payload)
    drawn = [message.channel for message in channels.due(0)]
    assert drawn == []


def test_a_log_that_floods_is_bounded_between_two_steps() -> None:
    channels = FoxgloveChannels()
    for _ in range(5000):
        say(channels, ROBOT_LOG, LogRecord(robot="r1", level="info", source="x", text="y"))
    assert len(list(channels.due(0))) == 1000


@pytest.mark.parametrize("number", [-1, 2**31, 2**63 - 1, 2**63, 2**80, -(2**80), 1e300, -1e300, 5e-324])
def test_numbers_beyond_all_measure_stop_nobody(number: float) -> None:
    place = {"x_m": number, "y_m": -number}
    battery = {"voltage_v": number, "current_a": number, "temperature_c": number, "soc": number, "remaining_j": number}
    stamp = {"stamp_ns": int(number)}
    said: list[tuple[Topic, dict[str, Any]]] = [
        (ROBOT_STATE, {"robot": "r1", "pose": {**place, "yaw_rad": number}, "battery": battery, "radius_m": number}),
        (ROBOT_STATE, {"robot": "r1", **stamp}),
        (ARENA_SCAN, {"robot": "r1", "angle_min_rad": number, "angle_increment_rad": number, "range_max_m": number,
                      "ranges_mm": [0, -5, 2**40], **stamp}),
        (ROBOT_PATH, {"robot": "r1", "points": [place], **stamp}),
        (MOTE_READING, {"mote": "m1", "place": place, "quantity": "t", "value": number, "voltage_v": number,
                        "rssi_dbm": number, "via": "r1"}),
        (TASK_EVENT, {"task": {"type": "explore", "id": "t", "goal": place}, "state": "running", **stamp}),
        (ROBOT_LOG, {"robot": "r1", "level": "info", "source": "a", "text": "\x00", **stamp}),
        (HALT, {"halted": True, "by": "x", **stamp}),
        (ROBOT_MAP, {"robot": "r1", "resolution_m": number, "origin_x_m": number, "origin_y_m": number,
                     "width": int(number), "height": 3, "row": 0, "column": 0, "rows": 1, "columns": 1,
                     "observed_ms": 0, "cells": "eJxjAAAAAQAB"}),
    ]  # fmt: skip
    for topic, message in said:
        channels = FoxgloveChannels()
        channels.handle(topic, "key", json.dumps(message).encode())
        for visual in channels.due(NS_PER_S):
            assert visual.data() or visual.schema()


# -- served -----------------------------------------------------------------------------------------------------


def test_a_robot_that_is_new_is_asked_once_for_the_map_that_it_knows(
    wire: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    drawn: list[str] = []

    def answer(_: Any) -> MapPatch:
        asked.append("r1")
        return patch(1)

    class Heard(FoxgloveChannels):
        def handle(self, topic: Topic, key: str, payload: bytes) -> None:
            drawn.append(topic.name)
            super().handle(topic, key, payload)

    monkeypatch.setattr("robrain.recording.foxglove.server.FoxgloveChannels", Heard)
    server = FoxgloveServer(wire, "127.0.0.1", 0)
    try:
        wire.answer(ROBOT_MAP_WHOLE, answer, robot="r1")
        states = wire.publisher(ROBOT_STATE, robot="r1")
        for _ in range(2):
            states.put(RobotState(robot="r1", pose=Pose2D(1.0, 2.0, 0.0)))
            server.step()
        server.step()
    finally:
        server.close()
    assert asked == ["r1"]
    assert sorted(drawn) == ["robot_map", "robot_state", "robot_state"]


def test_a_port_that_is_taken_is_told_and_free_again_when_its_server_closes(wire: Endpoint) -> None:
    server = FoxgloveServer(wire, "127.0.0.1", 0)
    port = int(server.address.removeprefix("ws://127.0.0.1:"))
    try:
        with pytest.raises(WireError, match=f"cannot listen on 127.0.0.1:{port}"):
            FoxgloveServer(wire, "127.0.0.1", port)
    finally:
        server.close()
    until(lambda: not _listens(port), "the port is free again")  # the SDK closes its socket on a thread of its own


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
