"""The tag of one plugin: it loads it, holds its manifest and environment, checks access, runs its lifecycle."""

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, cast

from robrain.agent.access import call_from_outside, check_outside, check_use, external_function
from robrain.agent.errors import (
    AccessDenied,
    PluginBusy,
    PluginError,
    PluginHung,
    PluginInactive,
    PluginUnloaded,
)
from robrain.agent.event import Event, Mailbox
from robrain.agent.external import ExternalFunction
from robrain.agent.handle import Handle
from robrain.agent.in_turn import answer_in_turn, in_turn
from robrain.agent.isolation.errors import PluginCrashed
from robrain.agent.leases import Lease
from robrain.agent.listing import plugin_info
from robrain.agent.loading import Loaded, PluginCode, check_parameters, import_code
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Level, Plugin
from robrain.agent.plugin_state import PluginState
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.agent.turn import Turn
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Handler, Serve
from robrain.protocol.wire.messages import PluginInfo
from robrain.protocol.wire.topics import Topic

if TYPE_CHECKING:
    from robrain.agent.manager import PluginManager

logger = logging.getLogger(__name__)

InterfaceT = TypeVar("InterfaceT")

NEVER_NS = 1 << 63
CLEAN_UP_TIMEOUT_S = 0.1
"""How long a faulted plugin may keep the host waiting before it cleans up."""
LOCK_TIMEOUT_S = 2.0
"""A plugin that does not come back for so long when it is to be deactivated is left behind."""


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
        """Who in the robot uses the plugin exclusively."""
        self._holding = threading.Lock()
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
        self._making: Loaded | None = None
        self._in_halt: Loaded | None = None
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
    def is_imported(self) -> bool:
        """Whether the class could be imported."""
        return self._code is not None

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

    def holds(self, loaded: Loaded) -> bool:
        """Whether this is the instance that is there now."""
        return self._loaded is loaded

    @property
    def held_by(self) -> str:
        """Who uses the plugin exclusively, inside or outside; nobody if empty."""
        return self.holder or self._manager.leases.holder(self.name)

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
            plugin = self.plugin
            self._begin()
            plugin.activate()
            self._started()

    def deactivate(self, why: str = "") -> None:
        """Call the plugin's `deactivate` and let go of all that its tag holds for it."""
        if not self.turn.acquire(LOCK_TIMEOUT_S):
            logger.error("%s: plugin %s hangs and is left behind", self._manager.robot, self.name)
            self.abandon(why or "hangs")
            return
        try:
            if self._loaded is None or self.state not in (PluginState.ACTIVE, PluginState.HALTED):
                return
            self._become(PluginState.INACTIVE, why)
            loaded = self._loaded
            try:
                loaded.plugin.deactivate()
            finally:
                self._let_go()
                loaded.end_wire()
        finally:
            self.turn.release()

    def replace(self, manifest: Manifest) -> None:
        """Take a new instance, made from the manifest and code as they are now on disk, in place of the old.

        The new one is imported, created and initialised beside the old. If that or its activation fails, the old one
        keeps running, and the error is raised. Handles and observers follow.
        """
        code = import_code(manifest, fresh=True)
        self._manager.check_heir(manifest, code.plugin_class)
        old = self._loaded
        fresh = self._create(manifest, code, heir_of=old)
        try:
            with self.turn:
                self._hand_over(fresh, manifest)
        except BaseException:
            fresh.close()
            raise
        if old is not None:
            old.close()

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
            loaded.close()

    def drop(self) -> None:
        """Let a faulted instance clean up after itself as well as it can, and forget it."""
        loaded = self._loaded
        if loaded is None:
            return
        if not self.turn.acquire(CLEAN_UP_TIMEOUT_S):
            self.abandon(self.why)
            return
        try:
            self._clean_up(loaded)
        finally:
            self.turn.release()
        self._loaded = None
        loaded.close()

    def halt(self) -> None:
        """Refuse calls, then call `emergency_halt` without the lock; PluginHung if it still hangs in an earlier one."""
        self.refuse_calls()
        loaded = self._loaded
        if loaded is None:
            return
        if self._in_halt is loaded:
            raise PluginHung(self.name, f"{self.name} has not come back from an earlier emergency_halt")
        self._in_halt = loaded
        try:
            loaded.plugin.emergency_halt()
        finally:
            self._in_halt = None
            loaded.environment.end_actions("emergency halt")

    def refuse_calls(self) -> None:
        """The first half of a halt."""
        if self.state is PluginState.ACTIVE:
            self._become(PluginState.HALTED, "emergency halt")

    def resume(self) -> None:
        """Take calls again after a halt."""
        if self.state is PluginState.HALTED:
            if self._loaded is not None:  # a call that was under way may have begun one after the halt
                self._loaded.environment.end_actions("emergency halt")
            self._become(PluginState.ACTIVE)

    def close(self) -> None:
        """Let go of the instance and its wire."""
        loaded, self._loaded = self._loaded, None
        if loaded is not None:
            loaded.close()

    def unloaded(self) -> None:
        """The tag is of no use any more: handles on it say so."""
        self._let_go()
        self.close()
        self._become(PluginState.UNLOADED, "it was unloaded")

    def leave_out(self, why: str) -> None:
        """The plugin cannot be started; it stays listed with the reason."""
        self._become(PluginState.FAULTED, why)
        self._let_go()

    def _hand_over(self, fresh: Loaded, manifest: Manifest) -> None:
        old, old_code, old_manifest, before, why = self._loaded, self._code, self.manifest, self.state, self.why
        try:
            self.deactivate("it is being reloaded")
        except Exception:
            # Foreign plugin code, which is about to be replaced.
            logger.exception("%s: plugin %s failed while it was reloaded", self._manager.robot, self.name)
        self._hold(fresh, manifest, fresh.code)
        try:
            self._begin()
            fresh.plugin.activate()
            self._started()
        except BaseException:
            self._let_go()
            self._clean_up(fresh)
            fresh.end_wire()
            self._hold(old, old_manifest, old_code)
            self._become(before, why)
            if old is not None:
                old.take_over(old)
            if old is not None and before in (PluginState.ACTIVE, PluginState.HALTED):
                self._again(old)
            raise

    def _hold(self, loaded: Loaded | None, manifest: Manifest, code: PluginCode | None) -> None:
        self.manifest, self._code, self._loaded = manifest, code, loaded
        self.turn.set_limit(manifest.tag.hang_s)

    def _again(self, old: Loaded) -> None:
        try:
            self._begin()
            old.plugin.activate()
            self._started()
        except Exception as error:  # noqa: BLE001 - foreign plugin code
            self.fault(error)

    def _clean_up(self, loaded: Loaded) -> None:
        try:
            loaded.plugin.deactivate()
        except Exception as error:  # noqa: BLE001 - foreign plugin code, and faulted at that
            logger.debug("%s: plugin %s could not clean up: %s", self._manager.robot, self.name, error)

    def _create(self, manifest: Manifest, code: PluginCode, *, heir_of: Loaded | None = None) -> Loaded:
        parameters = check_parameters(manifest, code, self._manager.parameters_of(self.name))
        environment = self._manager.make_environment(self)
        try:
            plugin = code.plugin_class(environment, parameters)
            loaded = Loaded(code, plugin, environment, environment.wire)
            if heir_of is not None:
                loaded.take_over(heir_of)
            self._making = loaded
            plugin.init()
        except BaseException:
            environment.close()
            if heir_of is not None:
                heir_of.take_over(heir_of)
            raise
        finally:
            self._making = None
        return loaded

    def _started(self) -> None:
        period_s = self.period_s
        if period_s is not None and not period_s > 0:
            raise PluginError(self.name, f"{self.name}: expected period_s > 0 or None, got {period_s}")
        self.period_ns = to_ns(period_s) if period_s is not None else 0
        self.due_ns = 0 if self.period_ns else NEVER_NS
        self._become(PluginState.ACTIVE)
        if self._manager.halted:  # looked at last: a halt that comes now sees that it is active
            self.refuse_calls()
        if self.mailbox.wake is not None:
            self.mailbox.wake()  # its thread sleeps while there is nothing to step

    def _become(self, state: PluginState, why: str = "") -> None:
        self.state = state
        self.why = why

    def _begin(self) -> None:
        """Before the plugin's `activate`, which may notify already."""
        if self._loaded is not None:
            self._loaded.begin(self._manager.open_wire(self))

    def _let_go(self) -> None:
        if self._loaded is not None:
            self._loaded.environment.end(self.why or f"{self.name} is {self.state}")
        for event in self._observed:
            event.remove(self.mailbox)
        self._observed.clear()
        waiting = self.mailbox  # for functions of an instance that is not to be told of anything any more
        self.mailbox = Mailbox()
        self.mailbox.wake, self.mailbox.dropped = waiting.wake, waiting.dropped
        for kind in self._kinds:
            self._manager.desk.unregister(kind)
        self._kinds.clear()
        self._manager.release(self.name)
        self._manager.leases.drop(self.name)

    # -- running --------------------------------------------------------------------------------------------

    def run_step(self) -> None:
        """Deliver what was notified, then the plugin's own step; a plugin that raises is faulted."""
        self._run(steps=True)

    def deliver(self) -> None:
        """Deliver what was notified, between two steps or to a passive plugin."""
        self._run(steps=False)

    def _run(self, *, steps: bool) -> None:
        turn = self.turn
        if not turn.acquire(turn.limit_s):
            return  # a caller is stuck in it: the host sees to that
        try:
            loaded = self._loaded
            if self.state is not PluginState.ACTIVE or loaded is None:
                return
            try:
                self.mailbox.deliver()
                if steps and loaded.plugin.period_s is not None:
                    loaded.plugin.step()
            except Exception as error:  # noqa: BLE001 - foreign plugin code
                if loaded is self._loaded:
                    self.blame(error)
        finally:
            turn.release()

    def blame(self, error: Exception) -> None:
        """What the plugin raised is its fault, unless it ran into a halt or an end of what it calls."""
        if isinstance(error, PluginInactive) and self._manager.excuses(self, error.plugin):
            return
        if isinstance(error, PluginCrashed) and error.plugin != self.name:
            return  # the process of one that it called has ended, which is told to that one
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
        check_use(self, caller, interface)
        if not self.manifest.tag.shared:
            with self._holding:
                outside = self._manager.leases.holder(self.name)
                if outside or (self.holder and self.holder != caller.name):
                    raise PluginBusy(self.name, outside or self.holder)
                self.holder = caller.name
        return Handle(self, interface, caller)

    def hold(self, by: str, lease_s: float) -> Lease:
        """Let somebody outside have the plugin for themselves for a time, or longer if they have it.

        Raises:
            PluginBusy: somebody else holds it.
            PluginError: it cannot be held, or not now.
            BadName, ValueError: see ExternalLeases.take.

        """
        check_outside(self)
        if self.manifest.tag.shared:
            raise PluginError(self.name, f"{self.name} is shared: nobody can hold it")
        self.live_plugin()
        with self._holding:
            if self.holder:
                raise PluginBusy(self.name, self.holder)
            return self._manager.leases.take(self.name, by, lease_s)

    def call_external(self, function: str, payload: bytes, *, by: str = "") -> Any:
        """Call an external function with JSON arguments.

        Args:
            function: its external name, or that of one signature.
            payload: an array by position, an object by name, or nothing.
            by: who calls; only that one may call a plugin that it holds.

        Raises:
            CallError: with the code that says why not.

        """
        known = self._external(function, by)
        return call_from_outside(self, known, lambda plugin: known.call(plugin, payload))

    def call_external_text(self, function: str, words: list[str], *, by: str = "") -> str:
        """Call an external function with arguments as text; the result is text as well (CallError as above)."""
        known = self._external(function, by)
        return str(call_from_outside(self, known, lambda plugin: known.call_text(plugin, words)))

    def _external(self, function: str, by: str) -> ExternalFunction:
        return external_function(self, function, lambda: self._manager.leases.holder(self.name), by)

    def observe(self, event: Event[Any], function: Callable[[Any], None]) -> None:
        """Have the plugin told of an event, through the tag's mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def answer(self, topic: Topic, handler: Handler, names: dict[str, str]) -> None:
        """Answer queries for the plugin, with its lock held."""
        loaded = self._making or self._loaded
        if loaded is None:
            return
        loaded.environment.wire.answer(topic, answer_in_turn(self, loaded, handler), serve=Serve.AT_ONCE, **names)

    def do_tasks(self, desk: TaskDesk, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Register the plugin at the desk; it is called with its lock held, and only while it is active."""
        desk.register(kind, *in_turn(self, accept, let_go))
        self._kinds.append(kind)

    def info(self) -> PluginInfo:
        """What the host tells of the plugin."""
        return plugin_info(self)
