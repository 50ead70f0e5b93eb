"""Each kind of task, done by one robot among two motes."""

import io
import itertools
import math

import numpy as np
import pytest
from PIL import Image

from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_IMAGE
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.robot.camera import PLATE
from tests.plugins.behavior.errands import MOTES, TEAM

# -- inspect --------------------------------------------------------------------------------------------------------


def test_an_inspection_publishes_a_picture_of_what_was_to_be_seen(errands):
    run = errands("inspect")
    images = run.inbox(ROBOT_IMAGE, robot="r1")
    status = run.finish(Task(id="i", kind="inspect", place=Point2D(2.0, 2.5), parameters={"look_at": MOTES[2]}))
    assert status.state is TaskState.DONE
    ((topic, key, png),) = images.drain_raw()
    assert topic.encoding == "image/png"
    assert key == status.result["image"] == ROBOT_IMAGE.key(TEAM, robot="r1", image="inspect-0")
    pixels = np.asarray(Image.open(io.BytesIO(png)), np.float64)
    plate = np.abs(pixels / pixels.sum(axis=2, keepdims=True) - PLATE / PLATE.sum()).sum(axis=2) < 0.1
    assert abs(np.flatnonzero(plate.any(axis=0)).mean() - 80) < 12  # the mote's plate, in the middle
    toward_rad = math.atan2(MOTES[2].y_m - run.pose().y_m, MOTES[2].x_m - run.pose().x_m)
    assert status.result["yaw_rad"] == pytest.approx(toward_rad, abs=0.1)


def test_without_a_picture_an_inspection_has_failed_with_why(errands):
    run = errands("inspect")
    camera = run.plugin("camera")
    camera.deactivate()
    status = run.finish(Task(id="i", kind="inspect", place=Point2D(2.0, 2.5)))
    assert (status.state, status.why) == (TaskState.FAILED, "camera: the camera is not open")


# -- motes ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_mule_brings_what_a_mote_has_stored(errands):
    run = errands("collect", parameters={"snw_exploration": {"collect": False}})
    run.run(20.0)
    heard = run.inbox(MOTE_READING, mote="m2")
    status = run.finish(Task(id="c", kind="collect", place=MOTES[2], parameters={"mote": "m2"}))
    assert status.state is TaskState.DONE
    told = {received.message.sequence for received in heard.drain()}
    assert status.result["readings"] == len(told) >= 1
    assert status.result["missing"] == 0


def test_a_mote_that_says_nothing_lets_the_mule_fail_after_its_time(errands):
    run = errands("collect")
    begun_ns = run.clock.now_ns()
    status = run.finish(
        Task(id="c", kind="collect", place=Point2D(2.0, 2.0), parameters={"mote": "m99", "timeout_s": 10.0})
    )
    assert (status.state, status.why) == (TaskState.FAILED, "nothing came from m99 in 10 s")
    assert 10e9 < run.clock.now_ns() - begun_ns < 20e9


@pytest.mark.slow
def test_a_relay_whose_link_is_too_weak_moves_nearer_and_no_farther_than_it_may(errands):
    run = errands("relay", parameters={"relay": {"stray_m": 1.8, "adjust_s": 2.0}})
    place = Point2D(1.0, 3.0)
    before_m = math.hypot(place.x_m - MOTES[1].x_m, place.y_m - MOTES[1].y_m)
    status = run.finish(
        Task(id="r", kind="relay", place=place, parameters={"mote": "m1", "duration_s": 15.0, "rssi_min_dbm": -20.0})
    )
    assert run.pose().distance_m(MOTES[1]) < before_m - 0.5
    assert 0.5 < status.result["moved_m"] <= 1.9
    assert status.result["share_linked"] == 0.0


@pytest.mark.slow
def test_a_relay_between_a_mote_and_a_robot_goes_where_it_hears_both(errands):
    bound_dbm = -77.0
    run = errands("relay", starts={"r2": Pose2D(1.0, 3.2, 0.0)})
    place = Point2D(5.3, 1.0)
    status = run.finish(
        Task(
            id="r",
            kind="relay",
            place=place,
            parameters={"mote": "m1", "robot": "r2", "duration_s": 30.0, "rssi_min_dbm": bound_dbm},
        ),
        limit_s=150.0,
    )
    mate, end = Point2D(1.0, 3.2), run.pose()
    assert end.distance_m(mate) < math.hypot(place.x_m - mate.x_m, place.y_m - mate.y_m) - 0.6
    assert status.result["robot_packets"] > 25
    assert status.result["share_linked"] > 0.5
    link = {heard["robot"]: heard for heard in run.call("snw_exploration", "robots")}["r2"]
    assert link["rssi_dbm"] > bound_dbm - 6.0


def test_no_robot_is_a_relay_to_itself(errands):
    run = errands("relay")
    answer = run.offer(
        Task(id="r", kind="relay", place=Point2D(2.6, 3.2), parameters={"robot": "r1", "duration_s": 30.0})
    )
    assert (answer.accepted, answer.why) == (False, "a robot is no relay to itself")


def test_a_robot_brings_the_reading_of_a_mote(errands):
    run = errands("sense")
    heard = run.inbox(MOTE_READING, mote="m1")
    status = run.finish(Task(id="s", kind="sense", place=Point2D(4.0, 1.3), parameters={"mote": "m1"}))
    assert (status.state, status.result["mote"]) == (TaskState.DONE, "m1")
    assert status.result["value"] in {received.message.value for received in heard.drain()}


@pytest.mark.parametrize(
    ("task", "why"),
    [
        (
            Task(id="s", kind="sense", place=Point2D(2.0, 2.0), parameters={"quantity": "radon_bq"}),
            "the board does not sense radon_bq: it has ",
        ),
        (
            Task(id="s", kind="sense", place=Point2D(2.0, 2.0), parameters={"mote": "m99", "timeout_s": 5.0}),
            "m99 was not heard in 5 s",
        ),
    ],
)
def test_what_cannot_be_sensed_has_failed_with_why(errands, task, why):
    status = errands("sense").finish(task)
    assert status.state is TaskState.FAILED
    assert status.why.startswith(why)


def test_who_replaces_a_mote_senses_at_its_place_and_speaks_in_its_name(errands):
    run = errands("replace")
    told = run.inbox(MOTE_READING, mote="m1")
    status = run.finish(
        Task(id="r", kind="replace", place=MOTES[1], parameters={"mote": "m1", "duration_s": 10.0, "period_s": 2.0})
    )
    assert (status.state, status.result["readings"]) == (TaskState.DONE, 5)
    readings = [received.message for received in told.drain()]
    own = [reading for reading in readings if reading.rssi_dbm == 0.0 and reading.period_s == 2.0]
    assert len(own) == 5 * 3
    assert {reading.via for reading in own} == {"r1"}
    assert {reading.quantity for reading in own} == {"temperature_c", "light_lx", "humidity_pct"}
    assert all(abs(reading.place.x_m - MOTES[1].x_m) < 0.3 for reading in own)
    stamps_s = sorted({round(reading.measured_ns / 1e9) for reading in own})
    assert [later - earlier for earlier, later in itertools.pairwise(stamps_s)] == [2, 2, 2, 2]


# -- monitor --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_has_changed_in_a_room_is_told_with_the_picture_and_once(errands):
    run = errands("monitor", "visit", starts={"r2": Pose2D(5.3, 3.3, 0.0)})
    told, images = run.inbox(ROBOT_EVENT, robot="r1", plugin="monitor"), run.inbox(ROBOT_IMAGE, robot="r1")
    assert run.offer(
        Task(id="m", kind="monitor", place=Point2D(1.5, 2.0), parameters={"duration_s": 40.0, "interval_s": 8.0})
    ).accepted
    run.run(14.0)
    assert told.drain() == []
    assert run.offer(Task(id="v", kind="visit", place=Point2D(3.4, 2.6), service_s=300.0), "r2").accepted
    run.run(30.0)
    changes = [received.message.value for received in told.drain()]
    published = [key for _, key, _ in images.drain_raw()]
    assert 1 <= len(changes) <= 3  # some may see it come
    assert [change["image"] for change in changes] == published
    assert {change["task"] for change in changes} == {"m"}
    bearing_rad = math.atan2(2.6 - 2.0, 3.4 - 1.5)
    assert all(abs(change["yaw_rad"] - bearing_rad) < 0.8 for change in changes)
    assert all(change["share"] >= 0.002 for change in changes)
    assert run.status().result["changes"] == len(changes)
