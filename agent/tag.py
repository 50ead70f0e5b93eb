"""The tag of one plugin: it loads it, holds its manifest and environment, checks access, runs its lifecycle."""

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, cast

from robrain.agent import errors
from robrain.agent.access import call_from_outside, check_outside, check_use, external_function
from robrain.agent.environment import Environment
from robrain.agent.errors import AccessDenied, PluginError, PluginHung, PluginInactive, PluginUnloaded
from robrain.agent.event import Event, EventView, Mailbox
from robrain.agent.external import ExternalFunction
from robrain.agent.handle import Handle
from robrain.agent.holding import Holding
from robrain.agent.in_turn import answer_in_turn, in_turn
from robrain.agent.isolation.errors import PluginCrashed
from robrain.agent.leases import Lease
from robrain.agent.listing import plugin_info
from robrain.agent.loading import Loaded, PluginCode, check_parameters, import_code
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Level, Plugin
from robrain.agent.plugin_state import PluginState
from robrain.agent.plugin_traceback import raised
from robrain.agent.replacement import Replacement
from robrain.agent.task_desk import Accept, LetGo, TaskDesk
from robrain.agent.turn import Turn
from robrain.protocol.wire.clock import to_ns
from robrain.protocol.wire.endpoint import Handler, Serve
from robrain.protocol.wire.messages import PluginInfo
from robrain.protocol.wire.topic import Query

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
        self.become(PluginState.DISCOVERED)
        self.turn = Turn(self.name, manifest.tag.hang_s, manager.clock)
        """Who is in the plugin at the moment: its lock."""
        self.mailbox = Mailbox()
        self._holding = Holding(self.name, manager.leases)
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
        self.environment: Environment | None = None
        """What the instance was given that is there, or is being made."""
        self._making: Environment | None = None
        self._replacement: Replacement | None = None
        self._in_halt: Loaded | None = None
        self._observed: list[Event[Any] | EventView[Any]] = []
        self._kinds: list[type] = []

    # -- what it holds --------------------------------------------------------------------------------------

    @property
    def code(self) -> PluginCode:
        """The plugin's class and functions; imported on first use (ManifestError if that fails)."""
        if self._code is None:
            self._code = import_code(self.manifest, live=self._manager.is_live)
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

    def holds(self, environment: Environment) -> bool:
        """Whether the instance that was given this is the one that is there now."""
        return self._loaded is not None and self._loaded.environment is environment

    @property
    def holder(self) -> str:
        """Who in the robot uses the plugin exclusively; nobody if empty."""
        return self._holding.inside

    @holder.setter
    def holder(self, name: str) -> None:
        self._holding.inside = name

    @property
    def held_by(self) -> str:
        """Who uses the plugin exclusively, inside or outside; nobody if empty."""
        return self._holding.by

    @property
    def is_there(self) -> bool:
        """Whether there is an instance."""
        return self._loaded is not None

    @property
    def plugin(self) -> Plugin:
        """The instance, whatever its state (PluginInactive if there is none)."""
        return self._there().plugin

    def _there(self) -> Loaded:
        if self._loaded is None:
            raise PluginInactive(self.name, f"{self.name} is {self.state}{f': {self.why}' if self.why else ''}")
        return self._loaded

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
        self._loaded = self.create(self.manifest, self.code)
        self.become(PluginState.LOADED)

    def activate(self) -> None:
        """Call the plugin's `activate`; it is callable from then on."""
        with self.turn:
            self.begin_with(self._there())

    def deactivate(self, why: str = "") -> None:
        """Call the plugin's `deactivate` and let go of all that its tag holds for it."""
        if not self.turn.acquire(LOCK_TIMEOUT_S):
            logger.error("%s: plugin %s hangs and is left behind", self._manager.robot, self.name)
            self.abandon(why or "hangs")
            return
        try:
            if self._loaded is None or self.state not in (PluginState.ACTIVE, PluginState.HALTED):
                return
            self.become(PluginState.INACTIVE, why)
            loaded = self._loaded
            try:
                loaded.plugin.deactivate()
            finally:
                self.let_go()
                loaded.end_wire()
        finally:
            self.turn.release()

    def replace(self, manifest: Manifest) -> None:
        """Take a new instance, made from the manifest and code as they are now on disk, in place of the old."""
        manager = self._manager
        replacement = Replacement(self, manifest, self._loaded, self._code, manager.check_heir, live=manager.is_live)
        self._replacement = replacement
        try:
            replacement.run()
        finally:
            if self._replacement is replacement:
                self._replacement = None

    def fault(self, error: errors.ForeignError) -> None:
        """The plugin raised, hangs or floods: it is not called any more; the manager sees to the rest in its turn."""
        if self.state in (PluginState.FAULTED, PluginState.UNLOADED):
            return
        logger.error("%s: plugin %s faulted: %s", self._manager.robot, self.name, error, exc_info=error)
        self.become(PluginState.FAULTED, f"{type(error).__name__}: {error}", error)
        self.let_go()
        self._manager.note_fault(self)

    def abandon(self, why: str) -> None:
        """Leave an instance behind that somebody is stuck in; what it does from now on has no consequence."""
        self.become(PluginState.FAULTED, why)
        self.leave_instance()

    def leave_instance(self) -> None:
        """Have no instance any more; who is stuck in it keeps the old turn."""
        self.leave_making()
        loaded, self._loaded = self._loaded, None
        self.generation += 1
        self.turn = Turn(self.name, self.manifest.tag.hang_s, self._manager.clock)
        if loaded is not None:
            loaded.environment.leave_behind()
        self.let_go()
        if loaded is not None:
            loaded.close()

    def leave_making(self) -> None:
        """Have nothing to do with an instance any more that is being made."""
        making, self._making = self._making, None
        if making is not None:
            making.leave_behind()
            making.close()

    def give_up_start(self, why: str) -> Callable[[], None] | None:
        """Its `init` or `activate` does not come back: leave it behind; of a reload the old instance runs on.

        Returns:
            What is left to do for that, and may take its time.

        """
        replacement, self._replacement = self._replacement, None
        left = replacement.give_up() if replacement is not None else None
        if left is None:
            self.abandon(why)
        return left

    def drop(self) -> None:
        """Let a faulted instance clean up after itself as well as it can, and forget it."""
        loaded = self._loaded
        if loaded is None:
            return
        if not self.turn.acquire(CLEAN_UP_TIMEOUT_S):
            self.abandon(self.why)
            return
        try:
            self.clean_up(loaded)
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
            self.become(PluginState.HALTED, "emergency halt")

    def resume(self) -> None:
        """Take calls again after a halt."""
        if self.state is PluginState.HALTED:
            if self._loaded is not None:  # a call that was under way may have begun one after the halt
                self._loaded.environment.end_actions("emergency halt")
            self.become(PluginState.ACTIVE)

    def close(self) -> None:
        """Let go of the instance and its wire."""
        loaded, self._loaded = self._loaded, None
        if loaded is not None:
            loaded.close()

    def unloaded(self) -> None:
        """The tag is of no use any more: handles on it say so."""
        self.let_go()
        self.close()
        self.become(PluginState.UNLOADED, "it was unloaded")

    def leave_out(self, why: str, error: BaseException | None = None) -> None:
        """The plugin cannot be started; it stays listed with the reason."""
        self.become(PluginState.FAULTED, why, error)
        self.let_go()

    def hold_instance(self, loaded: Loaded | None, manifest: Manifest, code: PluginCode | None) -> None:
        """Have this instance, made from this manifest and code."""
        self.manifest, self._code, self._loaded = manifest, code, loaded
        self.environment = loaded.environment if loaded is not None else None
        self.turn.set_limit(manifest.tag.hang_s)

    def begin_with(self, loaded: Loaded) -> None:
        """Call an instance's `activate`, in the plugin's turn (PluginHung if it was given up meanwhile)."""
        loaded.begin(self._manager.open_wire(self))
        loaded.plugin.activate()
        self._check_there(loaded.environment)
        self._started()

    def clean_up(self, loaded: Loaded) -> None:
        """Let an instance that has failed clean up after itself."""
        try:
            loaded.plugin.deactivate()
        except errors.FOREIGN_ERRORS as error:  # foreign plugin code, and faulted at that
            logger.debug("%s: plugin %s could not clean up: %s", self._manager.robot, self.name, error)
        finally:
            self._manager.release(self.name)  # what it used once more for that

    def create(self, manifest: Manifest, code: PluginCode, *, heir_of: Loaded | None = None) -> Loaded:
        """Make an instance and call its `init`; it takes over the observers of the one that it is the heir of."""
        parameters = check_parameters(manifest, code, self._manager.parameters_of(self.name))
        self.environment = self._making = environment = self._manager.make_environment(self)
        try:
            plugin = code.plugin_class(environment, parameters)
            loaded = Loaded(code, plugin, environment, environment.wire)
            if heir_of is not None:
                loaded.take_over(heir_of)
            plugin.init()
            self._check_there(environment)
        except BaseException:
            if not environment.has_gone:
                environment.close()
                if heir_of is not None:
                    heir_of.take_over(heir_of)
                    self.environment = heir_of.environment
            raise
        finally:
            if self._making is environment:
                self._making = None
        return loaded

    def _check_there(self, environment: Environment) -> None:
        if environment.has_gone:
            raise PluginHung(self.name, f"this instance of {self.name} was left behind")

    def _started(self) -> None:
        period_s = self.period_s
        if period_s is not None and not period_s > 0:
            raise PluginError(self.name, f"{self.name}: expected period_s > 0 or None, got {period_s}")
        self.period_ns = to_ns(period_s) if period_s is not None else 0
        self.due_ns = 0 if self.period_ns else NEVER_NS
        self.become(PluginState.ACTIVE)
        if self._manager.halted:  # looked at last: a halt that comes now sees that it is active
            self.refuse_calls()
        if self.mailbox.wake is not None:
            self.mailbox.wake()  # its thread sleeps while there is nothing to step

    def become(self, state: PluginState, why: str = "", error: BaseException | None = None) -> None:
        """Enter a state; `why` is the reason in words, `error` what the plugin's code raised, if anything."""
        self.state = state
        self.why = why
        self.raised = raised(error)

    def let_go(self) -> None:
        """It is active no more: give back all that it holds, and hear no more events."""
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
                if self.mailbox.waiting:
                    self.mailbox.deliver()
                if steps and loaded.plugin.period_s is not None:
                    loaded.plugin.step()
            except errors.FOREIGN_ERRORS as error:  # foreign plugin code
                if loaded is self._loaded:
                    self.blame(error)
        finally:
            turn.release()

    def blame(self, error: errors.ForeignError) -> None:
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
                name,
                f"{self.name} must name {name} in [tag] requires of {errors.short_path(self.manifest.path)} to use it",
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
            self.keep(caller, granted=True)
        return Handle(self, interface, caller)

    def keep(self, user: "PluginTag", *, granted: bool = False) -> None:
        """Have a plugin that runs hold this one, or go on holding it (PluginBusy if somebody else does)."""
        self._holding.keep(user, granted=granted)

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
        return self._holding.lease(by, lease_s)

    def call_external(self, function: str, payload: bytes, *, by: str = "") -> Any:
        """Call an external function, known by its name or that of one signature, with JSON arguments.

        `payload` is an array by position, an object by name, or nothing; `by` says who calls: only that one may call
        a plugin that it holds (CallError with the code that says why not).
        """
        known = self._external(function, by)
        return call_from_outside(self, known, lambda plugin: known.call(plugin, payload))

    def call_external_text(self, function: str, words: list[str], *, by: str = "") -> str:
        """Call an external function with arguments as text; the result is text as well (CallError as above)."""
        known = self._external(function, by)
        return str(call_from_outside(self, known, lambda plugin: known.call_text(plugin, words)))

    def _external(self, function: str, by: str) -> ExternalFunction:
        return external_function(self, function, lambda: self._manager.leases.holder(self.name), by)

    def observe(self, event: Event[Any] | EventView[Any], function: Callable[[Any], None]) -> None:
        """Have the plugin told of an event, through the tag's mailbox."""
        event.add(function, self.mailbox)
        self._observed.append(event)

    def answer(self, topic: Query[Any, Any], handler: Handler[Any, Any], names: dict[str, str]) -> None:
        """Answer queries for the plugin, with its lock held."""
        environment = self._making or self.environment
        if environment is not None:
            environment.wire.answer(topic, answer_in_turn(self, environment, handler), serve=Serve.AT_ONCE, **names)

    def do_tasks(self, desk: TaskDesk, kind: type, accept: Accept, let_go: LetGo) -> None:
        """Register the plugin at the desk; it is called with its lock held, and only while it is active."""
        desk.register(kind, *in_turn(self, accept, let_go))
        self._kinds.append(kind)

    def info(self) -> PluginInfo:
        """What the host tells of the plugin."""
        return plugin_info(self)
