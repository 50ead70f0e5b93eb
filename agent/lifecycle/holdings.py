"""What an active plugin holds beside its instance: events that it observes, tasks, other plugins, leases on itself."""

from collections.abc import Callable
from typing import Any

from robrain.agent.event import Event, EventView, Mailbox
from robrain.agent.lifecycle.robot_context import RobotContext
from robrain.agent.task_desk import Accept, LetGo, TaskDesk, TaskWork


class Holdings:
    """Notes what one plugin takes, and gives all of it back at once.

    Args:
        plugin: its name.
        context: its robot.

    """

    def __init__(self, plugin: str, context: RobotContext) -> None:
        self.mailbox = Mailbox()
        """Where notifications wait for the plugin; another one after each `release`."""
        self._plugin = plugin
        self._context = context
        self._observed: list[Event[Any] | EventView[Any]] = []
        self._tasks: list[tuple[TaskDesk, str]] = []

    def observe(self, event: Event[Any] | EventView[Any], function: Callable[[Any], None]) -> None:
        """Have the plugin told of an event, through its mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def do_tasks(self, desk: TaskDesk, kind: str, accept: Accept, let_go: LetGo, work: TaskWork) -> None:
        """Have the plugin do tasks of a kind."""
        desk.register(kind, accept, let_go, work)
        self._tasks.append((desk, kind))

    def release(self) -> None:
        """Give everything back, each thing once; what waits in the mailbox is not delivered any more."""
        observed, self._observed = self._observed, []
        tasks, self._tasks = self._tasks, []
        before, self.mailbox = self.mailbox, Mailbox()
        self.mailbox.wake, self.mailbox.dropped = before.wake, before.dropped
        for event in observed:
            event.remove(before)
        for desk, kind in tasks:
            desk.unregister(kind)
        self._context.release(self._plugin)
        self._context.leases.drop(self._plugin)
