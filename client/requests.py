"""Queries to a team: to its coordinator, which may be restarting, and to its robots."""

from collections.abc import Callable
from typing import TypeVar

from robrain.client.members import no_robot, team_found
from robrain.client.transport import Transport
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.tasks import consensus_messages, task_messages
from robrain.protocol.messages.tasks.consensus_messages import CancelAcceptance, TaskAcceptance
from robrain.protocol.messages.tasks.task_messages import TaskRecord, TaskRequest, TaskSubmission
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import TaskState
from robrain.protocol.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.hub import teams_there, wrong_team

ASK_TIMEOUT_S = 2.0
ROBOT_TIMEOUT_S = 10.0
"""Minimum time limit for a robot's answer; its host may be busy."""
AGAIN_S = 0.25
KEPT_S = 5.0
"""Time limit until more than half of the team has a task; robots exchange ballots five times a second."""
SHOWN_WHYS = 3
_NOT_NOW = (ErrorCode.TIMEOUT, ErrorCode.UNLOADED, ErrorCode.BUSY)


_A = TypeVar("_A", TaskAcceptance, CancelAcceptance)
"""A robot's answer to a request that the whole team has to receive."""


class Requests:
    """Sends queries, and repeats them where that is safe.

    Args:
        transport: to the team.
        wire: the client's endpoint.

    """

    def __init__(self, transport: Transport, wire: Endpoint) -> None:
        self._transport = transport
        self._wire = wire

    def coordinator(self, topic: Query[Q, R], request: Q | None) -> R:
        """Query the coordinator, repeatedly while it is away, until the transport's patience is over.

        Raises:
            CallError: it refuses.
            NobodyThere: no coordinator answers.

        """
        transport = self._transport
        gives_up_s = transport.elapsed_s() + transport.patience_s
        while True:
            try:
                return self._wire.ask(topic, request, timeout_s=max(topic.timeout_s, ASK_TIMEOUT_S))
            except NobodyThere as error:
                if transport.elapsed_s() >= gives_up_s:
                    raise self._no_coordinator() from error
            except CallError as error:
                if error.code not in _NOT_NOW or transport.elapsed_s() >= gives_up_s:
                    raise
            transport.pass_time(AGAIN_S)

    def submit(self, asked: TaskSubmission) -> TaskRecord:
        """Submit a task to the coordinator, or to a robot if there is none and robots continue without.

        Raises:
            CallError: it is refused.
            NobodyThere: no coordinator answers, and no robot accepts the task.

        """
        try:
            return self.coordinator(task_messages.TASK_SUBMIT, asked)
        except NobodyThere as error:
            return self.submit_to_robots(asked, error)

    def submit_to_robots(self, asked: TaskSubmission, no_coordinator: NobodyThere) -> TaskRecord:
        """Submit a task to the first robot that accepts it; errors as those of `submit`."""

        def ask(robot: str) -> TaskRecord:
            answer = self._until_kept(consensus_messages.ROBOT_SUBMIT, asked, robot, "may be lost: only {} has it")
            reason = cut(f"there is no coordinator; {', '.join(answer.known_to)} accepted it")
            return TaskRecord(task=answer.task, state=TaskState.QUEUED, by=asked.by, why=reason)

        return self._first_robot(ask, task_messages.TASK_SUBMIT, asked, no_coordinator)

    def cancel(self, asked: TaskRequest) -> TaskRecord:
        """Cancel a task at the coordinator, or at a robot if there is none and robots continue without.

        Raises:
            CallError: it is refused.
            NobodyThere: no coordinator answers, and no robot accepts the cancellation.

        """
        try:
            return self.coordinator(task_messages.TASK_CANCEL, asked)
        except NobodyThere as error:
            no_coordinator = error

        def ask(robot: str) -> TaskRecord:
            answer = self._until_kept(
                consensus_messages.ROBOT_CANCEL, asked, robot, "may go on: only {} knows that it is cancelled"
            )
            reason = cut(f"there is no coordinator; {', '.join(answer.known_to)} cancelled it")
            return TaskRecord(task=answer.task, state=TaskState.CANCELLED, why=reason)

        return self._first_robot(ask, task_messages.TASK_CANCEL, asked, no_coordinator)

    def _first_robot(
        self, ask: Callable[[str], TaskRecord], topic: Query[Q, TaskRecord], asked: Q, no_coordinator: NobodyThere
    ) -> TaskRecord:
        """Return the answer of the first robot that accepts a request, or of a coordinator that has started since."""
        reason: list[str] = []
        for robot in team_found(self._wire).robots:
            try:
                return ask(robot)
            except (CallError, NobodyThere) as error:
                reason.append(f"{robot}: {error}")
        try:  # a coordinator may have started since, and have a task that a robot accepted
            return self._wire.ask(topic, asked, timeout_s=ASK_TIMEOUT_S)
        except NobodyThere:
            raise NobodyThere("; ".join([str(no_coordinator), *reason[:SHOWN_WHYS]])) from None

    def _until_kept(self, topic: Query[Q, _A], asked: Q, robot: str, risk: str) -> _A:
        """Repeat a request until more than half of the team has it (CallError after 5 s, with the risk)."""
        transport = self._transport
        gives_up_s = transport.elapsed_s() + KEPT_S
        while True:
            answer = self.robot(topic, asked, robot)
            if answer.is_kept:
                return answer
            if transport.elapsed_s() >= gives_up_s:
                reported = risk.format(", ".join(answer.known_to))
                raise CallError(ErrorCode.FAILED, f"task {answer.task.id} {reported}")
            transport.pass_time(AGAIN_S)

    def robot(self, topic: Query[Q, R], request: Q | None, robot: str) -> R:
        """Query a robot.

        Raises:
            CallError: it refuses.
            NobodyThere: it is not there; the text lists those that are.

        """
        try:
            return self._wire.ask(topic, request, timeout_s=max(topic.timeout_s, ROBOT_TIMEOUT_S), robot=robot)
        except NobodyThere as error:
            raise no_robot(self._wire, robot, topic.name) from error

    def _no_coordinator(self) -> NobodyThere:
        text = f"no coordinator of team {self._wire.team} answers"
        if self._wire.team in teams_there(self._wire):
            return NobodyThere(f"{text}; `robrain coordinator` starts one")
        return wrong_team(text, self._wire)
