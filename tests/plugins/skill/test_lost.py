"""A robot that does not know where it is takes on nothing, looks for itself slowly, and goes on once it is found."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from robrain.plugins.behavior.lost_search import SPEED_M_S, TASK_PATIENCE_S, LostSearch
from robrain.plugins.skill.mapper.frames import Frames
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.model.tasks.task import Task, TaskState
from tests.plugins.behavior.errands import CHARGER, Build, Errands, open_errands

FAR = Point2D(5.0, 3.0)
WHY = "walls and wheels disagree"
SAYS = f"r1 does not know where it is: {WHY}"


PATIENCE_S = 25.0
"""Shorter than that of the product."""


@pytest.fixture
def errands() -> Iterator[Build]:
    yield from open_errands("visit")


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.plugins.behavior.travel.PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(LostSearch.step, "__defaults__", (PATIENCE_S,))


def lose(run: Errands) -> None:
    """Have localisation say that it is lost, and not find itself on the map of the team, until `find`."""
    run.plugin("localisation")._localiser.lose(WHY)
    frames(run).search = lambda *_: None


def find(run: Errands) -> None:
    """Have it know again."""
    here = run.robot().board.pose
    truth = run.pose()
    frames(run)._join(ARENA, truth.compose(here.inverse()), truth, np.diag((1e-4, 1e-4, 1e-4)))


def frames(run: Errands) -> Frames:
    return run.plugin("mapper")._frames


def speed_m_s(run: Errands) -> float:
    velocity = run.robot().board.velocity
    return math.hypot(velocity.forward_m_s, velocity.left_m_s)


def test_a_lost_robot_refuses_what_it_is_offered_and_says_why(errands):
    run = errands("explore", "recharge")
    lose(run)
    run.run(0.3)
    for task in (
        Task(id="v", kind="visit", place=FAR),
        Task(id="x", kind="explore", place=FAR),
        Task(id="c", kind="recharge", place=CHARGER),
    ):
        answer = run.offer(task)
        assert (answer.accepted, answer.why) == (False, SAYS)
    find(run)
    run.run(0.3)
    assert run.finish(Task(id="v", kind="visit", place=FAR)).state is TaskState.DONE


@pytest.mark.slow
@pytest.mark.parametrize(
    "task", [Task(id="t", kind="visit", place=FAR, service_s=1.0), Task(id="t", kind="explore", place=FAR)]
)
def test_a_task_pauses_while_the_robot_looks_for_itself_slowly_and_then_goes_on(errands, task):
    run = errands("explore")
    explore = run.plugin("explore")
    explore._is_seen = lambda *_: False  # there is nothing unknown in this room
    assert run.offer(task).accepted
    run.run(2.0)
    paths = run.inbox(ROBOT_PATH, robot="r1")
    lose(run)
    run.run(1.5)
    assert paths.drain()[-1].message.points == []
    path_m = run.path_m()
    for _ in range(60):
        run.run(0.2)
        assert speed_m_s(run) <= SPEED_M_S + 0.01
    assert run.status().state is TaskState.RUNNING
    assert run.path_m() - path_m > 2.0  # what localisation needs to find it by motes
    assert run.arena.collisions == 0
    find(run)
    for _ in range(100):
        run.run(0.2)
        if run.status().state.ended:
            break
    assert run.status().state is TaskState.DONE, run.status().why
    assert run.pose().distance_m(FAR) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("task", [Task(id="t", kind="visit", place=FAR), Task(id="t", kind="explore", place=FAR)])
def test_others_do_the_task_of_a_robot_that_maps_in_a_frame_of_its_own(errands, task):
    run = errands("explore")
    run.plugin("explore")._is_seen = lambda *_: False
    assert run.offer(task).accepted
    run.run(1.0)
    lose(run)
    run.run(TASK_PATIENCE_S - 1.0)
    assert run.status().state is TaskState.RUNNING
    run.run(3.0)
    assert run.status().state is TaskState.FAILED
    assert "does not know where it is" in run.status().why


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_one_that_does_not_find_itself_stands_until_it_is_found(errands):
    run = errands("idle")
    lose(run)
    run.run(PATIENCE_S - 5.0)
    assert run.robot().board.behavior == "find itself"
    run.run(10.0)
    path_m = run.path_m()
    run.run(15.0)
    assert run.path_m() == path_m
    assert run.robot().board.behavior == "idle"
