"""Changes of tasks become spans: each state once, and the whole task at its end."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.deploy.observability import task_spans
from robrain.deploy.observability.task_spans import TaskSpan, TaskSpans
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent

TRACE = "4bf92f3577b34da6a3ce929d0e0e4736"
QUEUED, OFFERED, RUNNING, DONE = TaskState.QUEUED, TaskState.OFFERED, TaskState.RUNNING, TaskState.DONE


def event(change: int, state: TaskState, robot: str = "", task: str = "t1", **more: object) -> TaskEvent:
    told = Task(id=task, kind="visit", place=Point2D(0.0, 0.0))
    return TaskEvent(task=told, state=state, robot=robot, change=change, stamp_ns=to_ns(float(change)), **more)


def spans_of(*events: TaskEvent) -> list[TaskSpan]:
    spans = TaskSpans()
    return [span for one in events for span in spans.take(one, TRACE)]


def test_each_state_is_a_span_within_that_of_the_task() -> None:
    *states, whole = spans_of(
        event(1, QUEUED),
        event(2, OFFERED, "r1"),
        event(4, RUNNING, "r1", why="it said yes"),
        event(9, DONE, "r1", result={"energy_j": 12.5, "path": ["no", "number"]}),
    )
    assert [(one.name, one.start_ns, one.end_ns) for one in states] == [
        ("queued", to_ns(1.0), to_ns(2.0)),
        ("offered at r1", to_ns(2.0), to_ns(4.0)),
        ("running at r1", to_ns(4.0), to_ns(9.0)),
    ]
    assert (whole.name, whole.start_ns, whole.end_ns, whole.parent) == ("task visit", to_ns(1.0), to_ns(9.0), "")
    assert whole.attributes["robrain.result.energy_j"] == 12.5
    assert "robrain.result.path" not in whole.attributes
    assert states[2].attributes["robrain.why"] == "it said yes"
    assert {one.trace for one in (*states, whole)} == {TRACE}
    assert {one.parent for one in states} == {whole.span}
    assert len({one.span for one in (*states, whole)}) == 4
    assert all(len(one.span) == 16 and int(one.span, 16) for one in (*states, whole))


def test_changes_that_come_again_make_no_second_span_and_others_the_same_ids() -> None:
    changes = [event(1, QUEUED), event(2, OFFERED, "r1"), event(3, DONE, "r1")]
    assert spans_of(changes[0], changes[1], changes[0], changes[1], changes[2]) == spans_of(*changes)


def test_failed_task_says_why() -> None:
    *_, whole = spans_of(event(1, QUEUED), event(2, TaskState.FAILED, why="no way there"))
    assert whole.error == "no way there"
    *_, whole = spans_of(event(1, QUEUED), event(2, TaskState.CANCELLED, why="not needed"))
    assert whole.error == ""


def test_task_that_is_first_heard_of_at_its_end_makes_no_span() -> None:
    assert spans_of(event(7, DONE, "r1"), event(7, DONE, "r1")) == []


def test_of_too_many_tasks_the_longest_known_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_spans, "OPEN_MAX", 2)
    spans = TaskSpans()
    for number in range(3):
        spans.take(event(1 + number, QUEUED, task=f"t{number}"), TRACE)
    assert spans.left_out == 1
    assert not spans.knows("t0")
    assert spans.knows("t2")


@given(st.lists(st.tuples(st.sampled_from(["t1", "t2"]), st.integers(1, 20), st.sampled_from(TaskState)), max_size=40))
def test_spans_end_after_they_begin_whatever_comes(changes: list[tuple[str, int, TaskState]]) -> None:
    spans = spans_of(*(event(number, state, "r1", task) for task, number, state in changes))
    assert all(span.start_ns <= span.end_ns for span in spans)
    whole = [span for span in spans if not span.parent]
    assert len(whole) <= len(spans) / 2
