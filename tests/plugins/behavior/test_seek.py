"""Seek: one robot finds the source of a plume in a small room."""

import math
from collections.abc import Iterator

import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.sim.motes.field import FieldSpec, Levels, Plume, SimulatedField
from tests.plugins.behavior.errands import Build, open_errands

SOURCE = Point2D(4.6, 2.9)
HOT = FieldSpec(plumes=1, width_m=1.5, wind_m_s=0.0, temperature=Levels(base=20.0, plume=10.0, noise=0.1))


@pytest.fixture
def errands() -> Iterator[Build]:
    yield from open_errands()


def heat(run, source=SOURCE, spec=HOT):
    """From now on the room's field is one plume here, or none."""
    plumes = [] if source is None else [Plume(source.x_m, source.y_m, 0.0, 0.0)]
    field = SimulatedField(spec, plumes, Point2D(-10.0, -10.0), (40.0, 40.0))
    run.arena._field = run.arena._motes._field = field


def seek(**parameters):
    return Task(id="s", kind="seek", place=Point2D(2.0, 2.0), parameters=parameters)


@pytest.mark.slow
def test_the_source_is_found_and_told_with_its_place_and_value(errands):
    run = errands("seek")
    heat(run)
    told = run.inbox(ROBOT_EVENT, plugin="seek")
    status = run.finish(seek(), 240.0)
    assert (status.state, status.why) == (TaskState.DONE, "")
    found = status.result
    assert math.hypot(found["x_m"] - SOURCE.x_m, found["y_m"] - SOURCE.y_m) < 0.25
    assert found["value"] == pytest.approx(30.0, abs=1.0)
    assert found["samples"] > 10
    assert found["at_wall"] is False
    assert run.pose().distance_m(SOURCE) < 2.0
    (event,) = [received.message for received in told.drain()]
    assert (event.event, event.value["place"]["x_m"]) == ("found", found["x_m"])
    assert run.arena.collisions == 0


@pytest.mark.slow
def test_in_a_flat_field_the_robot_ends_with_why(errands):
    run = errands("seek")
    heat(run, None)
    status = run.finish(seek(reach_m=2.0), 240.0)
    assert (status.state, status.why) == (TaskState.FAILED, "temperature_c rises nowhere within 2 m")


def test_time_is_limited(errands):
    run = errands("seek")
    heat(run)
    status = run.finish(seek(duration_s=5.0), 60.0)
    assert (status.state, status.why) == (TaskState.FAILED, "no source of temperature_c was found in 5 s")


def test_without_a_board_motes_that_are_heard_are_not_enough_here_and_it_says_so(errands, monkeypatch):
    run = errands("seek")
    board = run.plugin("sensor_board")

    def silent():
        raise CallError(ErrorCode.FAILED, "no sensor board answers")

    monkeypatch.setattr(board, "measure", silent)
    monkeypatch.setattr("robrain.plugins.behavior.seek.RECEIVED_S", 0.0)
    status = run.finish(seek(), 120.0)
    assert status.state is TaskState.FAILED
    assert status.why.startswith("nothing tells temperature_c")
