"""Tasks without an id get the next free number of their kind."""

import pytest

from robrain.client.fresh_ids import FreshIds
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.tasks.task_messages import TaskRecord
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.tasks.task import Task, TaskState


class Coordinator:
    """Knows tasks by their ids, and by whom."""

    def __init__(self, **tasks: str) -> None:
        self.tasks = {name.replace("_", "-"): by for name, by in tasks.items()}
        self.same = False
        """Whether what is submitted is the same as what is there."""
        self.why = ""

    def submit(self, task_id: str) -> TaskRecord:
        if self.why:
            raise CallError(ErrorCode.REFUSED, self.why)
        if task_id in self.tasks and not self.same:
            raise CallError(ErrorCode.REFUSED, f"there is another task {task_id}")
        by = self.tasks.setdefault(task_id, "ann")
        return TaskRecord(task=Task(id=task_id, kind="visit", place=Point2D(0.0, 0.0)), state=TaskState.QUEUED, by=by)

    def ids(self, known: list[str] | None = None) -> FreshIds:
        return FreshIds(lambda _kind: list(self.tasks) if known is None else known, lambda task: task in self.tasks)


def test_numbers_go_on_from_the_largest_of_the_kind() -> None:
    coordinator = Coordinator(visit_2="bob", visit_x="bob", inspect_9="bob", visit_02x="bob")
    ids = coordinator.ids()
    assert [ids.submit("visit", coordinator.submit, "ann").task.id for _ in range(2)] == ["visit-3", "visit-4"]


@pytest.mark.parametrize("same", [False, True])
def test_an_id_that_another_took_meanwhile_is_left_to_it(same: bool) -> None:
    coordinator = Coordinator(visit_1="bob", visit_2="bob")
    coordinator.same = same
    assert coordinator.ids(known=[]).submit("visit", coordinator.submit, "ann").task.id == "visit-3"


def test_a_refusal_for_another_reason_is_raised_and_takes_no_number() -> None:
    coordinator = Coordinator()
    ids = coordinator.ids()
    coordinator.why = "no robot has an arm"
    with pytest.raises(CallError, match="no robot has an arm"):
        ids.submit("visit", coordinator.submit, "ann")
    coordinator.why = ""
    assert ids.submit("visit", coordinator.submit, "ann").task.id == "visit-1"


def test_an_error_that_is_no_refusal_is_raised_though_the_id_is_known() -> None:
    coordinator = Coordinator(visit_1="bob")

    def submit(_task_id: str) -> TaskRecord:
        raise CallError(ErrorCode.TIMEOUT, "no reply in time")

    with pytest.raises(CallError, match="no reply in time"):
        coordinator.ids(known=[]).submit("visit", submit, "ann")
