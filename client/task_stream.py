"""Changes of tasks, as they are published."""

from collections.abc import Callable, Iterator, Sequence

from robrain.client.transport import Transport
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.wire.messages.tasks.task_messages import TaskRecord
from robrain.protocol.wire.topics import TASK_EVENT

POLL_S = 0.02
LOOK_S = 1.0
"""Period of the query for missed changes, in addition to the subscription."""


class TaskStream:
    """Each change of some tasks, once; listens from when it is made.

    Args:
        transport: to the team.
        wire: a new endpoint of this stream's own.
        get: how a task stands.
        tasks: ids; of all tasks if there are none.

    """

    def __init__(
        self, transport: Transport, wire: Endpoint, get: Callable[[str], TaskRecord], tasks: Sequence[str]
    ) -> None:
        self._transport = transport
        self._get = get
        self._tasks = tasks
        self._inbox = Inbox(4096)
        wire.subscribe(self._inbox, TASK_EVENT)

    def events(self, timeout_s: float | None) -> Iterator[TaskEvent]:
        """The changes, beginning with how the tasks stand, until all of them have ended.

        Raises:
            TimeoutError: they have not all ended in time.

        """
        transport = self._transport
        last: dict[str, int] = {}
        running = set(self._tasks)
        look_s = began_s = transport.elapsed_s()
        while True:
            heard = [received.message for received in self._inbox.drain()]
            events = [event for event in heard if not self._tasks or event.task.id in self._tasks]
            if transport.elapsed_s() >= look_s:
                events += [self._get(task).event for task in sorted(running)]
                look_s = transport.elapsed_s() + LOOK_S
            for event in events:
                if event.change > last.get(event.task.id, 0):
                    last[event.task.id] = event.change
                    yield event
                if event.state.ended:
                    running.discard(event.task.id)
            if self._tasks and not running:
                return
            if timeout_s is not None and transport.elapsed_s() - began_s >= timeout_s:
                raise TimeoutError(f"not ended after {timeout_s:g} s: {', '.join(sorted(running)) or 'all tasks'}")
            transport.pass_time(POLL_S)
