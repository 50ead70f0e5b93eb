"""Orders of ROS 2 nodes: checked as any other caller's, and never more waiting than there may be."""

import json
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from robrain.client.halting import HaltReport
from robrain.deploy.ros2.gateway_process import TEXT_MAX, WAITING_MAX, TeamOrders, halt, submit
from robrain.protocol.errors import NobodyThere
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState


class KeptTeam:
    """A team that does what the test says."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.may_answer = threading.Event()
        self.may_answer.set()
        self.report: HaltReport | Exception = NobodyThere("nobody is there")
        self.is_closed = False

    def submit(self, kind: str, **fields: Any) -> TaskRecord:
        self.may_answer.wait()
        self.asked.append((kind, fields))
        if kind == "dance":
            raise NobodyThere("no robot can dance")
        return TaskRecord(task=Task(id="v", kind=kind, place=Point2D(1, 2)), state=TaskState.QUEUED)

    def halt(self, *, reason: str, by: str) -> HaltReport:
        if isinstance(self.report, Exception):
            raise self.report
        return self.report

    def close(self) -> None:
        self.is_closed = True


def test_a_task_is_submitted_with_its_fields():
    team: Any = KeptTeam()
    answer = submit(team, '{"kind": "visit", "place": [1, 2], "priority": 3}')
    assert (answer.accepted, json.loads(answer.text)["task"]["id"]) == (True, "v")
    ((kind, fields),) = team.asked
    assert (kind, fields["place"], fields["priority"], fields["id"]) == ("visit", (1.0, 2.0), 3.0, None)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "expected a task as JSON"),
        ("{}", "expected a task as JSON"),
        ('{"kind": "visit", "place": [1]}', "expected a task as JSON"),
        ('{"kind": "visit", "colour": "red"}', "expected a task as JSON"),
        ("[" * 100_000, "characters, got 100000"),
        ("[" * (TEXT_MAX - 1), "expected a task as JSON"),
        ('{"kind": "dance"}', "no robot can dance"),
    ],
)
def test_what_is_no_task_is_answered_with_the_reason(text, why):
    answer = submit(KeptTeam(), text)  # type: ignore[arg-type]
    assert (answer.accepted, why in answer.text) == (False, True)


def test_a_halt_says_who_has_not_stopped():
    team: Any = KeptTeam()
    assert halt(team, "ros2") == (False, "nobody is there")
    team.report = HaltReport(halted=True, by="ros2", confirmed=("r1",), unconfirmed={"r2": "lost"})
    assert halt(team, "ros2") == (False, "r1: halted; r2: NOT halted: lost")
    team.report = HaltReport(halted=True, by="ros2", confirmed=("r1",), unconfirmed={})
    assert halt(team, "ros2") == (True, "r1: halted")


@pytest.fixture
def desks() -> Iterator[tuple[TeamOrders, KeptTeam, KeptTeam]]:
    """Orders, and the teams that get tasks and halts."""
    teams = [KeptTeam(), KeptTeam()]
    made: Any = iter(teams)
    orders = TeamOrders(lambda: next(made), "ros2")
    yield orders, *teams
    teams[0].may_answer.set()
    orders.close()
    assert [team.is_closed for team in teams] == [True, True]


def test_orders_beyond_those_that_may_wait_are_refused_and_a_halt_waits_for_none(desks):
    orders, tasks, _ = desks
    tasks.may_answer.clear()
    waiting = [orders.submit('{"kind": "visit"}') for _ in range(WAITING_MAX)]
    assert orders.submit('{"kind": "visit"}').result(0) == (False, f"{WAITING_MAX} orders wait already")
    assert orders.halt().result(60) == (False, "nobody is there")
    tasks.may_answer.set()
    assert all(future.result(60).accepted for future in waiting)
