"""What a plugin in a process of its own is given: the same environment, most of which lies with its parent."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar, cast

import msgspec
import zenoh

from robrain.agent.board import Board
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginError
from robrain.agent.event import Event
from robrain.agent.isolation.contract import Contract
from robrain.agent.isolation.messages import Begin, CallRequest, Get, Observe, ReadBoard, Request, Use, WriteBoard
from robrain.agent.isolation.parent_desk import BOARD_TYPES
from robrain.agent.isolation.peer import Peer
from robrain.agent.isolation.plain_data import decoder, encode
from robrain.agent.task_desk import Accept, LetGo, TaskWork, work_at_place
from robrain.algorithms.localization.gyro_yaw import YawRate
from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint, Handler, Serve
from robrain.protocol.wire.endpoint import Request as WireRequest
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topic import Query

T = TypeVar("T")
InterfaceT = TypeVar("InterfaceT")

_NUMBER = msgspec.msgpack.Decoder(int)


class Parent:
    """The way to the robot's process: in its own turn for the plugin's turn, aside for other threads.

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

    def tell(self, request: Request) -> None:
        """Say what is not answered."""
        self._peer().tell(request)

    def _peer(self) -> Peer:
        return self._calls if threading.get_ident() == self._main else self._asides


class RemoteEvent:
    """An event of another plugin."""

    def __init__(self, handle: int, name: str, read: "msgspec.msgpack.Decoder[Any]") -> None:
        self.handle = handle
        self.name = name
        self.read = read


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
            return contract.attributes[name].decode(parent.ask(Get(number, name)))
        if name not in contract.functions:
            interface = self.__interface.__name__
            raise AccessDenied(self.__plugin, f"{name} is not in {interface}, the interface of {self.__plugin}")
        signature = contract.functions[name]

        def call(*args: Any, **kwargs: Any) -> Any:
            return signature.read_result(parent.ask(CallRequest(number, name, signature.write_arguments(args, kwargs))))

        setattr(self, name, call)
        return call

    def __repr__(self) -> str:
        return f"<handle on {self.__plugin} as {self.__interface.__name__}>"


class RemoteBoard(Board):
    """The robot's board, read and written where it is; queues on it do not reach a process of its own."""

    def __init__(self, parent: Parent) -> None:
        self.__dict__["_parent"] = parent
        self.__dict__["yaw_rates"] = deque[YawRate](maxlen=256)

    def __getattr__(self, name: str) -> Any:
        return decoder(BOARD_TYPES.get(name, Any)).decode(self.__dict__["_parent"].ask(ReadBoard(name)))

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__["_parent"].tell(WriteBoard(name, encode(value)))


class ChildEnvironment(Environment):
    """The environment of an isolated plugin, in its own process.

    `wire` opens a session of its own when it is first used. What an isolated plugin cannot have raises PluginError.
    """

    def __init__(self, begin: Begin, parent: Parent, turn: threading.RLock) -> None:
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
        raise PluginError(self.plugin, f"{self.plugin} runs in a process of its own and has no env.{name.lstrip('_')}")

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """See Environment.use."""
        module = "" if interface.__module__ == self._own_module else interface.__module__
        number = _NUMBER.decode(self._parent.ask(Use(name, module, interface.__qualname__)))
        return cast(InterfaceT, RemoteHandle(self._parent, name, interface, number))

    def observe(self, event: Event[T], function: Callable[[T], None]) -> None:
        """See Environment.observe."""
        remote: Any = event
        if not isinstance(remote, RemoteEvent):
            raise PluginError(
                self.plugin, f"{self.plugin} can observe events of the plugins that it uses, and no others"
            )
        self._observers.append((function, remote.read))
        self._parent.ask(Observe(remote.handle, remote.name, len(self._observers)))

    def told(self, subscription: int, written: bytes) -> None:
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
        """Refused: tasks are given out in the robot's own process."""
        raise PluginError(self.plugin, f"{self.plugin} runs in a process of its own and cannot do tasks")

    @property
    def caller(self) -> str:
        """Empty: the parent does not report who calls."""
        return ""

    def hurry(self) -> None:
        """Nothing: the step of an isolated plugin comes when it is due."""

    def belongs_to(self, module: str) -> None:
        """Say where the plugin's class is declared: its parent has that module under another name."""
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
                f"{self.plugin} runs in a process of its own and finds no way to the wire: "
                "its robot is not told of an endpoint to connect to ([zenoh] connect)",
            )
        self._session = open_session(mode="client", connect=self.connect)
        return Endpoint(self._session, self._team, self.clock, Drive.LIVE)
