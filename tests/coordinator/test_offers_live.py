"""Offers of a live coordinator: nobody waits for the answer of a robot that does not give one."""

import time

from robrain.coordinator.offers import Offers
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import TaskState, Visit
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint, Serve
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.messages import TaskAnswer, TaskWithdrawal
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.task_messages import TaskRecord
from robrain.protocol.wire.topics import ROBOT_OFFER, ROBOT_WITHDRAW
from tests.waiting import PATIENCE_S


def record(robot: str) -> TaskRecord:
    task = Visit(id=f"for-{robot}", place=Point2D(1.0, 2.0))
    return TaskRecord(task=task, state=TaskState.OFFERED, robot=robot, epoch=3)


def fails(_request: object) -> TaskAnswer:
    raise CallError(ErrorCode.FAILED, "it broke")


def test_each_robots_answer_comes_when_it_comes() -> None:
    with open_session(mode="router", listen=["tcp/127.0.0.1:0"]) as session:
        wire = Endpoint(session, "default", WallClock(), Drive.LIVE)
        answers = {"r1": TaskAnswer(accepted=True), "r2": TaskAnswer(accepted=False, why="no way there")}
        for name, answer in answers.items():
            wire.answer(ROBOT_OFFER, lambda _request, answer=answer: answer, robot=name)
        wire.answer(ROBOT_OFFER, fails, robot="r3")
        wire.answer(ROBOT_OFFER, fails, serve=Serve.IN_STEP, robot="stopped")  # nobody ever steps it
        wire.answer(ROBOT_WITHDRAW, fails, serve=Serve.IN_STEP, robot="stopped")
        try:
            offers = Offers(wire, 1.5)
            began_s = time.monotonic()
            for robot in ("stopped", "r1", "r2", "r3", "gone"):
                offers.offer(record(robot), "")
            offers.withdraw("stopped", TaskWithdrawal(id="t", epoch=2))
            assert time.monotonic() - began_s < 0.4  # a stopped robot alone would take half a second
            found = {}
            while time.monotonic() - began_s < 1.0 or len(found) < 4:
                assert time.monotonic() - began_s < PATIENCE_S
                found |= {one.record.robot: one.answer for one in offers.answered()}
                time.sleep(0.01)
            assert found["r1"].accepted
            assert found["r2"].why == "no way there"
            assert found["r3"].why == "it broke"
            assert "nobody answers" in found["gone"].why
            assert set(found) == {"r1", "r2", "r3", "gone"}
            assert not offers._asked
            assert not offers._withdrawn
        finally:
            wire.close()
