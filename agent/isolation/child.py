"""`python -m robrain.agent.isolation.child`: the process of one isolated plugin. Started by ChildProcess."""

import faulthandler
import logging
import os
import resource
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TextIO, TypeVar, cast

import msgspec
import zenoh

from robrain.agent.board import Board
from robrain.agent.class_import import import_class
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginError, PluginHung
from robrain.agent.event import Event, Mailbox
from robrain.agent.isolation import messages
from robrain.agent.isolation.contract import Contract, contract_of, decoder, encode
from robrain.agent.isolation.messages import Request
from robrain.agent.isolation.peer import Peer, PeerLost
from robrain.agent.manifest import Manifest, TagTable
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_output import PluginLogs, PluginOutput, PluginStream
from robrain.agent.plugin_traceback import raised, traceback_in
from robrain.agent.robot_tasks import Accept, LetGo, TaskWork, work_at_place
from robrain.algorithms.localization.odometry import YawRate
from robrain.protocol.clock import LiveClock
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Drive, Endpoint, Handler, Serve
from robrain.protocol.wire.endpoint import Request as WireRequest
from robrain.protocol.wire.session import open_session
from robrain.protocol.workers import OwnedThread, end_with_parent

BYTES_PER_MB = 1_000_000


T = TypeVar("T")
InterfaceT = TypeVar("InterfaceT")

_NUMBER = msgspec.msgpack.Decoder(int)


class Parent:
    """Access to the robot's process: in its own turn for the plugin's turn, aside for other threads.

    Args:
        calls: the conversation in which the plugin is called, on the thread that makes this.
        asides: the one for all other threads.

    """

    def __init__(self, calls: Peer, asides: Peer) -> None:
        self._calls = calls
        self._asides = asides
        self._main = threading.get_ident()

    def ask(self, request: Request) -> bytes:
        """Ask, and wait for the answer."""
        return self._peer().ask(request)

    def send(self, request: Request) -> None:
        """Send a message without an answer."""
        self._peer().send(request)

    def _peer(self) -> Peer:
        return self._calls if threading.get_ident() == self._main else self._asides


class RemoteEvent(NamedTuple):
    """An event of another plugin."""

    handle: int
    name: str
    read: "msgspec.msgpack.Decoder[Any]"


class RemoteHandle:
    """A handle that the parent holds; see Handle."""

    def __init__(self, parent: Parent, plugin: str, interface: type, number: int) -> None:
        self.__parent = parent
        self.__plugin = plugin
        self.__interface = interface
        self.__contract = Contract(interface)
        self.__number = number

    def __getattr__(self, name: str) -> Any:
        contract, number, parent = self.__contract, self.__number, self.__parent
        if name in contract.events:
            return RemoteEvent(number, name, contract.events[name])
        if name in contract.attributes:
            return contract.attributes[name].decode(parent.ask(messages.Get(number, name)))
        if name not in contract.functions:
            interface = self.__interface.__name__
            raise AccessDenied(self.__plugin, f"{name} is not in {interface}, the interface of {self.__plugin}")
        signature = contract.functions[name]

        def call(*args: Any, **kwargs: Any) -> Any:
            return signature.read_result(
                parent.ask(messages.CallRequest(number, name, signature.write_arguments(args, kwargs)))
            )

        setattr(self, name, call)
        return call

    def __repr__(self) -> str:
        return f"<handle on {self.__plugin} as {self.__interface.__name__}>"


class RemoteBoard(Board):
    """The robot's board, read and written where it is; its queues and shared objects do not reach a process."""

    def __init__(self, parent: Parent) -> None:
        self.__dict__["_parent"] = parent
        self.__dict__["yaw_rates"] = deque[YawRate](maxlen=256)
        self.__dict__["_shared"] = {}

    def __getattr__(self, name: str) -> Any:
        return decoder(messages.BOARD_TYPES.get(name, Any)).decode(
            self.__dict__["_parent"].ask(messages.ReadBoard(name))
        )

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__["_parent"].send(messages.WriteBoard(name, encode(value)))


class ChildEnvironment(Environment):
    """The environment of an isolated plugin, in its own process.

    `wire` opens a session when it is first used. Functions that an isolated plugin lacks raise PluginError.
    """

    def __init__(self, begin: messages.Begin, parent: Parent, turn: threading.RLock) -> None:
        # Not the base's own: it passes requests on to the host, which lies with the parent, and wants a wire, which is
        # opened when it is used.
        self.plugin = begin.plugin
        self.robot = begin.robot
        self.seeds = begin.seeds
        self.board = RemoteBoard(parent)
        self.connect = begin.connect
        self._at_end: list[Callable[[str], None]] = []
        self._team = begin.team
        self._own_module = ""
        self._parent = parent
        self._turn = turn
        self.clock = LiveClock(begin.clock_offset_ns)
        self._session: zenoh.Session | None = None
        self._observers: list[tuple[Callable[[Any], None], Any]] = []

    def __getattr__(self, name: str) -> Any:
        if name == "wire":
            self.wire = self._open_wire()
            return self.wire
        if name.startswith("__"):
            raise AttributeError(name)
        raise PluginError(self.plugin, f"{self.plugin} runs in a separate process and has no env.{name.lstrip('_')}")

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """See Environment.use."""
        module = "" if interface.__module__ == self._own_module else interface.__module__
        number = _NUMBER.decode(self._parent.ask(messages.Use(name, module, interface.__qualname__)))
        return cast(InterfaceT, RemoteHandle(self._parent, name, interface, number))

    def observe(self, event: Event[T], function: Callable[[T], None]) -> None:
        """See Environment.observe."""
        remote: Any = event
        if not isinstance(remote, RemoteEvent):
            raise PluginError(
                self.plugin, f"{self.plugin} can observe events of the plugins that it uses, and no others"
            )
        self._observers.append((function, remote.read))
        self._parent.ask(messages.Observe(remote.handle, remote.name, len(self._observers)))

    def receive_event(self, subscription: int, written: bytes) -> None:
        """An event has happened."""
        function, read = self._observers[subscription - 1]
        function(read.decode(written))

    def answer(self, topic: Query[Any, Any], handler: Handler[Any, Any], **names: str) -> None:
        """See Environment.answer."""

        def locked(request: WireRequest[Any]) -> Any:
            with self._turn:
                return handler(request)

        self.wire.answer(topic, locked, serve=Serve.AT_ONCE, **names)

    def do_tasks(self, accept: Accept, let_go: LetGo, work: TaskWork = work_at_place) -> None:
        """Refused: only plugins in the robot's own process can do tasks."""
        raise PluginError(self.plugin, f"{self.plugin} runs in a separate process and cannot do tasks")

    @property
    def caller(self) -> str:
        """Empty: the parent does not report the caller."""
        return ""

    def hurry(self) -> None:
        """Nothing: the step of an isolated plugin comes when it is due."""

    def belongs_to(self, module: str) -> None:
        """Report where the plugin's class is declared: its parent has that module under another name."""
        self._own_module = module

    def close(self) -> None:
        """Leave the wire."""
        if self._session is not None:
            self.wire.close()
            self._session.close()

    def _open_wire(self) -> Endpoint:
        if not self.connect:
            raise PluginError(
                self.plugin,
                f"{self.plugin} runs in a separate process and cannot reach the wire: "
                "its robot has no endpoint to connect to ([zenoh] connect)",
            )
        self._session = open_session(mode="client", connect=self.connect)
        return Endpoint(self._session, self._team, self.clock, Drive.LIVE)


class PluginChild:
    """Holds the real plugin, and handles the parent's requests."""

    def __init__(self, name: str, calls: socket.socket, halts: socket.socket, asides: socket.socket) -> None:
        self._name = name
        self._calls = Peer(calls, name, self.serve)
        self._halts = Peer(halts, name, self._halt)
        self._parent = Parent(self._calls, Peer(asides, name, self.serve))
        self._output = PluginOutput(self._log, lambda: name, LiveClock())
        self._turn = threading.RLock()
        self._plugin: Plugin
        self._contract: Contract
        self._env: ChildEnvironment | None = None

    def run(self) -> None:
        """Serve until the parent hangs up."""
        OwnedThread("halts", self._halts.run)  # it ends with the process
        self._calls.run()
        if self._env is not None:
            self._env.close()

    def serve(self, request: Request) -> bytes:
        """Handle the request, in the plugin's turn."""
        with self._turn:
            self._output.report_dropped()
            match request:
                case messages.Begin():
                    self._begin(request)
                case messages.Do(function):
                    if function == "deactivate":
                        self._end_actions("the plugin is deactivated")
                    getattr(self._plugin, function)()
                    return encode(self._plugin.period_s)
                case messages.CallRequest(handle, function, arguments) if handle == messages.OWN:
                    args, kwargs = self._contract.functions[function].read_arguments(arguments)
                    return encode(getattr(self._plugin, function)(*args, **kwargs))
                case messages.Get(handle, attribute) if handle == messages.OWN:
                    return encode(getattr(self._plugin, attribute))
                case messages.ObservedEvent(subscription, value) if self._env is not None:
                    self._env.receive_event(subscription, value)
                case _:
                    raise PluginError(self._name, f"{type(request).__name__} is not for this end")
        return b""

    def _halt(self, request: Request) -> bytes:
        """An emergency halt, or a question where the plugin is: without the turn, which may never end."""
        if request == messages.Do(messages.WHERE):
            stuck = traceback_in(threading.main_thread().ident or 0, type(self._plugin))
            return encode(raised(PluginHung(self._name, "hangs").with_traceback(stuck)))
        self._end_actions("emergency halt")
        self._plugin.emergency_halt()
        return b""

    def _end_actions(self, reason: str) -> None:
        if self._env is not None:
            self._env.end_actions(reason)

    def _begin(self, begin: messages.Begin) -> None:
        sys.path[:] = begin.import_path
        limit = begin.memory_mb * BYTES_PER_MB
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
        logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[PluginLogs(self._output)])
        sys.stdout, sys.stderr = (cast(TextIO, PluginStream(each, self._output)) for each in (sys.stdout, sys.stderr))
        manifest = Manifest(begin.plugin, Path(begin.manifest), begin.class_path, {}, TagTable())
        plugin_class = import_class(manifest)
        self._contract = contract_of(plugin_class)
        self._env = ChildEnvironment(begin, self._parent, self._turn)
        self._env.belongs_to(plugin_class.__module__)
        parameters = decoder(plugin_class.Parameters).decode(begin.parameters)
        self._plugin = plugin_class(self._env, parameters)
        for name in self._contract.events:
            event: Event[Any] = getattr(self._plugin, name)
            event.add(partial(self._notify, name), _Straight())

    def _log(self, _plugin: str, level: str, text: str) -> None:
        with suppress(PeerLost):  # the parent has ended and this process is about to, so the log has no reader
            self._parent.send(messages.Log(level, text))

    def _notify(self, name: str, value: Any) -> None:
        self._parent.send(messages.Notify(name, encode(value)))


class _Straight(Mailbox):
    """Hands on at once: the mailbox that an observer waits at is in the robot's process."""

    def post(self, function: Any, value: Any) -> bool:
        function(value)
        return True


def main() -> None:
    """Run a plugin; the arguments are its name and four file descriptors."""
    name = sys.argv[1]
    calls, halts, asides, lifeline = (int(argument) for argument in sys.argv[2:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal reaches the parent, which ends this one
    faulthandler.enable()
    end_with_parent(lifeline)
    # If the machine runs out of memory, this process is to go, not the robot's.
    Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    PluginChild(name, *(socket.socket(fileno=number) for number in (calls, halts, asides))).run()
    os._exit(0)  # threads that the plugin has started do not hold up the end


if __name__ == "__main__":
    main()
