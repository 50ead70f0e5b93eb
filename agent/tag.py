"""The tag of one plugin: it loads it, holds its manifest and environment, checks access, runs its lifecycle."""

import importlib
import importlib.util
import logging
import sys
import threading
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import msgspec

from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, ManifestError, PluginBusy, PluginError, PluginInactive
from robrain.agent.event import Event, Mailbox
from robrain.agent.external import ExternalFunction, external_functions
from robrain.agent.handle import Handle
from robrain.agent.manifest import ANYBODY, COMMAND, Manifest, where_and_what
from robrain.agent.plugin import Level, Plugin
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.protocol.model.task import Task
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Handler, Request, Serve
from robrain.protocol.wire.errors import CallError, ErrorCode
from robrain.protocol.wire.messages import PluginInfo, TaskAnswer
from robrain.protocol.wire.topics import Topic

if TYPE_CHECKING:
    from robrain.agent.manager import PluginManager

logger = logging.getLogger(__name__)

InterfaceT = TypeVar("InterfaceT")

NEVER_NS = 1 << 63

LOCK_TIMEOUT_S = 2.0
"""A plugin that does not come back for so long when it is to be deactivated is left behind."""


class PluginState(StrEnum):
    """Where a plugin stands."""

    DISCOVERED = "discovered"
    LOADED = "loaded"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FAULTED = "faulted"
    HALTED = "halted"


class PluginTag:
    """Manages one plugin, and stands between it and the manager."""

    def __init__(self, manifest: Manifest, manager: "PluginManager") -> None:
        self.manifest = manifest
        self.name = manifest.name
        self.state = PluginState.DISCOVERED
        self.why = ""
        self.lock = threading.RLock()
        self.mailbox = Mailbox()
        self.holder = ""
        """Who uses the plugin exclusively."""
        self.overruns = 0
        self.period_ns = 0
        """How often the plugin wants its step; 0 if it is passive."""
        self.due_ns = NEVER_NS
        """When its next step is due, in lockstep."""
        self._manager = manager
        self._plugin: Plugin | None = None
        self._class: type[Plugin] | None = None
        self._environment: Environment | None = None
        self._functions: dict[str, ExternalFunction] = {}
        self._observed: list[Event[Any]] = []
        self._kinds: list[type] = []

    # -- lifecycle ------------------------------------------------------------------------------------------

    @property
    def plugin_class(self) -> type[Plugin]:
        """The plugin's class; imported on first use.

        Raises:
            ManifestError: it cannot be imported, or is no plugin.

        """
        if self._class is None:
            found = self._import()
            try:
                self._functions = external_functions(found)
            except Exception as error:  # hints are foreign code: msgspec or get_type_hints may not understand them
                raise ManifestError(
                    self.manifest.path, "[plugin] class", f"the external functions of {found.__name__}: {error}"
                ) from error
            self._class = found
        return self._class

    @property
    def level(self) -> Level:
        """The plugin's level; the highest if its class could not be imported."""
        return self._class.level if self._class is not None else max(Level)

    @property
    def plugin(self) -> Plugin:
        """The instance.

        Raises:
            PluginInactive: it is not loaded.

        """
        if self._plugin is None:
            raise PluginInactive(self.name, f"{self.name} is {self.state}{f': {self.why}' if self.why else ''}")
        return self._plugin

    @property
    def period_s(self) -> float | None:
        """How often the plugin wants its step; None if it is passive or not there."""
        return self._plugin.period_s if self._plugin is not None else None

    def live_plugin(self) -> Plugin:
        """The instance, if it may be called now (PluginInactive if not)."""
        if self.state is not PluginState.ACTIVE or self._plugin is None:
            raise PluginInactive(self.name, f"{self.name} is {self.state}{f': {self.why}' if self.why else ''}")
        return self._plugin

    def load(self) -> None:
        """Create the plugin with its checked parameters and environment, and call its `init`."""
        plugin_class = self.plugin_class
        given = {**self.manifest.parameters, **self._manager.parameters_of(self.name)}
        try:
            parameters = msgspec.convert(given, plugin_class.Parameters)
        except msgspec.ValidationError as error:
            where, what = where_and_what(error)
            key = "[parameters]" if where == "file" else f"[parameters] {where}"
            overridden = ", ".join(sorted(self._manager.parameters_of(self.name)))
            if overridden:
                what = f"{what} (the robot's file sets {overridden})"
            raise ManifestError(self.manifest.path, key, what) from error
        self._environment = self._manager.make_environment(self)
        self._plugin = plugin_class(self._environment, parameters)
        self._plugin.init()
        self._become(PluginState.LOADED)

    def activate(self) -> None:
        """Call the plugin's `activate`; it is callable from then on."""
        with self.lock:
            self.plugin.activate()
            self.period_ns = self._checked_period_ns()
            self.due_ns = 0 if self.period_ns else NEVER_NS
            self._become(PluginState.ACTIVE)

    def deactivate(self) -> None:
        """Call the plugin's `deactivate` and let go of all that its tag holds for it."""
        if not self.lock.acquire(timeout=LOCK_TIMEOUT_S):
            logger.error("%s: plugin %s hangs and is left behind", self._manager.robot, self.name)
            self._become(PluginState.FAULTED, "hangs")
            self._let_go()
            return
        try:
            if self._plugin is None or self.state not in (PluginState.ACTIVE, PluginState.HALTED):
                return
            self._become(PluginState.INACTIVE)
            try:
                self._plugin.deactivate()
            finally:
                self._let_go()
        finally:
            self.lock.release()

    def fault(self, error: Exception) -> None:
        """The plugin raised: it is not called any more."""
        logger.error("%s: plugin %s faulted: %s", self._manager.robot, self.name, error, exc_info=error)
        self._become(PluginState.FAULTED, f"{type(error).__name__}: {error}")
        self._let_go()

    def halt(self) -> None:
        """Refuse calls, then call the plugin's `emergency_halt`, without its lock."""
        self.refuse_calls()
        if self._plugin is not None:
            self._plugin.emergency_halt()

    def refuse_calls(self) -> None:
        """The first half of a halt."""
        if self.state is PluginState.ACTIVE:
            self._become(PluginState.HALTED, "emergency halt")

    def resume(self) -> None:
        """Take calls again after a halt."""
        if self.state is PluginState.HALTED:
            self._become(PluginState.ACTIVE)

    def close(self) -> None:
        """Let go of the wire as well; the tag is of no use any more."""
        if self._environment is not None:
            self._environment.wire.close()
            self._environment = None

    def leave_out(self, why: str) -> None:
        """The plugin cannot be started; it stays listed with the reason."""
        self._become(PluginState.FAULTED, why)
        self._let_go()

    def _checked_period_ns(self) -> int:
        period_s = self.period_s
        if period_s is not None and not period_s > 0:
            raise PluginError(self.name, f"{self.name}: expected period_s > 0 or None, got {period_s}")
        return to_ns(period_s) if period_s is not None else 0

    def _become(self, state: PluginState, why: str = "") -> None:
        self.state = state
        self.why = why

    def _let_go(self) -> None:
        for event in self._observed:
            event.remove(self.mailbox)
        self._observed.clear()
        if self._environment is not None:
            for kind in self._kinds:
                self._environment.tasks.unregister(kind)
        self._kinds.clear()
        self._manager.release(self.name)

    # -- running --------------------------------------------------------------------------------------------

    def run_step(self) -> None:
        """Deliver what was notified, then the plugin's own step; a plugin that raises is faulted."""
        with self.lock:
            if self.state is not PluginState.ACTIVE or self._plugin is None:
                return
            try:
                self.mailbox.deliver()
                if self._plugin.period_s is not None:
                    self._plugin.step()
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                self._blame(error)

    def deliver(self) -> None:
        """Deliver what was notified, between two steps or to a passive plugin."""
        with self.lock:
            if self.state is not PluginState.ACTIVE:
                return
            try:
                self.mailbox.deliver()
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                self._blame(error)

    def _blame(self, error: Exception) -> None:
        """What the plugin raised is its fault, unless it ran into an emergency halt of what it calls."""
        if not (isinstance(error, PluginInactive) and self._manager.halted):
            self.fault(error)

    # -- access ---------------------------------------------------------------------------------------------

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """A handle on another plugin for this tag's plugin; the manager decides with the other's tag."""
        if name not in self.manifest.tag.requires:
            raise AccessDenied(
                name, f"{self.name} must name {name} in [tag] requires of {self.manifest.path} to use it"
            )
        return cast(InterfaceT, self._manager.request(self, name, interface))

    def grant(self, caller: "PluginTag", interface: type) -> Handle:
        """A handle on this tag's plugin for a caller.

        Raises:
            AccessDenied: the level, the visibility or the interface speaks against it.
            PluginBusy: somebody else holds it.

        """
        own = self.plugin_class
        if own.level >= caller.plugin_class.level:
            raise AccessDenied(
                self.name,
                f"{caller.name} ({caller.plugin_class.level.name.lower()}) may not call {self.name} "
                f"({own.level.name.lower()}): calls go to lower levels only; merge {caller.name} and {self.name}",
            )
        visible = self.manifest.tag.visibility
        if caller.name not in visible and ANYBODY not in visible:
            raise AccessDenied(self.name, f"{caller.name} is not in the visibility of {self.name}")
        if own.interface is None or interface not in own.interface.__mro__:
            offered = own.interface.__name__ if own.interface else "nothing"
            raise AccessDenied(self.name, f"{self.name} offers {offered}, not {interface.__name__}")
        if not self.manifest.tag.shared:
            if self.holder and self.holder != caller.name:
                raise PluginBusy(self.name, self.holder)
            self.holder = caller.name
        return Handle(self, interface)

    def call_external(self, function: str, payload: bytes) -> Any:
        """Call an external function with JSON arguments.

        Raises:
            CallError: with the code that says why not.

        """
        if COMMAND not in self.manifest.tag.visibility:
            raise CallError(ErrorCode.FORBIDDEN, f"{self.name} is not open to the outside")
        if self._class is None:
            raise CallError(ErrorCode.INACTIVE, f"{self.name} is {self.state}: {self.why}")
        known = self._functions.get(function)
        if known is None:
            names = ", ".join(self._functions) or "none"
            raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{self.name} has no function {function}; it has: {names}")
        if self.state is PluginState.HALTED:
            raise CallError(ErrorCode.HALTED, f"{self.name} is halted")
        with self.lock:
            try:
                return known.call(self.live_plugin(), payload)
            except PluginError as error:
                raise CallError(error.code, str(error)) from error

    def observe(self, event: Event[Any], function: Callable[[Any], None]) -> None:
        """Have the plugin told of an event, through the tag's mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def answer(self, topic: Topic, handler: Handler, names: dict[str, str]) -> None:
        """Answer queries for the plugin, with its lock held."""

        def locked(request: Request) -> Any:
            with self.lock:
                return handler(request)

        if self._environment is not None:
            self._environment.wire.answer(topic, locked, serve=Serve.AT_ONCE, **names)

    def do_tasks(self, desk: TaskDesk, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Register the plugin at the desk; it is called with its lock held, and only while it is active."""

        def locked_accept(task: Task) -> TaskAnswer:
            with self.lock:
                if self.state is not PluginState.ACTIVE:
                    return TaskAnswer(accepted=False, why=f"{self.name} is {self.state}")
                try:
                    return accept(task)
                except Exception as error:  # noqa: BLE001 - foreign plugin code
                    self._blame(error)
                    return TaskAnswer(accepted=False, why=f"{self.name} is {self.state}: {self.why}")

        def locked_let_go(why: str) -> None:
            with self.lock:
                try:
                    let_go(why)
                except Exception as error:  # noqa: BLE001 - foreign plugin code
                    self._blame(error)

        desk.register(kind, locked_accept, locked_let_go)
        self._kinds.append(kind)

    def info(self) -> PluginInfo:
        """What the host tells of the plugin."""
        known = self._class
        return PluginInfo(
            name=self.name,
            level=known.level.name.lower() if known is not None else "",
            state=self.state.value,
            why=self.why,
            visibility=self.manifest.tag.visibility,
            requires=self.manifest.tag.requires,
            holder=self.holder,
            period_s=self.period_s,
            overruns=self.overruns,
            doc=(known.__doc__ or "").strip().partition("\n")[0] if known is not None else "",
            functions=[function.info for function in self._functions.values()],
        )

    def _import(self) -> type[Plugin]:
        module_name, _, class_name = self.manifest.class_path.partition(":")
        path = self.manifest.path
        try:
            beside = path.parent / f"{module_name}.py"
            module = _import_file(beside) if beside.is_file() else importlib.import_module(module_name)
        except Exception as error:  # foreign code may raise anything while it is imported
            raise ManifestError(path, "[plugin] class", f"cannot import {module_name}: {error}") from error
        found = getattr(module, class_name, None)
        if not (isinstance(found, type) and issubclass(found, Plugin) and hasattr(found, "level")):
            raise ManifestError(
                path,
                "[plugin] class",
                f"expected a Device, Unit, Skill or Behavior named {class_name} in {module_name}",
            )
        return found


def _import_file(path: Path) -> Any:
    name = f"robrain_plugin_{path.stem}_{abs(hash(path.resolve())):x}"
    if name in sys.modules:  # as any import: plugins in one file share the interfaces that it declares
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
