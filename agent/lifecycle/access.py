"""Access to a plugin: rights, handles, exclusive use, and calls that enter it from outside its own step.

The name of an outside holder is the caller's own statement: leases keep well-meaning clients from disturbing each
other. The router decides which participants may address a robot at all.
"""

import logging
import threading
from collections.abc import Callable
from typing import Any, Protocol
from weakref import WeakKeyDictionary

from robrain.agent.environment import Environment
from robrain.agent.errors import FOREIGN_ERRORS, AccessDenied, ForeignError, PluginBusy, PluginError, PluginUnloaded
from robrain.agent.event import Event, ObservableEvent
from robrain.agent.lifecycle.external_function import ExternalFunction, find_function
from robrain.agent.lifecycle.plugin_code import PluginCode
from robrain.agent.lifecycle.turn import PluginLock
from robrain.agent.manifest import ANYBODY, COMMAND, Manifest
from robrain.agent.plugin import UNLOCKED_MARK, Level, Plugin, PluginState
from robrain.agent.plugin_traceback import log_error
from robrain.agent.robot_tasks import Accept, LetGo, TaskWork
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.keys import check_name
from robrain.protocol.messages.robots.host_messages import Lease
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.model.energy_model import Work
from robrain.protocol.model.ranges import cut
from robrain.protocol.model.tasks.task import Task
from robrain.protocol.reasons import plain
from robrain.protocol.wire.endpoint import Handler, Request

logger = logging.getLogger(__name__)


class AccessiblePlugin(Protocol):
    """A plugin that uses others, or is used."""

    name: str
    state: PluginState
    state_reason: str
    """The reason of its state, in words; may be empty."""
    manifest: Manifest
    turn: PluginLock
    exclusive: "ExclusiveUse"
    callable: Plugin | None
    """The instance while it may be called, else None."""
    environment: Environment | None
    """The environment of its instance, the present one or the one that is being made."""
    imported_code: PluginCode | None
    """Its class and functions; None if its class has not been imported, or cannot be."""

    @property
    def plugin_class(self) -> type[Plugin]:
        """Its class (ManifestError if it cannot be imported)."""

    def live_plugin(self) -> Plugin:
        """The instance, if it may be called now (PluginInactive, PluginUnloaded if not)."""

    def holds(self, environment: Environment) -> bool:
        """Whether an environment belongs to the plugin's present instance."""

    def blame(self, error: ForeignError) -> None:
        """Its code has raised this."""


def check_use(callee: AccessiblePlugin, caller: AccessiblePlugin, interface: type) -> None:
    """Whether one plugin may use another by an interface (AccessDenied with the objection)."""
    own = callee.plugin_class
    if own.level >= caller.plugin_class.level:
        raise AccessDenied(
            callee.name,
            level_refusal(caller.name, caller.plugin_class.level, callee.name, own.level),
        )
    visible = callee.manifest.tag.visibility
    if caller.name not in visible and ANYBODY not in visible:
        raise AccessDenied(callee.name, f"{caller.name} is not in the visibility of {callee.name}")
    if own.interface is None or not _offers(own.interface, interface):
        offered = own.interface.__name__ if own.interface else "nothing"
        raise AccessDenied(callee.name, f"{callee.name} offers {offered}, not {interface.__name__}")


def level_refusal(caller: str, level: Level, callee: str, callee_level: Level) -> str:
    """Why a plugin may not call one that is not of a lower level, and the remedy."""
    if callee_level is Level.BEHAVIOR:  # no level is above it
        advice = f"put what {caller} needs of {callee} into a skill that both use"
    else:
        advice = f"make {caller} a {Level(callee_level + 1).name.lower()}"
    levels = level.name.lower(), callee_level.name.lower()
    return f"{caller} ({levels[0]}) may not call {callee} ({levels[1]}): calls go to lower levels only; {advice}"


def level_conflict(name: str, plugin_class: type[Plugin], required: str, required_class: type[Plugin]) -> PluginError:
    """The error of a plugin that requires one that is not of a lower level."""
    return PluginError(name, level_refusal(name, plugin_class.level, required, required_class.level))


def check_outside(callee: AccessiblePlugin) -> None:
    """Whether a plugin is open to the outside (AccessDenied if not)."""
    if COMMAND not in callee.manifest.tag.visibility:
        raise AccessDenied(callee.name, f"{callee.name} is not open to the outside")


def _offers(own: type, wanted: type) -> bool:
    """By name, not by identity: after a reload the class that a caller knows is another one of the same name."""
    if wanted in own.__mro__:
        return True
    name = (wanted.__module__, wanted.__qualname__)
    return any((base.__module__, base.__qualname__) == name for base in own.__mro__)


class ExclusiveUse:
    """The exclusive use of one plugin: by another plugin, or by a client that leases it. May be used on any thread.

    Args:
        plugin: its name.
        clock: the run's clock; a lease that has run out is as none.

    """

    def __init__(self, plugin: str, clock: Clock) -> None:
        self.inside = ""
        """The plugin that holds it; empty if none does."""
        self._plugin = plugin
        self._clock = clock
        self._lease: Lease | None = None
        self._deciding = threading.Lock()

    @property
    def outside(self) -> str:
        """The client that holds it; empty if none does."""
        lease = self._lease
        return lease.holder if lease is not None and self._clock.now_ns() < lease.until_ns else ""

    @property
    def by(self) -> str:
        """The holder, inside or outside; empty if there is none."""
        return self.inside or self.outside

    def rival_of(self, by: str) -> str:
        """The holder that keeps a client from the plugin; empty if there is none."""
        outside = self.outside
        return self.inside or (outside if outside != by else "")

    def keep(self, user: AccessiblePlugin, *, granted: bool = False) -> None:
        """Give it to a plugin that runs, or is granted a handle, from now on (PluginBusy if another holds it)."""
        if self.inside == user.name:
            return
        with self._deciding:
            if self.by:
                raise PluginBusy(self._plugin, self.by)
            if granted or user.state is PluginState.ACTIVE:
                self.inside = user.name

    def lease(self, by: str, lease_s: float) -> Lease:
        """Lease it to a client from now on for a time; a client's own lease is renewed by it.

        Raises:
            PluginBusy: another holder has it.
            BadName: the holder's name cannot be one.

        """
        role, _, name = by.rpartition(":")  # in a secured team: `operator:ann`
        for part in (name, role) if role else (by,):
            check_name("holder", part)
        with self._deciding:
            if rival := self.rival_of(by):
                raise PluginBusy(self._plugin, rival)
            until_ns = self._clock.now_ns() + to_ns(lease_s)
            self._lease = Lease(plugin=self._plugin, holder=by, until_ns=until_ns)
            return self._lease

    def end_lease(self, by: str) -> bool:
        """End a client's lease; False if it has none."""
        with self._deciding:
            if not by or self.outside != by:
                return False
            self._lease = None
            return True


class Handle:
    """The functions and events of one interface of one plugin, for one caller.

    A call acquires the callee's lock and is refused while the callee is not active. It reaches the instance of the
    callee that exists by then.
    """

    __slots__ = ("__callee", "__caller", "__dict__", "__interface", "__locks", "__user")

    def __init__(
        self, callee: AccessiblePlugin, interface: type, caller: AccessiblePlugin, *, locks: bool = True
    ) -> None:
        write = object.__setattr__
        write(self, "_Handle__callee", callee)
        write(self, "_Handle__user", caller.environment)
        write(self, "_Handle__caller", caller)
        write(self, "_Handle__interface", interface)
        write(self, "_Handle__locks", locks)

    __callee: AccessiblePlugin
    __caller: AccessiblePlugin
    __interface: type
    __locks: bool
    __user: Environment | None

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{name}: nothing can be written through a handle")

    def __getattr__(self, name: str) -> Any:
        if name[0] == "_" and name.startswith("_Handle__"):  # of a copy that `__init__` never ran for
            raise AttributeError(name)
        callee, interface, user, caller = self.__callee, self.__interface, self.__user, self.__caller
        own = callee.plugin_class.interface  # the caller's interface may be another one of the same name
        if name.startswith("_") or name not in _offered(interface) or own is None or name not in _offered(own):
            raise AccessDenied(callee.name, f"{name} is not in {interface.__name__}, the interface of {callee.name}")
        value = getattr(callee.live_plugin(), name)
        if isinstance(value, Event):
            return ObservableEvent(value)
        if not callable(value):
            return value

        if getattr(value, UNLOCKED_MARK, False):
            return lambda *args, **kwargs: getattr(callee.live_plugin(), name)(*args, **kwargs)

        kind = _locked_call if self.__locks else _lockstep_call
        call = self.__dict__[name] = kind(callee, caller, user, name)  # found there from now on
        return call

    def __repr__(self) -> str:
        return f"<handle on {self.__callee.name} as {self.__interface.__name__}>"


def _locked_call(
    callee: AccessiblePlugin, caller: AccessiblePlugin, user: Environment | None, name: str
) -> Callable[..., Any]:
    def call(*args: Any, **kwargs: Any) -> Any:
        turn = callee.turn
        with turn:
            plugin = callee.live_plugin()
            if user is not None:
                if user.has_gone:
                    raise _gone(caller)
                if not callee.manifest.tag.shared:
                    callee.exclusive.keep(caller)
            before, turn.caller = turn.caller, caller.name
            try:
                return getattr(plugin, name)(*args, **kwargs)
            finally:
                turn.caller = before

    return call


def _lockstep_call(
    callee: AccessiblePlugin, caller: AccessiblePlugin, user: Environment | None, name: str
) -> Callable[..., Any]:
    """As `_locked_call`, for one thread: no other thread can be in the plugin."""
    is_gone, own_name = user.gone if user is not None else (), caller.name

    def call(*args: Any, **kwargs: Any) -> Any:
        plugin = callee.callable
        if plugin is None:
            plugin = callee.live_plugin()
        if is_gone:
            raise _gone(caller)
        if not callee.manifest.tag.shared and user is not None and callee.exclusive.inside != own_name:
            callee.exclusive.keep(caller)
        turn = callee.turn
        before, turn.caller = turn.caller, own_name
        turn.depth += 1
        try:
            return getattr(plugin, name)(*args, **kwargs)
        finally:
            turn.depth -= 1
            turn.caller = before

    return call


def _gone(caller: AccessiblePlugin) -> PluginUnloaded:
    return PluginUnloaded(caller.name, f"this instance of {caller.name} has gone")


_offered_by: "WeakKeyDictionary[type, set[str]]" = WeakKeyDictionary()
"""Names in each interface: all robots of a run have the same ones."""


def _offered(interface: type) -> set[str]:
    found = _offered_by.get(interface)
    if found is None:
        # Not hasattr(): a Protocol's own class has `register` and `mro`, which the interface does not offer.
        found = _offered_by[interface] = {
            name for base in interface.__mro__ for name in (*vars(base), *vars(base).get("__annotations__", ()))
        }
    return found


def call_from_outside(
    callee: AccessiblePlugin, function: str, by: str, call: Callable[[ExternalFunction, Plugin], Any]
) -> Any:
    """Call an external function for a client, in the plugin's turn unless the function needs none.

    Args:
        callee: plugin of the function.
        function: its external name, or that of one signature.
        by: name of the caller; only the holder may call a plugin that is held.
        call: calls the function of the instance.

    Raises:
        CallError: with the code of the reason.

    """
    known = _external_function(callee, function, by)
    try:
        if known.unlocked:
            return call(known, callee.live_plugin())
        with callee.turn:
            return call(known, callee.live_plugin())
    except CallError:
        raise
    except PluginError as error:
        raise CallError(error.code, str(error), getattr(error, "holder", "")) from error
    except FOREIGN_ERRORS as error:  # foreign plugin code; the caller and the log both get its traceback
        kind = type(error).__name__
        detail = log_error(logger, f"plugin {callee.name}: {known.name} failed: {kind}", error)
        raise CallError(ErrorCode.FAILED, f"{kind}: {error}", detail) from error


def _external_function(callee: AccessiblePlugin, function: str, by: str) -> ExternalFunction:
    if COMMAND not in callee.manifest.tag.visibility:
        raise CallError(ErrorCode.FORBIDDEN, f"{callee.name} is not open to the outside")
    code = callee.imported_code
    if code is None:
        raise CallError(ErrorCode.INACTIVE, f"{callee.name} is {callee.state}: {callee.state_reason}")
    known = find_function(code.functions, function)
    if known is None:
        names = ", ".join(code.functions) or "none"
        raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{callee.name} has no function {function}; it has: {names}")
    if callee.state is PluginState.HALTED:
        raise CallError(ErrorCode.HALTED, f"{callee.name} is halted")
    if not callee.manifest.tag.shared:
        holder = callee.exclusive.rival_of(by)
        if holder:
            raise CallError(ErrorCode.BUSY, str(PluginBusy(callee.name, holder)), holder)
    return known


def task_handlers(
    plugin: AccessiblePlugin, accept: Accept, let_go: LetGo, work: TaskWork
) -> tuple[Accept, LetGo, TaskWork]:
    """The same three, called with the plugin's lock held.

    `accept` is called only while the plugin is active; an error of `accept` or `let_go` is a fault of the plugin.
    """

    def accept_in_turn(task: Task) -> TaskAnswer:
        try:
            with plugin.turn:
                if plugin.state is not PluginState.ACTIVE:
                    return _refused_by_state(plugin)
                return accept(task)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            plugin.blame(error)
            return _refused_by_state(plugin, f": {cut(plugin.state_reason or str(error))}")

    def release_in_turn(reason: str) -> None:
        try:
            with plugin.turn:
                let_go(reason)
        except FOREIGN_ERRORS as error:  # foreign plugin code
            plugin.blame(error)

    def work_in_turn(task: Task) -> Work:
        with plugin.turn:
            return work(task)

    return accept_in_turn, release_in_turn, work_in_turn


def _refused_by_state(plugin: AccessiblePlugin, reason: str = "") -> TaskAnswer:
    text = f"{plugin.name} is {plugin.state}{reason}"
    return TaskAnswer.refused(plain("plugin_out", text, plugin=plugin.name, state=plugin.state))


def query_handler(plugin: AccessiblePlugin, environment: Environment, handler: Handler[Any, Any]) -> Handler[Any, Any]:
    """The same handler, called with the plugin's lock held and only while this instance is there."""

    def answer(request: Request[Any]) -> Any:
        try:
            with plugin.turn:
                if not plugin.holds(environment) or not plugin.state.is_running:
                    raise CallError(ErrorCode.INACTIVE, f"{plugin.name} is {plugin.state}: {plugin.state_reason}")
                return handler(request)
        except PluginError as error:
            raise CallError(error.code, str(error)) from error

    return answer
