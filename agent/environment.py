"""What a plugin is given: its name, time, randomness, wire, bus, and the way to other plugins."""

import logging
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import can
import numpy as np

from robrain.agent.board import Board
from robrain.agent.errors import FOREIGN_ERRORS, HardwareAbsent
from robrain.agent.event import Event
from robrain.agent.events_outside import EventsOutside
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Drive, Endpoint, Handler
from robrain.protocol.wire.topic import Q, Query, R

if TYPE_CHECKING:
    from robrain.agent.outside import OutsideDoor
    from robrain.agent.tag import PluginTag

logger = logging.getLogger(__name__)

T = TypeVar("T")
InterfaceT = TypeVar("InterfaceT")


class Environment:
    """Made by a plugin's tag, for that plugin alone. All requests go through the tag, which knows the name."""

    def __init__(
        self,
        tag: "PluginTag",
        robot: str,
        wire: Endpoint,
        rng: np.random.Generator,
        board: Board,
        tasks: TaskDesk,
        *,
        outside: "OutsideDoor | None" = None,
        connect: list[str] | None = None,
    ) -> None:
        self.plugin = tag.name
        self.robot = robot
        self.wire = wire
        """The robot's place on the wire; closed when the plugin goes."""
        self.rng = rng
        self.board = board
        """What the robot tells of itself; see RobotState."""
        self.tasks = tasks
        self.outside = outside
        """The door that outside callers come in by; for the plugin `command`."""
        self.connect = connect or []
        """Endpoints by which a process of the plugin's own reaches the team."""
        self._events = EventsOutside(wire, robot, tag.name)
        self._at_end: list[Callable[[str], None]] = []
        self._of_init: int | None = None
        self.__tag = tag
        self.__has_gone = False

    @property
    def has_gone(self) -> bool:
        """The instance was closed, or somebody is stuck in it: what it does from now on has no consequence."""
        return self.__has_gone

    def leave_behind(self) -> None:
        """Nothing that the instance does has a consequence any more. Called by the tag."""
        self.__has_gone = True

    @property
    def clock(self) -> Clock:
        """The run's clock."""
        return self.wire.clock

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """A handle on another plugin, which must be of a lower level and named in `requires`.

        Raises:
            PluginMissing, AccessDenied, PluginBusy: saying why not.

        """
        return self.__tag.use(name, interface)

    def observe(self, event: Event[T], function: Callable[[T], None]) -> None:
        """Have `function` told of an event, on this plugin's own turn."""
        self.__tag.observe(event, function)

    def hurry(self) -> None:
        """Have this plugin's next step run at once instead of when it is due; its period counts anew from then.

        For what must not wait for the period, such as the first command after a standstill. In lockstep it is run in
        this tick or the next one.
        """
        self.__tag.mailbox.hurry()

    def at_end(self, function: Callable[[str], None]) -> None:
        """Have `function` told why, whenever the plugin is deactivated, faults or is halted.

        What `activate` asks for is forgotten with the end, what `init` asks for holds as long as the instance. It may
        be called on any thread, without the plugin's lock, and must not wait for anything.
        """
        self._at_end.append(function)

    def answer(self, topic: Query[Q, R], handler: Handler[Q, R], **names: str) -> None:
        """Answer queries on a topic, one at a time with the plugin's own functions; see Endpoint.answer."""
        self.__tag.answer(topic, handler, names)

    def do_tasks(self, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Say that this plugin does tasks of a kind; see TaskDesk.register. Both are called on its own turn."""
        self.__tag.do_tasks(self.tasks, kind, accept, let_go)

    def begin(self, events: Mapping[str, Event[Any]]) -> None:
        """The plugin is about to be activated: its marked events leave the robot. Called by the tag."""
        self._of_init = len(self._at_end)
        self._events.open(events)

    def end_actions(self, why: str) -> None:
        """Tell those who asked `at_end`. Called by the tag."""
        for function in self._at_end:
            try:
                function(why)
            except FOREIGN_ERRORS:  # foreign plugin code; the others must be told all the same
                logger.exception("%s: plugin %s failed while it was ended", self.robot, self.plugin)

    def end(self, why: str) -> None:
        """The plugin is active no more: nothing that it notifies leaves the robot. Called by the tag."""
        self.end_actions(why)
        self._events.close()
        if self._of_init is not None:
            del self._at_end[self._of_init :]

    def close(self) -> None:
        """The instance goes, and its place on the wire with it. Called by the tag."""
        self.end("the plugin has gone")
        self.leave_behind()
        self.wire.close()

    def open_can(self, interface: str, channel: str, **options: Any) -> can.BusABC:
        """Open a python-can bus; `interface = "zenoh"` is the simulator's.

        Raises:
            HardwareAbsent: it cannot be opened, or the interface does not know an option.

        """
        if interface == "zenoh":
            options |= {
                "session": self.wire.session,
                "team": self.wire.team,
                "direct": self.wire.drive is Drive.LOCKSTEP,
                "now_ns": self.clock.now_ns,
            }
            channel = f"{self.robot}/{channel}"
        try:
            return can.Bus(interface=interface, channel=channel, **options)
        except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
            raise HardwareAbsent(self.plugin, f"no CAN bus at {interface}:{channel}: {error}") from error
