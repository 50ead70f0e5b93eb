import zlib

import msgspec
import numpy as np
import pytest

from robrain.dashboard.html.team_html import task_text
from robrain.dashboard.state.shown_robot import SILENT_AFTER_S, TRAIL_POINTS, RobotContact
from robrain.dashboard.state.shown_team import HISTORY_POINTS, ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, MapPatch
from robrain.protocol.messages.message import Message
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.robots import robot_messages
from robrain.protocol.messages.robots.robot_messages import PlannedPath, RobotState, TaskStatus
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT, TaskEvent
from robrain.protocol.messages.team import arena_messages
from robrain.protocol.messages.team.arena_messages import ArenaClock, ArenaTruth, MoteTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, HALT, Halt, RobotSummary, TeamState
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.reasons import Gone
from robrain.protocol.topic import Topic
from robrain.protocol.wire.presence import Change
from tests.mote_readings import reading

S = 10**9


def tell(view: ShownTeam, topic: Topic, message: Message, now_s: float = 0.0, **names: str) -> None:
    view.apply(Received(topic, topic.name, {"team": "default", **names}, message), now_s)


def tell_place(view: ShownTeam, robot: str, x_m: float, now_s: float = 0.0) -> None:
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot=robot, pose=Pose2D(x_m, 0.0, 0.0)), now_s, robot=robot)


def token(robot: str, present: bool) -> Change:
    return Change({"team": "default", "robot": robot}, present)


def patch(
    cells: list[list[int]], *, observed_ms: int = 0, row: int = 0, column: int = 0, robot: str = "r1"
) -> MapPatch:
    box = np.array(cells, np.int8)
    return MapPatch(
        robot=robot,
        resolution_m=0.5,
        origin_x_m=-1.0,
        origin_y_m=-2.0,
        width=4,
        height=3,
        row=row,
        column=column,
        rows=box.shape[0],
        columns=box.shape[1],
        observed_ms=observed_ms,
        cells=zlib.compress(box.tobytes()),
    )


@pytest.fixture
def view() -> ShownTeam:
    return ShownTeam()


def test_robot_is_named_by_its_key_not_by_what_it_says(view: ShownTeam) -> None:
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot="r2"), robot="r1")
    assert list(view.robots) == ["r1"]


def test_robot_with_a_token_and_an_old_state_is_silent(view: ShownTeam) -> None:
    view.apply_presence(token("r1", True))
    robot = view.robots["r1"]
    assert robot.contact(0.0) is RobotContact.SILENT
    tell_place(view, "r1", 0.0, now_s=10.0)
    assert robot.contact(10.0 + SILENT_AFTER_S) is RobotContact.UP
    assert robot.contact(10.1 + SILENT_AFTER_S) is RobotContact.SILENT


def test_robot_whose_token_went_is_lost_at_once_and_comes_back(view: ShownTeam) -> None:
    assert view.apply_presence(token("r1", True))
    tell_place(view, "r1", 0.0, now_s=1.0)
    assert not view.apply_presence(token("r1", False))
    assert view.robots["r1"].contact(1.0) is RobotContact.LOST
    assert view.apply_presence(token("r1", True))
    assert view.robots["r1"].contact(1.0) is RobotContact.UP


def test_trail_keeps_steps_and_is_bounded(view: ShownTeam) -> None:
    for centimetre in range(100):
        tell_place(view, "r1", centimetre / 100)
    trail = view.robots["r1"].trail
    assert 9 <= len(trail) <= 11
    for metre in range(2 * TRAIL_POINTS):
        tell_place(view, "r1", float(metre))
    assert len(trail) == TRAIL_POINTS
    assert trail[-1] == Point2D(2 * TRAIL_POINTS - 1, 0.0)


def test_later_statements_about_the_map_win_in_any_order(view: ShownTeam) -> None:
    tell(view, ROBOT_MAP, patch([[0, 100, -1, 0]], observed_ms=2000), robot="r1")
    tell(view, ROBOT_MAP, patch([[100, 0, 0, -1]], observed_ms=1000, robot="r2"), robot="r2")
    assert view.map.grid is not None
    assert view.map.grid.classes()[0].tolist() == [0, 100, 0, 0]
    tell(view, ROBOT_MAP, patch([[100]], observed_ms=3000, row=2, column=3), robot="r1")
    assert view.map.known_area_m2 == pytest.approx(5 * 0.25)
    assert view.rejected == 0


@pytest.mark.parametrize(
    "changes",
    [
        {"cells": b"not deflated"},
        {"cells": zlib.compress(b"\0" * 11)},  # too few
        {"cells": zlib.compress(b"\0" * 50_000_000)},  # a bomb, of which no more than a patch is unpacked
        {"rows": 0},
        {"rows": 1, "columns": 5000, "cells": zlib.compress(bytes(5000))},  # wider than any submap
        {"width": 1 << 20, "height": 1 << 20},  # would fill the memory
        {"resolution_m": 0.0},
        {"resolution_m": 1e300},  # cannot be drawn
        {"origin_x_m": 1e300},
    ],
)
def test_patch_that_makes_no_sense_is_refused_and_leaves_no_grid(view: ShownTeam, changes: dict[str, object]) -> None:
    good = patch([[0] * 4] * 3)
    tell(view, ROBOT_MAP, msgspec.structs.replace(good, **changes), robot="r1")
    assert view.rejected == 1
    assert view.map.grid is None
    tell(view, ROBOT_MAP, good, robot="r1")
    assert view.map.known_area_m2 == 3.0


def test_goal_is_the_tasks_and_else_the_end_of_the_path(view: ShownTeam) -> None:
    tell(view, robot_messages.ROBOT_PATH, PlannedPath(robot="r1", points=[Point2D(0, 0), Point2D(1, 1)]), robot="r1")
    robot = view.robots["r1"]
    assert view.goal_of(robot) == Point2D(1, 1)
    task = Task(id="t1", kind="explore", place=Point2D(5, 5))
    running = TaskStatus(id="t1", epoch=1, state=TaskState.RUNNING)
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot="r1", task=running), robot="r1")
    tell(view, TASK_EVENT, TaskEvent(task=task, state=TaskState.RUNNING, robot="r1"))
    assert view.goal_of(robot) == Point2D(5, 5)
    tell(view, TASK_EVENT, TaskEvent(task=task, state=TaskState.DONE, robot="r1"))
    assert view.goal_of(robot) == Point2D(1, 1)
    assert view.tasks == {}


def test_motes_keep_the_latest_of_each_quantity_and_a_place(view: ShownTeam) -> None:
    truth = ArenaTruth(sim_time_s=1.0, robots=[], motes=[MoteTruth(mote="m1", place=Point2D(3, 4))])
    tell(view, arena_messages.ARENA_TRUTH, truth)
    for stamp_ns, (quantity, value) in enumerate([("light", 1.0), ("temperature", 20.0), ("light", 2.0)]):
        tell(view, MOTE_READING, reading(quantity=quantity, value=value, stamp_ns=stamp_ns), mote="m1")
    mote = view.motes["m1"]
    assert mote.place == Point2D(3, 4)
    assert {quantity: one.value for quantity, one in mote.readings.items()} == {
        "light": 2.0,
        "temperature": 20.0,
    }
    assert mote.latest is not None
    assert mote.latest.quantity == "light"


def test_an_old_reading_out_of_a_mote_s_log_does_not_take_the_place_of_a_newer_one(view: ShownTeam) -> None:
    tell(view, MOTE_READING, reading(sequence=5, value=20.0, measured_ns=100 * S, stamp_ns=100 * S), mote="m1")
    tell(view, MOTE_READING, reading(sequence=3, value=18.0, measured_ns=92 * S, stamp_ns=101 * S), mote="m1")
    assert view.motes["m1"].readings["t"].value == 20.0
    tell(view, MOTE_READING, reading(sequence=6, value=21.0, measured_ns=104 * S, stamp_ns=104 * S), mote="m1")
    assert view.motes["m1"].readings["t"].value == 21.0


def test_halt_of_the_team_counts_until_its_end(view: ShownTeam) -> None:
    assert not view.halted
    tell(view, HALT, Halt(halted=True, by="somebody"))
    assert view.halted
    tell(view, HALT, Halt(halted=False, by="somebody"))
    assert not view.halted


def test_late_joiner_sees_by_a_halted_robot_that_the_team_is_halted(view: ShownTeam) -> None:
    tell(view, robot_messages.ROBOT_STATE, RobotState(robot="r1", halted=True), robot="r1")
    assert view.halted


def test_explored_share_is_kept_for_a_long_run_in_bounded_space(view: ShownTeam) -> None:
    for second in range(5000):
        truth = ArenaTruth(sim_time_s=float(second), robots=[], explored_fraction=second / 5000)
        tell(view, arena_messages.ARENA_TRUTH, truth)
    assert view.explored_fraction == pytest.approx(0.9998)
    assert HISTORY_POINTS / 2 <= len(view.explored) <= HISTORY_POINTS
    assert view.explored[0][0] == 0.0
    assert view.explored[-1][0] > 4980


def test_clock_that_starts_over_begins_another_run(view: ShownTeam) -> None:
    view.apply_presence(token("r1", True))
    tell(view, arena_messages.ARENA_CLOCK, ArenaClock(sim_time_s=100.0))
    tell(view, ROBOT_MAP, patch([[0]]), robot="r1")
    tell_place(view, "r1", 1.0)
    tell(
        view, arena_messages.ARENA_CLOCK, ArenaClock(sim_time_s=99.5)
    )  # two topics tell the time, and may overtake each other
    assert (view.runs, view.sim_time_s) == (1, 100.0)
    tell(view, arena_messages.ARENA_CLOCK, ArenaClock(sim_time_s=0.0))
    assert (view.runs, view.sim_time_s) == (2, 0.0)
    assert view.map.grid is None
    assert not view.robots["r1"].trail
    assert view.robots["r1"].present


def test_robot_that_has_gone_stays_until_the_coordinator_lists_it_no_more(view: ShownTeam) -> None:
    gone = RobotSummary(name="r1", up=False, age_s=400.0, task="visit-3", out=Gone())
    tell(view, COORDINATOR_STATE, TeamState(robots=[gone]))
    assert task_text(view.robots["r1"], view) == "gone for 7 min, with visit-3"
    tell(view, COORDINATOR_STATE, TeamState(robots=[]))
    assert not view.robots
