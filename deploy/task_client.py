"""The Python client of a team's tasks.

from robrain import TaskClient
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.task import Visit

with TaskClient(connect="tcp/127.0.0.1:7447") as tasks:
    tasks.submit(Visit(id="look-1", place=Point2D(3.0, 4.0)))
    print(tasks.wait("look-1").state)
"""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from typing import Self, TypeVar

from robrain.deploy.live_process import client_session, live_endpoint
from robrain.protocol.model.objective import Objective
from robrain.protocol.model.task import Task, TaskState
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.wire.hub import teams_there, wrong_team
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.keys import DEFAULT_TEAM, check_name
from robrain.protocol.wire.messages import TaskEvent
from robrain.protocol.wire.plan_messages import ObjectiveRequest, PlanningStatus
from robrain.protocol.wire.task_messages import TaskFilter, TaskRecord, TaskRequest, TaskSubmission, TaskWhy
from robrain.protocol.wire.topic import Q, Query, R
from robrain.protocol.wire.topics import (
    COORDINATOR_OBJECTIVE,
    COORDINATOR_PLANNING,
    TASK_CANCEL,
    TASK_EVENT,
    TASK_GET,
    TASK_LIST,
    TASK_SUBMIT,
    TASK_WHY,
)

T = TypeVar("T")

ASK_TIMEOUT_S = 2.0
AGAIN_S = 0.25
POLL_S = 0.02
LOOK_S = 1.0
"""Changes are heard as they are told; so often is also asked, for what was missed."""
_NOT_NOW = (ErrorCode.TIMEOUT, ErrorCode.UNLOADED, ErrorCode.BUSY)


class TaskClient:
    """Asks a team's coordinator for tasks; use it in a `with` block.

    While the coordinator is away, e.g. restarting, each query is repeated until it is answered or `patience_s` is over.
    That is safe: a task's id makes a submission count once, however often it arrives.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        by: name of the requester, for the records.
        patience_s: how long to wait for a coordinator.

    Raises:
        NobodyThere: nothing answers at the endpoint.
        WireError: the endpoint is invalid.
        BadName: the team's name is invalid.

    """

    def __init__(
        self, connect: str | None = None, *, team: str = DEFAULT_TEAM, by: str = "", patience_s: float = 5.0
    ) -> None:
        self._by = by
        self._patience_s = patience_s
        self._open = ExitStack()
        check_name("team", team)
        session = self._open.enter_context(client_session(connect))
        self._wire: Endpoint = self._open.enter_context(live_endpoint(session, team))

    def submit(
        self, task: Task, *, earliest_in_s: float | None = None, deadline_in_s: float | None = None
    ) -> TaskRecord:
        """Have a task done; the same task again has the same answer.

        Args:
            task: its id is its name; no other task may have it.
            earliest_in_s: counted from its acceptance, in place of `earliest_ns`.
            deadline_in_s: counted from its acceptance, in place of `deadline_ns`.

        Raises:
            CallError: it is refused, with the reason (`refused`), or is no task (`bad_arguments`).
            NobodyThere: no coordinator answers.

        """
        asked = TaskSubmission(task=task, by=self._by, earliest_in_s=earliest_in_s, deadline_in_s=deadline_in_s)
        return self._ask(TASK_SUBMIT, asked)

    def cancel(self, task_id: str, why: str = "") -> TaskRecord:
        """End a task unfinished; its robot is told to stop (CallError if it has ended otherwise)."""
        return self._ask(TASK_CANCEL, TaskRequest(id=task_id, by=self._by, why=why))

    def get(self, task_id: str) -> TaskRecord:
        """How a task stands (CallError if there is none of that id)."""
        return self._ask(TASK_GET, TaskRequest(id=task_id))

    def why(self, task_id: str) -> TaskWhy:
        """Why a task stands as it does (CallError if there is none of that id)."""
        return self._ask(TASK_WHY, TaskRequest(id=task_id))

    def planning(self, objective: Objective | None = None) -> PlanningStatus:
        """How the team's tasks are planned; with an objective, plans are for that from now on."""
        if objective is None:
            return self._ask(COORDINATOR_PLANNING, None)
        return self._ask(COORDINATOR_OBJECTIVE, ObjectiveRequest(objective=objective, by=self._by))

    def list(self, wanted: TaskFilter | None = None) -> list[TaskRecord]:
        """The tasks that match, in the order in which they were accepted."""
        return self._ask(TASK_LIST, wanted or TaskFilter())

    def wait(self, task_id: str, *, timeout_s: float | None = None) -> TaskRecord:
        """Wait until a task has ended (TimeoutError if it has not in time), and return how."""
        for _ in self.events([task_id], timeout_s=timeout_s):
            pass
        return self.get(task_id)

    def events(self, task_ids: Iterable[str] = (), *, timeout_s: float | None = None) -> Iterator[TaskEvent]:
        """Each change of some tasks, beginning with how they stand, until all of them have ended.

        A change that happens while nobody can be heard may be missed; how a task ends never is.

        Args:
            task_ids: of which; without any, of all tasks, without end.
            timeout_s: how long to go on at most; None is for ever.

        Raises:
            CallError: there is no task of an id.
            NobodyThere: no coordinator answers.
            TimeoutError: they have not all ended in time.

        """
        wanted = list(dict.fromkeys(task_ids))
        inbox = Inbox(4096)
        for task_id in wanted:
            self._wire.subscribe(inbox, TASK_EVENT, task=task_id)
        if not wanted:
            self._wire.subscribe(inbox, TASK_EVENT)
        return self._events(inbox, wanted, timeout_s)

    def close(self) -> None:
        """Leave the team."""
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _events(self, inbox: Inbox, wanted: Sequence[str], timeout_s: float | None) -> Iterator[TaskEvent]:
        last: dict[str, int] = {}
        running = set(wanted)
        ends_s = None if timeout_s is None else time.monotonic() + timeout_s
        look_s = time.monotonic()
        while True:
            events = [received.message for received in inbox.drain()]
            if wanted and time.monotonic() >= look_s:
                events += [self.get(task_id).event for task_id in sorted(running)]
                look_s = time.monotonic() + LOOK_S
            for event in events:
                if event.change > last.get(event.task.id, 0):
                    last[event.task.id] = event.change
                    yield event
                if event.state.ended:
                    running.discard(event.task.id)
            if wanted and not running:
                return
            if ends_s is not None and time.monotonic() > ends_s:
                raise TimeoutError(f"not ended after {timeout_s:g} s: {', '.join(sorted(running)) or 'all tasks'}")
            time.sleep(POLL_S)

    def _ask(self, topic: Query[Q, R], request: Q | None) -> R:
        gives_up_s = time.monotonic() + self._patience_s
        while True:
            try:
                return self._wire.ask(topic, request, timeout_s=ASK_TIMEOUT_S)
            except NobodyThere as error:
                if time.monotonic() > gives_up_s:
                    raise self._no_coordinator() from error
            except CallError as error:
                if error.code not in _NOT_NOW or time.monotonic() > gives_up_s:
                    raise
            time.sleep(AGAIN_S)

    def _no_coordinator(self) -> NobodyThere:
        text = f"no coordinator of team {self._wire.team} answers"
        if self._wire.team in teams_there(self._wire.session):
            return NobodyThere(f"{text}; `robrain coordinator` starts one")
        return wrong_team(text, self._wire.session)


def open_states() -> list[TaskState]:
    """The states of tasks that have not ended, for filters."""
    return [state for state in TaskState if not state.ended]
