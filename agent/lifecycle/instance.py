"""One instance of a plugin with all objects made for it, and its resources while it is active."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec

from robrain.agent.environment import Environment, PluginRequests
from robrain.agent.event import Event, Mailbox, ObservableEvent
from robrain.agent.lifecycle.access import AccessiblePlugin
from robrain.agent.lifecycle.plugin_code import PluginCode
from robrain.agent.lifecycle.worker_pool import WorkerPool
from robrain.agent.plugin import Plugin
from robrain.agent.robot_tasks import Accept, LetGo, RobotTasks, TaskWork
from robrain.protocol.clock import Clock
from robrain.protocol.wire.endpoint import Endpoint

MakeEnvironment = Callable[[PluginRequests], Environment]


@dataclass(eq=False, kw_only=True)
class RobotContext(ABC):
    """The part of a robot that its plugins use."""

    robot: str
    """Its name."""
    clock: Clock
    make_environment: MakeEnvironment
    parameters: Mapping[str, Mapping[str, Any]]
    """For each plugin, parameters that override its manifest's."""
    has_one_thread: bool = False
    """Whether nothing but the lockstep runner's own thread ever calls a plugin."""
    starters: WorkerPool | None = None
    """Starts plugins, in live; one that hangs while it is started is abandoned."""
    halted: bool = False
    halts: int = 0
    """How often it was halted."""
    newly_running: bool = False
    """Whether a plugin runs that did not, since the host last started those that lacked one."""

    @property
    def is_live(self) -> bool:
        """Whether the drive is live. Time limits on plugins, which run on the wall clock, apply only then."""
        return self.starters is not None

    def parameters_of(self, name: str) -> Mapping[str, Any]:
        """Parameters of a plugin in the robot's own file."""
        return self.parameters.get(name, {})

    @abstractmethod
    def request(self, caller: AccessiblePlugin, name: str, interface: type) -> object:
        """A handle on another plugin (PluginMissing, AccessDenied, PluginBusy)."""

    @abstractmethod
    def release(self, name: str) -> None:
        """A plugin holds no other any more."""

    @abstractmethod
    def record_fault(self, plugin: Any) -> None:
        """A plugin has faulted; its users' locks must not be taken from below, so the host's step handles it."""

    @abstractmethod
    def excuses(self, plugin: AccessiblePlugin, error: BaseException) -> bool:
        """Whether an error that a plugin raised is the fault of one that it requires, or of a halt."""


class Instance(msgspec.Struct, frozen=True, eq=False):
    """One instance of a plugin, with the environment that was made for it.

    Declarations on the wire in `init` stay until the instance ends. Those from `activate` on end with `deactivate`, as
    they use a separate endpoint.
    """

    code: PluginCode
    plugin: Plugin
    environment: Environment
    wire: Endpoint
    """The endpoint of its `init`."""

    def begin(self, wire: Endpoint) -> None:
        """It is about to be activated, and uses this endpoint from now on."""
        self.end_wire()
        self.environment.wire = wire
        self.environment.begin(self.events())

    def end_wire(self) -> None:
        """It is active no more: close the endpoint of its activation."""
        wire, self.environment.wire = self.environment.wire, self.wire
        if wire is not self.wire:
            wire.close()

    def close(self) -> None:
        """It goes: close everything that was made for it."""
        self.end_wire()
        self.environment.close()

    def take_over(self, other: "Instance") -> None:
        """Have the observers of another instance observe this one: the event objects themselves move."""
        own = self.events()
        for name, event in other.events().items():
            if name in own:
                event.outside = getattr(type(self.plugin), name).outside
                self.plugin.__dict__[name] = event

    def events(self) -> dict[str, Event[Any]]:
        """The instance's own events, by name."""
        return {name: getattr(self.plugin, name) for name in self.code.events}


class Holdings:
    """Records the events that one plugin observes and its kinds of tasks, and releases all of them at once."""

    def __init__(self) -> None:
        self.mailbox = Mailbox()
        """Where notifications wait for the plugin; another one after each `release`."""
        self._observed: list[Event[Any] | ObservableEvent[Any]] = []
        self._tasks: list[tuple[RobotTasks, str]] = []

    def observe(self, event: Event[Any] | ObservableEvent[Any], function: Callable[[Any], None]) -> None:
        """Notify the plugin of an event, through its mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def ring_at(self, bell: bytearray | None, index: int) -> None:
        """Have the mailbox, and those after it, set this place of `bell` when something arrives."""
        self.mailbox.bell, self.mailbox.bell_index = bell, index

    def do_tasks(self, desk: RobotTasks, kind: str, accept: Accept, let_go: LetGo, work: TaskWork) -> None:
        """Have the plugin do tasks of a kind."""
        desk.register(kind, accept, let_go, work)
        self._tasks.append((desk, kind))

    def release(self) -> None:
        """Release all resources, each once; messages in the mailbox are not delivered any more."""
        observed, self._observed = self._observed, []
        tasks, self._tasks = self._tasks, []
        before, self.mailbox = self.mailbox, Mailbox()
        self.mailbox.wake, self.mailbox.dropped = before.wake, before.dropped
        self.ring_at(before.bell, before.bell_index)
        for event in observed:
            event.remove(before)
        for desk, kind in tasks:
            desk.unregister(kind)
