"""Offers of a live coordinator: nobody waits for the answer of a robot that does not give one."""

from collections.abc import Iterator

import pytest

from robrain.coordinator.tasks.task_lifecycle import Offers
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW, TaskAnswer, TaskWithdrawal
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.endpoint import Drive, Endpoint, Serve
from robrain.protocol.wire.session import open_session
from tests.waiting import PATIENCE_S, until


def record(robot: str) -> TaskRecord:
    task = Task(id=f"for-{robot}", kind="visit", place=Point2D(1.0, 2.0))
    return TaskRecord(task=task, state=TaskState.OFFERED, robot=robot, epoch=3)


def fails(_request: object) -> TaskAnswer:
    raise CallError(ErrorCode.FAILED, "it broke")


@pytest.fixture
def wire() -> Iterator[Endpoint]:
    """Of a coordinator; the robot `stopped` is at the same session, and nobody ever steps it."""
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as session:
        wire = Endpoint(session, "default", LiveClock(), Drive.LIVE)
        for topic in (ROBOT_OFFER, ROBOT_WITHDRAW):
            wire.answer(topic, fails, serve=Serve.IN_STEP, robot="stopped")
        yield wire
        wire.close()


def test_each_robots_answer_comes_when_it_comes(wire: Endpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robrain.coordinator.tasks.task_lifecycle.ASK_TIMEOUT_S", 10 * PATIENCE_S)
    answers = {"r1": TaskAnswer(accepted=True), "r2": TaskAnswer(accepted=False, why="no way there")}
    for name, answer in answers.items():
        wire.answer(ROBOT_OFFER, lambda _request, answer=answer: answer, robot=name)
    wire.answer(ROBOT_OFFER, fails, robot="r3")
    offers = Offers(wire)
    for robot in ("stopped", "r1", "r2", "r3", "gone"):
        offers.offer(record(robot), "")
    offers.withdraw("stopped", TaskWithdrawal(id="t", epoch=2))
    found: dict[str, TaskAnswer] = {}

    def hear() -> None:
        found.update({one.record.robot: one.answer for one in offers.answered()})

    until(lambda: len(found) >= 4, "four robots have answered", step=hear)
    assert found["r1"].accepted
    assert found["r2"].why == "no way there"
    assert found["r3"].why == "it broke"
    assert "nobody answers" in found["gone"].why
    assert set(found) == {"r1", "r2", "r3", "gone"}
    assert [one.record.robot for one in offers._asked] == ["stopped"]  # nobody has waited for it
    assert [one.robot for one in offers._withdrawn] == ["stopped"]


def test_a_robot_that_never_answers_has_said_nothing_and_is_listened_for_no_longer(
    wire: Endpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robrain.coordinator.tasks.task_lifecycle.ASK_TIMEOUT_S", 0.1)
    offers = Offers(wire)
    offers.offer(record("stopped"), "")
    offers.withdraw("stopped", TaskWithdrawal(id="t", epoch=2))
    found = []
    until(
        lambda: not (offers._asked or offers._withdrawn),
        "both are given up",
        step=lambda: found.extend(offers.answered()),
    )
    assert found == []
