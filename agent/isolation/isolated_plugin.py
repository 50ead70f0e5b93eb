"""The isolated plugin: represents a plugin of another process in the robot's process.

`isolated_class` makes it in place of the real class, and its host need not distinguish them. It has the same level,
interface, parameters, period and external functions; steps, calls and notifications reach it in the same turns.

The robot reads the class to know its level, interface and functions, so its module is imported in the robot's process
too. Its top-level code runs first in a process that may crash or hang (`try_import`); code that passes is imported.
"""

import functools
import importlib
import inspect
import logging
import subprocess
import sys
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginCrashed, PluginError
from robrain.agent.event import Event
from robrain.agent.isolation import messages
from robrain.agent.isolation.contract import Contract, contract_of, decoder, encode
from robrain.agent.isolation.messages import Request
from robrain.agent.isolation.peer import Peer, PeerLate, PeerLost, Serve
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Plugin
from robrain.agent.plugin_traceback import Raised, raised_elsewhere
from robrain.protocol.clock import LiveClock
from robrain.protocol.workers import KILLED_S, OwnedThread, WorkerProcess, how_it_ended

logger = logging.getLogger(__name__)

_PERIOD = msgspec.msgpack.Decoder(float | None)

CALL_SHARE = 0.8
"""Of the manifest's `hang_s`: the process is killed before the host takes the whole plugin for hung."""
WHERE_S = 0.5
"""How long a process that hangs may take to report the line that it is at."""
START_SHARE = 0.3
"""Of the manifest's `start_s`, for its process, `init` and `activate`, which may come together."""

IMPORT = """
import importlib, pathlib, sys
from robrain.agent.class_import import import_file
import_file(pathlib.Path(sys.argv[2])) if sys.argv[2] else importlib.import_module(sys.argv[1])
"""


END_TIMEOUT_S = 1.0
"""A process that was asked to end is killed after this."""
STDERR = 2

OnLost = Callable[[str], None]


class ChildProcess(WorkerProcess):
    """Starts the process of one plugin.

    Args:
        plugin: its name.
        serve: handles the plugin's requests.
        on_lost: called with the reason, on a separate thread, when the process ends by itself; held by a weak
            reference.

    Raises:
        OSError: the process cannot be started.

    """

    def __init__(self, plugin: str, serve: Serve, on_lost: "weakref.WeakMethod[OnLost]") -> None:
        self._on_lost = on_lost
        self._is_ending = False
        super().__init__("robrain.agent.isolation.child", [plugin], sockets=3, stdout=STDERR)
        self.calls, self.halts, self._asides = (Peer(one, plugin, serve) for one in self.sockets)
        self._watcher = OwnedThread(f"isolated-{plugin}", self._watch)

    def end(self, timeout_s: float = END_TIMEOUT_S) -> None:
        """Let it end, or kill it if it does not; returns when it has gone. May be called again."""
        self._is_ending = True
        for peer in (self.calls, self.halts, self._asides):
            peer.hang_up()
        self.ends_within(timeout_s)
        self.kill()

    def kill(self, timeout_s: float = KILLED_S) -> None:
        """End it at once."""
        self._is_ending = True
        self._give_back(timeout_s)
        self._watcher.close(END_TIMEOUT_S)

    def how_it_ended(self) -> str:
        """Why a connection was lost, in words; a process that has only hung up is killed."""
        self._is_ending = True
        self.ends_within(END_TIMEOUT_S)
        self._give_back()
        status = self.status
        return how_it_ended(status) if status is not None else "has hung up"

    def _give_back(self, timeout_s: float = KILLED_S) -> None:
        super().kill(timeout_s)
        self.calls.close()
        self.halts.close()
        self._asides.hang_up()

    def _watch(self) -> None:
        self._asides.run()
        self._asides.close()
        if self._is_ending:
            return
        reason = self.how_it_ended()
        on_lost = self._on_lost()
        if on_lost is not None:
            on_lost(reason)


class Limits(msgspec.Struct, frozen=True):
    """Time that the plugin's process spends waiting for its parent does not count."""

    call_s: float = 4.0
    """A step, a call, a notification."""
    start_s: float = 6.0
    """The start of the process, its `init`, and its `activate`: code is imported, hardware searched."""
    halt_s: float = 0.2
    """A process that has not acknowledged an emergency halt by then is killed."""
    memory_mb: int = 4096
    """Data that the process may allocate; beyond it, allocations fail there."""


def limits_of(manifest: Manifest) -> Limits:
    """The limits that a manifest sets."""
    return Limits(call_s=CALL_SHARE * manifest.tag.hang_s, start_s=START_SHARE * manifest.tag.start_s)


class IsolatedPlugin(Plugin):
    """Runs its plugin in a separate process from `init` to `deactivate`; made by `isolated_class`.

    If that process fails, this one raises PluginCrashed and continues. The process is killed if a call does not return
    in time, and does not outlive the robot's. The plugin's state ends with `deactivate`.
    """

    _manifest: ClassVar[Manifest]
    _plugin_class: ClassVar[type[Plugin]]
    _limits: ClassVar[Limits]
    _contract: ClassVar[Contract]

    def __init__(self, env: Environment, parameters: Any) -> None:
        super().__init__(env, parameters)
        self._child: ChildProcess | None = None
        self._gone_reason = "has not been started"
        self._lost: Event[ChildProcess] = Event()
        self._forget: weakref.finalize[..., Any] | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the plugin's process; None if there is none."""
        child = self._child
        return child.pid if child is not None else None

    def init(self) -> None:
        """Start the process, and run the plugin's own there."""
        self._start()
        self._do("init", self._limits.start_s)

    def activate(self) -> None:
        """Run the plugin's own, in a new process if there is none."""
        if self._child is None:
            self.init()
        # Through the plugin's own mailbox, so that its host learns of a crash outside of any call.
        self.env.observe(self._lost, self._raise_lost)
        self._do("activate", self._limits.start_s)

    def step(self) -> None:
        """Run the plugin's own; its period may change with it."""
        self.period_s = _PERIOD.decode(self._ask(messages.Do("step"), self._limits.call_s))

    def deactivate(self) -> None:
        """Run the plugin's own, then end the process."""
        if self._child is None:
            return
        try:
            self._ask(messages.Do("deactivate"), self._limits.call_s)
        finally:
            self._end("was deactivated")

    def emergency_halt(self) -> None:
        """Run the plugin's own, past whatever it is at; a process that does not obey is killed."""
        child = self._child
        if child is None:
            return
        try:
            child.halts.ask(messages.Do("emergency_halt"), self._limits.halt_s)
        except PeerLost as error:
            raise self._crashed(child, child.how_it_ended()) from error
        except PeerLate as error:
            child.kill()
            raise self._crashed(
                child, f"did not halt within {self._limits.halt_s:g} s, and its process was killed"
            ) from error

    def close(self) -> None:
        """End the process, in any state of the plugin."""
        self._end("was closed")

    def _call(self, name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        signature = self._contract.functions[name]
        request = messages.CallRequest(messages.OWN, name, signature.write_arguments(args, kwargs))
        return signature.read_result(self._ask(request, self._limits.call_s))

    def _get(self, name: str) -> Any:
        return self._contract.attributes[name].decode(self._ask(messages.Get(messages.OWN, name), self._limits.call_s))

    def _start(self) -> None:
        self._end("is restarted")
        try:
            child = ChildProcess(self.env.plugin, ParentServer(self).serve, weakref.WeakMethod(self._on_lost))
        except OSError as error:
            raise PluginError(self.env.plugin, f"no process for {self.env.plugin}: {error}") from error
        self._child = child
        # A plugin gets no notice that its host has dropped it without having deactivated it.
        self._forget = weakref.finalize(self, child.end)
        self._ask(self._begin(), self._limits.start_s)

    def _begin(self) -> messages.Begin:
        env = self.env
        return messages.Begin(
            robot=env.robot,
            team=env.wire.team,
            plugin=env.plugin,
            manifest=str(self._manifest.path),
            class_path=self._manifest.class_path,
            parameters=encode(self.parameters),
            seeds=env.seeds,
            connect=env.connect,
            clock_offset_ns=LiveClock().offset_ns,
            import_path=sys.path,
            memory_mb=self._limits.memory_mb,
        )

    def _do(self, function: str, limit_s: float) -> None:
        try:
            self.period_s = _PERIOD.decode(self._ask(messages.Do(function), limit_s))
        except BaseException:
            self._end(f"has failed in {function}")
            raise

    def _ask(self, request: Request, limit_s: float) -> bytes:
        child = self._child
        if child is None:
            raise PluginCrashed(self.env.plugin, f"{self.env.plugin} {self._gone_reason}")
        try:
            return child.calls.ask(request, limit_s)
        except PeerLost as error:
            raise self._crashed(child, f"{child.how_it_ended()} in {_what(request)}") from error
        except PeerLate as error:
            where = _where(child)
            child.kill()
            reason = f"did not come back from {_what(request)} within {limit_s:g} s, and its process was killed"
            raise raised_elsewhere(self._crashed(child, reason), where) from error

    def _receive(self, subscription: int, value: Any) -> None:
        """An event that the plugin observes has happened; in its turn."""
        self._ask(messages.ObservedEvent(subscription, encode(value)), self._limits.call_s)

    def _end(self, reason: str) -> None:
        child, self._child = self._child, None
        if child is not None:
            self._gone_reason = reason
            child.end()
        if self._forget is not None:
            self._forget.detach()
            self._forget = None

    def _crashed(self, child: ChildProcess, reason: str) -> PluginCrashed:
        if self._child is child:
            self._child = None
            self._gone_reason = reason
        return PluginCrashed(self.env.plugin, f"{self.env.plugin} {reason}")

    def _on_lost(self, reason: str) -> None:
        """On the thread that watches the process: it has ended without a call in progress."""
        child = self._child
        if child is not None:
            self._gone_reason = reason
            self._lost.notify(child)

    def _raise_lost(self, child: ChildProcess) -> None:
        if self._child is child:  # else a call has run into it already, or another one has been started
            raise self._crashed(child, self._gone_reason)


def isolated_class(plugin_class: type[Plugin], manifest: Manifest) -> type[Plugin]:
    """The class that the host uses instead of `plugin_class`, for `isolation = "process"`.

    Args:
        plugin_class: the plugin's real class. Its module is imported here as well, its instances live elsewhere.
        manifest: the plugin's, from which its process imports the class.

    Raises:
        PluginError: the types of its functions cannot be read, or are of no use between processes.

    """
    try:
        contract = contract_of(plugin_class)
    except Exception as error:  # hints are foreign code: get_type_hints and msgspec may not understand them
        raise PluginError(
            manifest.name, f"{plugin_class.__name__} cannot run in a separate process: {error}"
        ) from error
    members = {name: inspect.getattr_static(plugin_class, name) for name in dir(plugin_class)}
    offered: dict[str, Any] = {name: _attribute(name) for name in contract.attributes}
    offered |= {name: member for name, member in members.items() if isinstance(member, Event)}
    offered |= {name: _function(name, members[name]) for name in contract.functions if name in members}
    own = {
        "__doc__": plugin_class.__doc__,
        "__module__": plugin_class.__module__,
        "__qualname__": plugin_class.__qualname__,
        "level": plugin_class.level,
        "interface": plugin_class.interface,
        "Parameters": plugin_class.Parameters,
        "period_s": plugin_class.period_s,
        "_manifest": manifest,
        "_plugin_class": plugin_class,
        "_limits": limits_of(manifest),
        "_contract": contract,
    }
    return type(plugin_class.__name__, (IsolatedPlugin,), offered | own)


def _function(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)  # with its signature, its hints and its marks: external functions stay external
    def call(self: IsolatedPlugin, *args: Any, **kwargs: Any) -> Any:
        return self._call(name, args, kwargs)

    return call


def _attribute(name: str) -> property:
    return property(lambda self: self._get(name))


def _where(child: ChildProcess) -> Raised:
    """The line that a process is at; empty if it does not answer, as in native code."""
    try:
        return decoder(Raised).decode(child.halts.ask(messages.Do(messages.WHERE), WHERE_S))  # type: ignore[no-any-return]
    except Exception:  # noqa: BLE001 - the other end may be in any state, and is about to be killed
        return Raised()


def _what(request: Request) -> str:
    match request:
        case messages.Do(function) | messages.CallRequest(_, function, _):
            return function
        case messages.Get(_, attribute):
            return attribute
        case messages.ObservedEvent():
            return "an event that it observes"
        case _:
            return "its start"


def try_import(module: str, file: Path | None, limit_s: float) -> str:
    """Import a module in a separate process.

    Args:
        module: its name, if it is installed.
        file: where it lies, if it does not.
        limit_s: how long that may take.

    Returns:
        Cause of the process's failure. Empty if there was none, also where the import has raised an error, which the
        robot's own import reports better.

    """
    command = [sys.executable, "-c", IMPORT, module, str(file or "")]
    try:
        ended = subprocess.run(command, check=False, timeout=limit_s, capture_output=True)
    except subprocess.TimeoutExpired:
        return f"has not come back for {limit_s:g} s"
    return how_it_ended(ended.returncode) if ended.returncode < 0 else ""


class _Held(NamedTuple):
    handle: Any
    contract: Contract


class ParentServer:
    """Answers one process, with the environment and the rights of its plugin.

    Args:
        plugin: represents the plugin here, and has its events; held by a weak reference.

    """

    def __init__(self, plugin: IsolatedPlugin) -> None:
        self._env = plugin.env
        self._plugin = weakref.ref(plugin)
        self._own_module = plugin._plugin_class.__module__
        self._held: list[_Held] = []

    def serve(self, request: Request) -> bytes:
        """Handle the request.

        Raises:
            Exception: the error of the plugin concerned.

        """
        match request:
            case messages.CallRequest(number, function, arguments):
                held = self._get(number)
                args, kwargs = held.contract.functions[function].read_arguments(arguments)
                return encode(getattr(held.handle, function)(*args, **kwargs))
            case messages.Get(number, attribute):
                return encode(getattr(self._get(number).handle, attribute))
            case messages.Use(plugin, module, name):
                interface = self._interface(plugin, module, name)
                self._held.append(_Held(self._env.use(plugin, interface), Contract(interface)))
                return encode(len(self._held))
            case messages.Observe(number, event, subscription):
                self._observe(getattr(self._get(number).handle, event), subscription)
            case messages.ReadBoard(name):
                return encode(getattr(self._env.board, name))
            case messages.WriteBoard(name, value):
                self._write_board(name, value)
            case messages.Notify(event, value):
                self._notify(event, value)
            case messages.Log(level, text):
                plugin, number = self._env.plugin, logging.getLevelNamesMapping().get(level.upper(), logging.INFO)
                logging.getLogger(plugin).log(number, text, extra={"plugin": plugin})
            case _:
                raise PluginError(self._env.plugin, f"{type(request).__name__} is not for this end")
        return b""

    def _get(self, number: int) -> _Held:
        return self._held[number - 1]

    def _observe(self, event: Any, subscription: int) -> None:
        plugin = self._plugin()
        if plugin is not None:
            self._env.observe(event, partial(plugin._receive, subscription))

    def _notify(self, name: str, written: bytes) -> None:
        plugin = self._plugin()
        if plugin is not None:
            getattr(plugin, name).notify(plugin._contract.events[name].decode(written))

    def _write_board(self, name: str, written: bytes) -> None:
        try:
            setattr(self._env.board, name, decoder(messages.BOARD_TYPES.get(name, Any)).decode(written))
        except msgspec.ValidationError as error:
            logger.error("%s: on the board, %s: %s", self._env.plugin, name, error)  # noqa: TRY400 - the message says it all, no traceback needed

    def _interface(self, plugin: str, module_name: str, name: str) -> type:
        module_name = module_name or self._own_module
        found: Any = sys.modules.get(module_name)
        try:
            found = found or importlib.import_module(module_name)
            for part in name.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError) as error:
            raise AccessDenied(plugin, f"there is no interface {name} in {module_name}") from error
        if not isinstance(found, type):
            raise AccessDenied(plugin, f"{name} in {module_name} is no interface")
        return found
