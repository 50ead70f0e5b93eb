"""A task's trace: its own unless another program gave one; it travels in the attachment of queries."""

import pytest

from robrain.protocol.answers.trace import KEPT, Traces, read_trace, trace_of
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, TaskAnswer, TaskOffer
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task
from tests.waiting import until

GIVEN = "4bf92f3577b34da6a3ce929d0e0e4736"


def test_every_process_knows_the_trace_of_a_task_that_nobody_gave_another():
    first, second = Traces("t"), Traces("t")
    assert first.of("visit-1") == second.of("visit-1") == trace_of("t", "visit-1")
    assert read_trace(first.of("visit-1").encode()) == first.of("visit-1")
    assert first.of("visit-2") != first.of("visit-1")


def test_given_trace_counts_and_the_oldest_are_forgotten():
    traces = Traces("t")
    traces.record("a", GIVEN)
    traces.record("a", "")
    assert traces.of("a") == GIVEN
    for number in range(KEPT):
        traces.record(f"b{number}", GIVEN)
    assert traces.of("a") == trace_of("t", "a")
    assert traces.of(f"b{KEPT - 1}") == GIVEN


@pytest.mark.parametrize(
    "attachment", [b"", b"0" * 32, GIVEN.upper().encode(), GIVEN.encode() + b"0", b"\xff" * 32, b"<script>" * 4]
)
def test_attachment_that_is_no_trace_is_none(attachment):
    assert read_trace(attachment) == ""


def test_trace_travels_with_the_query_and_anything_else_does_not(team):
    task = Task(id="visit-1", kind="visit", place=Point2D(0.0, 0.0))
    offer = TaskOffer(task=task, epoch=1, lease_s=1.0)
    heard = []
    coordinator, robot = team.join(), team.join()

    def take(request):
        heard.append(request.trace)
        return TaskAnswer(accepted=True)

    robot.answer(ROBOT_OFFER, take, robot="r1")

    def offered(trace):
        reply = coordinator.ask_later(ROBOT_OFFER, offer, robot="r1", trace=trace)
        return until(lambda: _answer(reply), "no answer")

    until(lambda: offered("") == "accepted", "the robot is not there")
    heard.clear()
    for trace in (GIVEN, "", "x" * 32):
        assert offered(trace) == "accepted"
    assert heard == [GIVEN, "", ""]


def _answer(reply):
    try:
        answer = reply.poll()
    except (CallError, NobodyThere) as error:
        return str(error)
    return "accepted" if answer is not None and answer.accepted else ""
