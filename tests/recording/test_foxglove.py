"""What Foxglove, Lichtblick and Rerun draw: real schemas, derived from the recorded topics alone."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from robrain.protocol.messages.motes.mote_messages import MoteReading
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import (
    ARENA_SCAN,
    HALT,
    MOTE_READING,
    ROBOT_LOG,
    ROBOT_MAP,
    ROBOT_PATH,
    ROBOT_STATE,
    TASK_EVENT,
)
from robrain.recording.foxglove.channels import FoxgloveChannels
from robrain.recording.foxglove.visual_topics import is_visual
from robrain.recording.reader.reading import read_messages, recording_info
from robrain.recording.reader.recovering import with_visual
from robrain.recording.reader.two_runs import first_difference
from robrain.sim.scenarios.scenario import Scenario

RUN_S = 12.0
NS_PER_S = 1_000_000_000
SCHEMAS = {
    "/visual/robots": "foxglove.SceneUpdate",
    "/visual/motes": "foxglove.SceneUpdate",
    "/visual/tasks": "foxglove.SceneUpdate",
    "/visual/walls": "foxglove.SceneUpdate",
    "/visual/wall_points": "foxglove.PointCloud",
    "/visual/tf": "foxglove.FrameTransforms",
    "/visual/map": "foxglove.Grid",
    "/visual/log": "foxglove.Log",
    "/visual/r1/scan": "foxglove.LaserScan",
    "/visual/r1/points": "foxglove.PointCloud",
    "/visual/r1/pose": "foxglove.PoseInFrame",
    "/visual/r1/path": "foxglove.PosesInFrame",
    "/visual/r1/trail": "foxglove.PosesInFrame",
    "/visual/r1/battery": "robrain.Battery",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    Scenario.builtin("depot").replace(robots=2, motes=8).run(time_limit_s=RUN_S, record=path)
    return path


def decoded(path: Path, channel: str) -> list[Any]:
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [found.decoded_message for found in reader.iter_decoded_messages(topics=[channel])]


def visual_of(path: Path) -> list[tuple[str, int, bytes]]:
    return [(m.topic_key, m.log_time_ns, m.payload) for m in read_messages(path) if is_visual(m.topic_key)]


def test_every_channel_is_there_with_the_schema_by_which_viewers_draw_it(run: Path) -> None:
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    found = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()
             if is_visual(channel.topic)}  # fmt: skip
    assert SCHEMAS.items() <= found.items()


def test_robots_are_drawn_where_they_say_to_be(run: Path) -> None:
    transforms = decoded(run, "/visual/tf")
    states = [
        msgspec.json.decode(m.payload, type=RobotState) for m in read_messages(run) if m.topic_key.endswith("r1/state")
    ]
    by_stamp = {state.stamp_ns: state.pose for state in states}
    seen = 0
    for message in transforms:
        for transform in message.transforms:
            if transform.child_frame_id == "r1":
                pose = by_stamp[transform.timestamp.ToNanoseconds()]
                assert pose is not None
                assert (transform.translation.x, transform.translation.y) == (pose.x_m, pose.y_m)
                assert 2 * np.arctan2(transform.rotation.z, transform.rotation.w) == pytest.approx(pose.yaw_rad)
                seen += 1
    assert seen == len(transforms) >= 5 * (RUN_S - 1)


def test_the_last_message_of_a_scene_holds_all_of_it(run: Path) -> None:
    [*_, robots] = decoded(run, "/visual/robots")
    assert sorted(entity.id for entity in robots.entities) == ["robot r1", "robot r2"]
    assert {entity.frame_id for entity in robots.entities} == {"r1", "r2"}
    assert [deletion.type for deletion in robots.deletions] == [1]
    [*_, walls] = decoded(run, "/visual/walls")
    assert len(walls.entities[0].cubes) > 10


@pytest.mark.slow
def test_the_digest_and_what_went_over_the_wire_are_the_same_with_and_without(run: Path, tmp_path: Path) -> None:
    plain = tmp_path / "plain.mcap"
    result = Scenario.builtin("depot").replace(robots=2, motes=8).run(time_limit_s=RUN_S)
    assert recording_info(run).digest == result.digest
    with_visual(run, plain)
    assert first_difference(run, plain)[0] is None


def test_they_can_be_made_anew_from_the_recording_and_are_the_same(run: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    made = with_visual(run, again)
    assert made == len(visual_of(again)) == len(visual_of(run))
    assert visual_of(again) == visual_of(run)


def test_what_does_not_decode_is_left_out() -> None:
    channels = FoxgloveChannels()
    for topic, key in ((ROBOT_STATE, "a"), (ROBOT_MAP, "b"), (MOTE_READING, "c"), (TASK_EVENT, "d"), (ROBOT_LOG, "e")):
        for payload in (b"", b"\xff", b"[]", b"{}", b'{"robot":"r1"}', b"[" * 5000):
            channels.handle(topic, key, payload)
    drawn = [message.channel for message in channels.due(0)]
    assert drawn == []


def test_tasks_leave_the_scene_when_they_end() -> None:
    channels = FoxgloveChannels()

    def say(state: TaskState, now_ns: int) -> list[Any]:
        event = TaskEvent(
            stamp_ns=now_ns, task=Task(id="t1", kind="visit", place=Point2D(1.0, 2.0)), state=state, why="because"
        )
        channels.handle(TASK_EVENT, "task", msgspec.json.encode(event))
        return [message.message for message in channels.due(now_ns) if message.channel == "/visual/tasks"]

    [open_] = say(TaskState.RUNNING, 0)
    assert [entity.id for entity in open_.entities] == ["task t1"]
    [ended] = say(TaskState.DONE, 2_000_000_000)
    assert list(ended.entities) == []


def test_a_log_that_floods_is_bounded_between_two_steps() -> None:
    channels = FoxgloveChannels()
    line = msgspec.json.encode(LogRecord(robot="r1", level="info", source="x", text="y"))
    for _ in range(5000):
        channels.handle(ROBOT_LOG, "log", line)
    assert len(list(channels.due(0))) == 1000


def test_a_reading_of_a_mote_whose_place_is_not_known_is_not_drawn() -> None:
    channels = FoxgloveChannels()
    reading = MoteReading(mote="m1", place=None, quantity="t", value=1.0, voltage_v=3.0, rssi_dbm=-60.0, via="r1")
    channels.handle(MOTE_READING, "m1", msgspec.json.encode(reading))
    [scene] = [message.message for message in channels.due(0) if message.channel == "/visual/motes"]
    assert list(scene.entities) == []  # type: ignore[union-attr]


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
