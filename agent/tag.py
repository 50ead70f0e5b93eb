"""The tag of one plugin: it loads it, holds its manifest and environment, checks access, runs its lifecycle."""

import logging
from collections.abc import Callable
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TypeVar, cast

from robrain.agent.errors import (
    AccessDenied,
    PluginBusy,
    PluginError,
    PluginHung,
    PluginInactive,
    PluginUnloaded,
)
from robrain.agent.event import Event, Mailbox
from robrain.agent.handle import Handle
from robrain.agent.loading import Loaded, PluginCode, check_parameters, import_code
from robrain.agent.manifest import ANYBODY, COMMAND, Manifest
from robrain.agent.plugin import Level, Plugin
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.agent.turn import Turn
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
    UNLOADED = "unloaded"


class PluginTag:
    """Manages one plugin, and stands between it and the manager."""

    def __init__(self, manifest: Manifest, manager: "PluginManager") -> None:
        self.manifest = manifest
        self.name = manifest.name
        self.state = PluginState.DISCOVERED
        self.why = ""
        self.turn = Turn(self.name, manifest.tag.hang_s, manager.clock)
        """Who is in the plugin at the moment: its lock."""
        self.mailbox = Mailbox()
        self.holder = ""
        """Who uses the plugin exclusively."""
        self.overruns = 0
        self.restarts = 0
        self.generation = 0
        """Grows when the plugin is left behind in a step that hangs."""
        self.period_ns = 0
        """How often the plugin wants its step; 0 if it is passive."""
        self.due_ns = NEVER_NS
        """When its next step is due, in lockstep."""
        self._manager = manager
        self._code: PluginCode | None = None
        self._loaded: Loaded | None = None
        self._observed: list[Event[Any]] = []
        self._kinds: list[type] = []

    # -- what it holds --------------------------------------------------------------------------------------

    @property
    def code(self) -> PluginCode:
        """The plugin's class and functions; imported on first use (ManifestError if that fails)."""
        if self._code is None:
            self._code = import_code(self.manifest)
        return self._code

    @property
    def plugin_class(self) -> type[Plugin]:
        """The plugin's class (ManifestError if it cannot be imported)."""
        return self.code.plugin_class

    @property
    def level(self) -> Level:
        """The plugin's level; the highest if its class could not be imported."""
        return self._code.plugin_class.level if self._code is not None else max(Level)

    @property
    def period_s(self) -> float | None:
        """How often the plugin wants its step; None if it is passive or not there."""
        return self._loaded.plugin.period_s if self._loaded is not None else None

    @property
    def is_there(self) -> bool:
        """Whether there is an instance."""
        return self._loaded is not None

    @property
    def plugin(self) -> Plugin:
        """The instance, whatever its state (PluginInactive if there is none)."""
        if self._loaded is None:
            raise PluginInactive(self.name, f"{self.name} is {self.state}{f': {self.why}' if self.why else ''}")
        return self._loaded.plugin

    def live_plugin(self) -> Plugin:
        """The instance, if it may be called now.

        Raises:
            PluginUnloaded: it has gone.
            PluginInactive: it is there, but not active.

        """
        if self.state is PluginState.ACTIVE and self._loaded is not None:
            return self._loaded.plugin
        kind = PluginUnloaded if self.state is PluginState.UNLOADED else PluginInactive
        raise kind(self.name, f"{self.name} is {self.state}{f': {self.why}' if self.why else ''}")

    def events(self) -> dict[str, Event[Any]]:
        """The events of the instance, by name; none if there is no instance."""
        return self._loaded.events() if self._loaded is not None else {}

    # -- lifecycle ------------------------------------------------------------------------------------------

    def load(self) -> None:
        """Create the plugin with its checked parameters and environment, and call its `init`."""
        self._loaded = self._create(self.manifest, self.code)
        self._become(PluginState.LOADED)

    def activate(self) -> None:
        """Call the plugin's `activate`; it is callable from then on."""
        with self.turn:
            self.plugin.activate()
            self._started()

    def deactivate(self, why: str = "") -> None:
        """Call the plugin's `deactivate` and let go of all that its tag holds for it."""
        if not self.turn.acquire(LOCK_TIMEOUT_S):
            logger.error("%s: plugin %s hangs and is left behind", self._manager.robot, self.name)
            self.abandon("hangs")
            return
        try:
            if self._loaded is None or self.state not in (PluginState.ACTIVE, PluginState.HALTED):
                return
            self._become(PluginState.INACTIVE, why)
            try:
                self._loaded.plugin.deactivate()
            finally:
                self._let_go()
        finally:
            self.turn.release()

    def replace(self, manifest: Manifest) -> None:
        """Take a new instance, made from the manifest and code as they are now on disk, in place of the old.

        The new one is imported, created and initialised beside the old. If that or its activation fails, the old one
        keeps running, and the error is raised. Handles and observers follow.
        """
        code = import_code(manifest, fresh=True)
        fresh = self._create(manifest, code)
        old, old_code, old_manifest, old_state = self._loaded, self._code, self.manifest, self.state
        with self.turn:
            self.deactivate("it is being reloaded")
            if old is not None:
                old.environment.wire.close()
                _move_events(old, fresh)
            self.manifest, self._code, self._loaded = manifest, code, fresh
            try:
                fresh.plugin.activate()
            except BaseException:
                fresh.environment.wire.close()
                self.manifest, self._code, self._loaded = old_manifest, old_code, old
                if old is not None and old_state in (PluginState.ACTIVE, PluginState.HALTED):
                    _move_events(fresh, old)
                    old.environment.wire.reopen()
                    old.plugin.activate()
                    self._started()
                raise
            self._started()

    def fault(self, error: Exception) -> None:
        """The plugin raised, hangs or floods: it is not called any more; the manager sees to the rest in its turn."""
        if self.state in (PluginState.FAULTED, PluginState.UNLOADED):
            return
        logger.error("%s: plugin %s faulted: %s", self._manager.robot, self.name, error, exc_info=error)
        self._become(PluginState.FAULTED, f"{type(error).__name__}: {error}")
        self._let_go()
        self._manager.note_fault(self)

    def abandon(self, why: str) -> None:
        """Leave an instance behind that somebody is stuck in; what it does from now on has no consequence."""
        loaded, self._loaded = self._loaded, None
        self.generation += 1
        self.turn = Turn(self.name, self.manifest.tag.hang_s, self._manager.clock)
        self._become(PluginState.FAULTED, why)
        self._let_go()
        if loaded is not None:
            loaded.environment.wire.close()

    def drop(self) -> None:
        """Let a faulted instance clean up after itself as well as it can, and forget it."""
        loaded = self._loaded
        if loaded is None or not self.turn.acquire(0.1):
            self.abandon(self.why)
            return
        try:
            loaded.plugin.deactivate()
        except Exception as error:  # noqa: BLE001 - foreign plugin code, and faulted at that
            logger.debug("%s: plugin %s could not clean up: %s", self._manager.robot, self.name, error)
        finally:
            self.turn.release()
        loaded.environment.wire.close()
        self._loaded = None

    def halt(self) -> None:
        """Refuse calls, then call the plugin's `emergency_halt`, without its lock."""
        self.refuse_calls()
        loaded = self._loaded
        if loaded is not None:
            loaded.plugin.emergency_halt()

    def refuse_calls(self) -> None:
        """The first half of a halt."""
        if self.state is PluginState.ACTIVE:
            self._become(PluginState.HALTED, "emergency halt")

    def resume(self) -> None:
        """Take calls again after a halt."""
        if self.state is PluginState.HALTED:
            self._become(PluginState.ACTIVE)

    def close(self) -> None:
        """Let go of the instance and its wire."""
        if self._loaded is not None:
            self._loaded.environment.wire.close()
            self._loaded = None

    def unloaded(self) -> None:
        """The tag is of no use any more: handles on it say so."""
        self.close()
        self._become(PluginState.UNLOADED)

    def leave_out(self, why: str) -> None:
        """The plugin cannot be started; it stays listed with the reason."""
        self._become(PluginState.FAULTED, why)
        self._let_go()

    def _create(self, manifest: Manifest, code: PluginCode) -> Loaded:
        parameters = check_parameters(manifest, code, self._manager.parameters_of(self.name))
        environment = self._manager.make_environment(self)
        try:
            loaded = Loaded(code, self._manager.construct(code, environment, parameters, manifest), environment)
            loaded.plugin.init()
        except BaseException:
            environment.wire.close()
            raise
        return loaded

    def _started(self) -> None:
        period_s = self.period_s
        if period_s is not None and not period_s > 0:
            raise PluginError(self.name, f"{self.name}: expected period_s > 0 or None, got {period_s}")
        self.period_ns = to_ns(period_s) if period_s is not None else 0
        self.due_ns = 0 if self.period_ns else NEVER_NS
        if self._manager.halted:
            self._become(PluginState.HALTED, "emergency halt")
        else:
            self._become(PluginState.ACTIVE)

    def _become(self, state: PluginState, why: str = "") -> None:
        self.state = state
        self.why = why

    def _let_go(self) -> None:
        for event in self._observed:
            event.remove(self.mailbox)
        self._observed.clear()
        for kind in self._kinds:
            self._manager.desk.unregister(kind)
        self._kinds.clear()
        self._manager.release(self.name)

    # -- running --------------------------------------------------------------------------------------------

    def run_step(self) -> None:
        """Deliver what was notified, then the plugin's own step; a plugin that raises is faulted."""
        self._run(steps=True)

    def deliver(self) -> None:
        """Deliver what was notified, between two steps or to a passive plugin."""
        self._run(steps=False)

    def _run(self, *, steps: bool) -> None:
        turn = self.turn
        with turn:
            loaded = self._loaded
            if self.state is not PluginState.ACTIVE or loaded is None:
                return
            try:
                self.mailbox.deliver()
                if steps and loaded.plugin.period_s is not None:
                    loaded.plugin.step()
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                if loaded is self._loaded:
                    self._blame(error)

    def _blame(self, error: Exception) -> None:
        """What the plugin raised is its fault, unless it ran into a halt or an end of what it calls."""
        if isinstance(error, PluginInactive) and self._manager.excuses(self, error.plugin):
            return
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
        if own.interface is None or not _offers(own.interface, interface):
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
        known = self._external(function)
        return self._outside_call(known, lambda plugin: known.call(plugin, payload))

    def _external(self, function: str) -> Any:
        if COMMAND not in self.manifest.tag.visibility:
            raise CallError(ErrorCode.FORBIDDEN, f"{self.name} is not open to the outside")
        if self._code is None:
            raise CallError(ErrorCode.INACTIVE, f"{self.name} is {self.state}: {self.why}")
        known = self._code.functions.get(function)
        if known is None:
            names = ", ".join(self._code.functions) or "none"
            raise CallError(ErrorCode.UNKNOWN_FUNCTION, f"{self.name} has no function {function}; it has: {names}")
        if self.state is PluginState.HALTED:
            raise CallError(ErrorCode.HALTED, f"{self.name} is halted")
        return known

    def _outside_call(self, known: Any, call: Callable[[Plugin], Any]) -> Any:
        try:
            with self.turn:
                return call(self.live_plugin())
        except PluginError as error:
            raise CallError(error.code, str(error)) from error

    def observe(self, event: Event[Any], function: Callable[[Any], None]) -> None:
        """Have the plugin told of an event, through the tag's mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def answer(self, topic: Topic, handler: Handler, names: dict[str, str]) -> None:
        """Answer queries for the plugin, with its lock held."""

        def locked(request: Request) -> Any:
            try:
                with self.turn:
                    return handler(request)
            except PluginHung as error:
                raise CallError(error.code, str(error)) from error

        if self._loaded is not None:
            self._loaded.environment.wire.answer(topic, locked, serve=Serve.AT_ONCE, **names)

    def do_tasks(self, desk: TaskDesk, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Register the plugin at the desk; it is called with its lock held, and only while it is active."""

        def locked_accept(task: Task) -> TaskAnswer:
            try:
                with self.turn:
                    if self.state is not PluginState.ACTIVE:
                        return TaskAnswer(accepted=False, why=f"{self.name} is {self.state}")
                    return accept(task)
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                self._blame(error)
                return TaskAnswer(accepted=False, why=f"{self.name} is {self.state}: {self.why or error}")

        def locked_let_go(why: str) -> None:
            try:
                with self.turn:
                    let_go(why)
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                self._blame(error)

        desk.register(kind, locked_accept, locked_let_go)
        self._kinds.append(kind)

    def info(self) -> PluginInfo:
        """What the host tells of the plugin."""
        known = self._code
        return PluginInfo(
            name=self.name,
            level=known.plugin_class.level.name.lower() if known is not None else "",
            state=self.state.value,
            why=self.why,
            visibility=self.manifest.tag.visibility,
            requires=self.manifest.tag.requires,
            holder=self.holder,
            period_s=self.period_s,
            overruns=self.overruns,
            restarts=self.restarts,
            doc=(known.plugin_class.__doc__ or "").strip().partition("\n")[0] if known is not None else "",
            functions=[function.info for function in known.functions.values()] if known is not None else [],
        )


def _offers(own: type, wanted: type) -> bool:
    """By name, not by identity: after a reload the class that a caller knows is another one of the same name."""
    name = (wanted.__module__, wanted.__qualname__)
    return any((base.__module__, base.__qualname__) == name for base in own.__mro__)


def _move_events(source: Loaded, target: Loaded) -> None:
    """Have the observers of one instance observe another: the event objects themselves move."""
    theirs = target.events()
    for name, event in source.events().items():
        if name in theirs:
            target.plugin.__dict__[name] = event
