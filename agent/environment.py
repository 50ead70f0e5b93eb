"""What a plugin is given: its name, time, randomness, wire, bus, and the way to other plugins."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import can
import numpy as np

from robrain.agent.board import Board
from robrain.agent.errors import HardwareAbsent
from robrain.agent.event import Event
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.protocol.wire.clock import Clock
from robrain.protocol.wire.endpoint import Drive, Endpoint, Handler
from robrain.protocol.wire.topics import Topic

if TYPE_CHECKING:
    from robrain.agent.tag import PluginTag

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
    ) -> None:
        self.plugin = tag.name
        self.robot = robot
        self.wire = wire
        """The robot's place on the wire; closed when the plugin goes."""
        self.rng = rng
        self.board = board
        """What the robot tells of itself; see RobotState."""
        self.tasks = tasks
        self.__tag = tag

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

    def answer(self, topic: Topic, handler: Handler, **names: str) -> None:
        """Answer queries on a topic, one at a time with the plugin's own functions; see Endpoint.answer."""
        self.__tag.answer(topic, handler, names)

    def do_tasks(self, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Say that this plugin does tasks of a kind; see TaskDesk.register. Both are called on its own turn."""
        self.__tag.do_tasks(self.tasks, kind, accept, let_go)

    def open_can(self, interface: str, channel: str, **options: Any) -> can.BusABC:
        """Open a python-can bus; `interface = "zenoh"` is the simulator's.

        Raises:
            HardwareAbsent: it cannot be opened.

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
        except (can.CanError, OSError, ValueError) as error:
            raise HardwareAbsent(self.plugin, f"no CAN bus at {interface}:{channel}: {error}") from error
