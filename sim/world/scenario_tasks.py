"""Tasks of a scenario: the arena submits them to the coordinator at their times, by the query that clients use."""

from collections.abc import Sequence
from typing import Any

import msgspec

from robrain.client.submission import BadTask, submission_of
from robrain.protocol.answers.later import Later
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.tasks.offer_messages import TASK_EVENT
from robrain.protocol.messages.tasks.task_messages import (
    TASK_EXPLAIN,
    TASK_SUBMIT,
    TaskRecord,
    TaskRequest,
    TaskSubmission,
)
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.wire.endpoint import Endpoint

SCENARIO = "scenario"
"""Requester of these tasks, in the records."""
AGAIN_S = 1.0
"""After this a task is submitted again if no coordinator was there."""
NO_COORDINATOR = "no coordinator was there to take it"
ABOUT_ITSELF = frozenset({"kind", "name", "at_s", "place_m", "parameters", "earliest_s", "deadline_s"})
"""Keys that a submission has not, or has under another name."""


class TaskSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[[tasks]]`: a task that the scenario submits. Raises ValueError for fields that its kind does not have.

    The coordinator may refuse it, as it refuses those of clients; the run's result then gives the reason.
    """

    kind: str
    """Kind of task, such as `visit`; see [tasks](tasks.md)."""
    place_m: tuple[float, float]
    """x and y in the arena frame."""
    name: str = ""
    """The task's id, and its name in `after`; `KIND-NUMBER`, counted over the file, if absent."""
    at_s: NotNegative = 0.0
    """Simulated time at which it is submitted."""
    priority: float = 1.0
    """Reward for doing it."""
    earliest_s: float | None = None
    """Earliest start, seconds from its acceptance."""
    deadline_s: float | None = None
    """Latest end, seconds from its acceptance."""
    service_s: float = 0.0
    """Expected time at its place; a visit stays this long."""
    needs: tuple[str, ...] = ()
    """Plugins that a robot must have for it."""
    after: tuple[str, ...] = ()
    """Names of tasks of this file that must be done before."""
    robots: int = 1
    """Number of robots that must work on it at the same time."""
    parameters: dict[str, Any] = msgspec.field(default_factory=dict)
    """Further parameters of its kind, as for `robrain task add`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            self.submission(self.name or self.kind)
        except BadTask as error:
            raise ValueError(str(error)) from error

    def submission(self, task_id: str) -> TaskSubmission:
        """Queries to the coordinator.

        Raises:
            BadTask: naming the wrong field.

        """
        fields = {name: value for name, value in msgspec.structs.asdict(self).items() if name not in ABOUT_ITSELF}
        times = {"earliest_in_s": self.earliest_s, "deadline_in_s": self.deadline_s}
        fields |= {name: value for name, value in times.items() if value is not None}
        fields |= {"id": task_id, "place": list(self.place_m), **self.parameters}
        submission = submission_of(self.kind, fields, typed={"place": "place_m", "id": "name"})
        return msgspec.structs.replace(submission, by=SCENARIO)


class TaskOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of a task of the scenario."""

    task: str
    """Its id."""
    kind: str
    state: TaskState | None = None
    """Its state at the end of the run; None if it was refused, or not submitted before the end."""
    robot: str = ""
    """The robot that has it, or had it when it ended."""
    why: str = ""
    """Reason for its refusal or state; empty if there is none."""
    ended_s: float | None = None
    """Simulated time of its end."""

    @property
    def words(self) -> str:
        """One line for the end of a run."""
        state = self.state.value.replace("_", " ") if self.state is not None else ""
        by = f" by {self.robot}" if self.robot and self.state in (TaskState.DONE, TaskState.RUNNING) else ""
        if not state:
            return f"task {self.task}: {self.why or 'not submitted before the end'}"
        if self.state is not None and not self.state.ended:  # the coordinator's sentence begins with the state
            return f"task {self.task}: {f'{state}{by}' if by or not self.why else self.why}"
        return f"task {self.task}: {state}{by}{f': {self.why}' if self.why else ''}"


def check_tasks(tasks: Sequence[TaskSpec]) -> None:
    """Check the names of tasks and their dependencies.

    Raises:
        ValueError: two have the same name, a task comes after one that there is not, or two after each other.

    """
    names = _names(tasks)
    for index, (task, name) in enumerate(zip(tasks, names, strict=True)):
        if name in names[:index]:
            raise ValueError(f"tasks[{index}]: expected each name once, got {name} twice")
        for other in task.after:
            if other not in names:
                raise ValueError(f"tasks[{index}].after: no task {other}; there are {', '.join(names)}")
    _in_order(tasks, names)


class TaskSchedule:
    """Submits tasks when they are due, and records their outcomes.

    A task that comes after others is submitted at its time as well, but not before them.

    Args:
        tasks: of the scenario.
        endpoint: of the arena.

    Raises:
        ValueError: the tasks are wrong; see `check_tasks`.

    """

    def __init__(self, tasks: Sequence[TaskSpec], endpoint: Endpoint) -> None:
        check_tasks(tasks)
        names = _names(tasks)
        self.is_on = bool(tasks)
        """Whether there are any, so that `step` must be called."""
        self._endpoint = endpoint
        self._outcomes = {name: TaskOutcome(task=name, kind=task.kind) for name, task in zip(names, tasks, strict=True)}
        order = _in_order(tasks, names)
        self._waiting = [(at_s, name, tasks[names.index(name)].submission(name)) for at_s, name in order]
        self._asked: list[tuple[TaskSubmission, Later[TaskRecord]]] = []
        self._open = set(names)
        self._inbox = Inbox()
        if self.is_on:
            endpoint.subscribe(self._inbox, TASK_EVENT)

    def outcomes(self) -> list[TaskOutcome]:
        """Outcome of each task so far, in the order of the file; for waiting tasks the coordinator gives the reason."""
        return [self._explained(outcome) for outcome in self._outcomes.values()]

    @property
    def all_ended(self) -> bool:
        """Whether each is done, failed, cancelled or refused."""
        return not self._open

    def step(self, sim_time_s: float) -> None:
        """Submit due tasks; receive answers and events."""
        while self._waiting and self._waiting[0][0] <= sim_time_s + 1e-9:
            _, _, submission = self._waiting.pop(0)
            self._asked.append((submission, self._endpoint.ask_later(TASK_SUBMIT, submission)))
        if self._asked:
            self._process_answers(sim_time_s)
        for received in self._inbox.drain():
            event = received.message
            self._record(event.task.id, event.state, event.robot, event.why, sim_time_s)

    def _explained(self, outcome: TaskOutcome) -> TaskOutcome:
        if outcome.state is None or outcome.state.ended:
            return outcome
        try:
            why = self._endpoint.ask(TASK_EXPLAIN, TaskRequest(id=outcome.task, by=SCENARIO)).now
        except (CallError, NobodyThere):
            return outcome
        return msgspec.structs.replace(outcome, why=why)

    def _process_answers(self, sim_time_s: float) -> None:
        asked, self._asked = self._asked, []
        for submission, later in asked:
            name = submission.task.id
            try:
                record = later.poll()
            except NobodyThere:
                self._waiting.insert(0, (sim_time_s + AGAIN_S, name, submission))  # those after it wait as well
                self._outcomes[name] = msgspec.structs.replace(self._outcomes[name], why=NO_COORDINATOR)
            except CallError as error:
                self._outcomes[name] = msgspec.structs.replace(self._outcomes[name], why=error.message)
                self._open.discard(name)
            else:
                if record is None:
                    self._asked.append((submission, later))
                elif self._outcomes[name].state is None:
                    self._record(name, record.state, record.robot, record.why, sim_time_s)

    def _record(self, name: str, state: TaskState, robot: str, why: str, sim_time_s: float) -> None:
        known = self._outcomes.get(name)
        if known is not None and known.state is not state:
            ended_s = round(sim_time_s, 3) if state.ended else None
            self._outcomes[name] = TaskOutcome(
                task=name, kind=known.kind, state=state, robot=robot, why=why, ended_s=ended_s
            )
            if state.ended:
                self._open.discard(name)


def _names(tasks: Sequence[TaskSpec]) -> list[str]:
    """The id of each task."""
    counts: dict[str, int] = {}
    names = []
    for task in tasks:
        counts[task.kind] = counts.get(task.kind, 0) + 1
        names.append(task.name or f"{task.kind}-{counts[task.kind]}")
    return names


def _in_order(tasks: Sequence[TaskSpec], names: Sequence[str]) -> list[tuple[float, str]]:
    """Time and name of each task in the order in which they are submitted; none before its dependencies."""
    at_s = {name: task.at_s for name, task in zip(names, tasks, strict=True)}
    after = {name: task.after for name, task in zip(names, tasks, strict=True)}
    order: list[tuple[float, str]] = []
    placed: set[str] = set()
    left = list(names)
    while left:
        free = [name for name in left if placed.issuperset(after[name])]
        if not free:
            raise ValueError(f"tasks: {' and '.join(left)} wait for each other")
        for name in free:
            begins_s = max([at_s[name], *(time_s for time_s, other in order if other in after[name])], default=0.0)
            order.append((begins_s, name))
            placed.add(name)
            left.remove(name)
    place = {name: index for index, (_, name) in enumerate(order)}
    return sorted(order, key=lambda due: (due[0], place[due[1]]))
