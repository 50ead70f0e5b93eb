"""A plugin's environment: its name, time, randomness, wire, bus, and access to other plugins."""

import logging
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from robrain.agent.board import Board
from robrain.agent.errors import FOREIGN_ERRORS, HardwareAbsent
from robrain.agent.event import Event, EventPublisher, ObservableEvent
from robrain.agent.robot_tasks import Accept, LetGo, RobotTasks, TaskWork, work_at_place
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import PluginInfo
from robrain.protocol.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Drive, Endpoint, Handler

if TYPE_CHECKING:  # imported when a plugin asks for them
    import can
    import numpy as np

    from robrain.protocol.serial.serial_line import SerialLine

logger = logging.getLogger(__name__)

T = TypeVar("T")
InterfaceT = TypeVar("InterfaceT")


class PluginRequests(Protocol):
    """Requests that an environment passes on for its plugin, to the manager, which knows the plugin's rights."""

    @property
    def name(self) -> str:
        """The plugin's name."""

    @property
    def caller(self) -> str:
        """See Environment.caller."""

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """See Environment.use."""

    def observe(self, event: Event[Any] | ObservableEvent[Any], function: Callable[[Any], None]) -> None:
        """See Environment.observe."""

    def hurry(self) -> None:
        """See Environment.hurry."""

    def answer(self, topic: Query[Any, Any], handler: Handler[Any, Any], names: dict[str, str]) -> None:
        """See Environment.answer."""

    def do_tasks(self, desk: RobotTasks, accept: Accept, let_go: LetGo, work: TaskWork) -> None:
        """See Environment.do_tasks."""


class CommandDoor(Protocol):
    """Access to the robot's plugins by text commands."""

    def plugins(self) -> list[PluginInfo]:
        """The plugins that are open to the outside."""

    def call_text(self, text: str, *, by: str = "") -> str:
        """Execute a text command (CallError if it is wrong or refused)."""


class Environment:
    """Made for one instance of a plugin. All requests go to its manager."""

    def __init__(
        self,
        plugin: PluginRequests,
        robot: str,
        wire: Endpoint,
        seeds: tuple[int, ...],
        board: Board,
        tasks: RobotTasks,
        *,
        halt: Callable[[str, str], object],
        guard: Callable[[str, Callable[[], str]], None],
        outside: CommandDoor | None = None,
        connect: list[str] | None = None,
    ) -> None:
        self.plugin = plugin.name
        self.robot = robot
        self.wire = wire
        """The robot's place on the wire; closed when the plugin goes."""
        self.seeds = seeds
        """Of the plugin's own generator."""
        self.board = board
        """Facts that the robot reports; see RobotState."""
        self.tasks = tasks
        self.outside = outside
        """The door that outside callers come in by; for the plugin `command`."""
        self.connect = connect or []
        """Endpoints by which a process of the plugin's own reaches the team."""
        self._publishers: list[EventPublisher] = []
        self._at_end: list[Callable[[str], None]] = []
        self._of_init: int | None = None
        self.__requests = plugin
        self.__halt, self.__guard = halt, guard
        self.clock = wire.clock
        """The run's clock."""
        self.gone: list[bool] = []
        """Not empty as soon as the instance `has_gone`: for those that look at it at each call."""

    @property
    def has_gone(self) -> bool:
        """The instance was closed, or a caller is stuck in it: its later actions have no effect."""
        return bool(self.gone)

    def abandon(self) -> None:
        """Nothing that the instance does has a consequence any more. Not for plugins."""
        self.gone.append(True)

    @property
    def caller(self) -> str:
        """The plugin that calls this one at present; empty in its own step, and for a call from outside."""
        return self.__requests.caller

    @cached_property
    def rng(self) -> "np.random.Generator":
        """The plugin's own random numbers, the same in each run of a seed. They need robrain[navigation]."""
        import numpy as np

        return np.random.default_rng(self.seeds)

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """A handle on another plugin, which must be of a lower level and named in `requires`.

        Raises:
            PluginMissing, AccessDenied, PluginBusy: saying why not.

        """
        return self.__requests.use(name, interface)

    def observe(self, event: Event[T], function: Callable[[T], None]) -> None:
        """Call `function` with each notification of an event, on this plugin's own turn."""
        self.__requests.observe(event, function)

    def hurry(self) -> None:
        """Have this plugin's next step run at once instead of when it is due; its period starts again then.

        For actions that must not wait for the period, such as the first command after a standstill. In lockstep it is
        run in this tick or the next one.
        """
        self.__requests.hurry()

    def wake_on(self, inbox: Inbox) -> None:
        """As `hurry`, whenever something arrives in an inbox: a plugin that waits for messages need not poll."""
        inbox.on_arrival = self.hurry

    def at_end(self, function: Callable[[str], None]) -> None:
        """Call `function` with the reason whenever the plugin is deactivated, faults or is halted.

        A request in `activate` is forgotten with the end; a request in `init` lasts until the instance ends. It may be
        called on any thread, without the plugin's lock, and must not wait for anything.
        """
        self._at_end.append(function)

    def answer(self, topic: Query[Q, R], handler: Handler[Q, R], **names: str) -> None:
        """Answer queries on a topic, one at a time with the plugin's own functions; see Endpoint.answer."""
        self.__requests.answer(topic, handler, names)

    def do_tasks(self, accept: Accept, let_go: LetGo, work: TaskWork = work_at_place) -> None:
        """Take tasks of the kind that the plugin's class declares; see RobotTasks.register. All run on its own turn.

        Raises:
            PluginError: the class declares no kind.

        """
        self.__requests.do_tasks(self.tasks, accept, let_go, work)

    def halt_robot(self, reason: str) -> None:
        """Halt this robot at once, in the plugin's name: only an operator ends it. On any thread."""
        if not self.has_gone:
            self.__halt(self.plugin, reason)

    def guard_resume(self, reason: Callable[[], str]) -> None:
        """Have `reason` asked before a halt of this robot ends: it stays halted for the reason that this returns.

        It may be called on any thread, without the plugin's lock, until the plugin is unloaded, also after a fault. It
        must not block. A later call replaces an earlier one.
        """
        if not self.has_gone:
            self.__guard(self.plugin, reason)

    def begin(self, events: Mapping[str, Event[Any]]) -> None:
        """The plugin is about to be activated: its marked events leave the robot. Not for plugins."""
        self._of_init = len(self._at_end)
        self._publishers = [
            EventPublisher(event, self.wire, robot=self.robot, plugin=self.plugin, event=name)
            for name, event in events.items()
            if event.outside
        ]

    @property
    def ends_actions(self) -> bool:
        """Whether `end_actions` has something to call. Not for plugins."""
        return bool(self._at_end)

    def end_actions(self, reason: str) -> None:
        """Call the functions registered by `at_end`. Not for plugins."""
        for function in self._at_end:
            try:
                function(reason)
            except FOREIGN_ERRORS:  # foreign plugin code; the others must still be notified
                logger.exception("%s: plugin %s failed while it was ended", self.robot, self.plugin)

    def end(self, reason: str) -> None:
        """The plugin is active no more: nothing that it notifies leaves the robot. Not for plugins."""
        self.end_actions(reason)
        publishers, self._publishers = self._publishers, []
        for publisher in publishers:
            publisher.close()
        if self._of_init is not None:
            del self._at_end[self._of_init :]

    def close(self) -> None:
        """The instance goes, and its place on the wire with it. Not for plugins."""
        self.end("the plugin has gone")
        self.abandon()
        self.wire.close()

    def open_serial(self, port: str, baud: int, *, has_dtr: bool = True) -> "SerialLine":
        """Open a serial line; `zenoh:NAME` is one of the simulator's, whose bytes wake the plugin.

        Args:
            port: such as `/dev/ttyUSB0`.
            baud: bits a second.
            has_dtr: set DTR while it is open; some sensors stop their motor by it.

        Raises:
            HardwareAbsent: it cannot be opened.

        """
        from robrain.protocol.serial.serial_line import SIMULATED, PortLine, SimulatedLine

        if port.startswith(SIMULATED):
            return SimulatedLine(self.wire, self.robot, port.removeprefix(SIMULATED), self.hurry)
        try:
            return PortLine(port, baud, has_dtr=has_dtr)
        except (OSError, ValueError) as error:
            raise HardwareAbsent(self.plugin, f"no serial line at {port}: {error}") from error

    def open_can(self, interface: str, channel: str, **options: Any) -> "can.BusABC":
        """Open a python-can bus; `interface = "zenoh"` is the simulator's.

        Raises:
            HardwareAbsent: it cannot be opened, or the interface does not know an option.

        """
        import can

        try:
            if interface == "zenoh":  # python-can would read its configuration files for each bus
                from robrain.protocol.can.zenoh_bus import ZenohBus

                direct = self.wire.drive is Drive.LOCKSTEP
                options |= {"session": self.wire.session, "team": self.wire.team, "direct": direct}
                return ZenohBus(f"{self.robot}/{channel}", now_ns=self.clock.now_ns, **options)
            return can.Bus(interface=interface, channel=channel, **options)
        except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
            raise HardwareAbsent(self.plugin, f"no CAN bus at {interface}:{channel}: {error}") from error
