"""One plugin of a robot, under its name, from its discovery until it is unloaded: figure 2 of the paper calls it a tag.

It holds the plugin's manifest, its state and its instance. A restart or a reload makes a new instance; handles stay.
"""

import logging
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeVar, cast

from robrain.agent.environment import Environment
from robrain.agent.errors import (
    FOREIGN_ERRORS,
    AccessDenied,
    ForeignError,
    PackageMissing,
    PluginError,
    PluginHung,
    PluginInactive,
    PluginUnloaded,
    short_path,
)
from robrain.agent.event import Event, Mailbox, ObservableEvent
from robrain.agent.lifecycle.access import (
    AccessiblePlugin,
    ExclusiveUse,
    Handle,
    call_from_outside,
    check_outside,
    check_use,
    query_handler,
    task_handlers,
)
from robrain.agent.lifecycle.instance import Holdings, Instance, RobotContext
from robrain.agent.lifecycle.plugin_code import PluginCode, check_parameters, import_code
from robrain.agent.lifecycle.transitions import Effect, Trigger, transition
from robrain.agent.lifecycle.turn import LockstepTurn, PluginLock
from robrain.agent.manifest import Manifest
from robrain.agent.plugin import Level, Plugin, PluginState
from robrain.agent.plugin_traceback import end_thread, raised, traceback_in
from robrain.agent.robot_tasks import Accept, LetGo, RobotTasks, TaskWork
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.host_messages import Lease
from robrain.protocol.topic import Query
from robrain.protocol.wire.endpoint import Handler, Serve

logger = logging.getLogger(__name__)

InterfaceT = TypeVar("InterfaceT")

NEVER_NS = 1 << 63
WAITS_S = {Effect.ASK: 2.0, Effect.ASK_FAILED: 0.1}
"""Time for which the end of a plugin waits for callers in it; then the plugin is abandoned."""


class ManagedPlugin:
    """Manages one plugin: its lifecycle, its step, and access to it.

    Args:
        manifest: the plugin's manifest.
        context: the robot.

    """

    def __init__(self, manifest: Manifest, context: RobotContext) -> None:
        self.manifest = manifest
        self.name = manifest.name
        self.state = PluginState.DISCOVERED
        self.state_reason = ""
        """The reason of the state, in words."""
        self.needs = ""
        """The extra that it needs and that is not installed."""
        self.lacks = ""
        """The plugin that it requires and for lack of which it does not run; empty if it is not for that."""
        self.raised = raised(None)
        """Where the plugin's code raised the error that has led to the state."""
        self._context = context
        self.turn = self._new_turn()
        """The plugin's lock; another one after an instance was abandoned with a stuck caller."""
        self.exclusive = ExclusiveUse(self.name, context.clock)
        """The plugin's exclusive use, if it is not shared."""
        self.overruns = self.restarts = 0
        self.again_ns: int | None = None
        """When a plugin that has faulted is started again; None if it is not."""
        self.attempts = 0
        """Restarts since it last ran steadily or was loaded by hand."""
        self.started_ns = 0
        """When it was last started again after its last fault; 0 if it was not."""
        self.drops_seen = 0
        """Notifications that its observers had lost at the last check for a flood."""
        self.period_ns = 0
        """How often the plugin wants its step; 0 if it is passive."""
        self.due_ns = NEVER_NS
        """When its next step is due, in lockstep."""
        self.environment: Environment | None = None
        """The environment of the instance, the present one or the one that is being made."""
        self.holdings = Holdings()
        self.imported_code: PluginCode | None = None
        """The plugin's class and functions; None if its class has not been imported, or cannot be."""
        self.instance: Instance | None = None
        self.callable: Plugin | None = None
        """The plugin itself while it may be called; see `live_plugin`."""
        self._making: Environment | None = None
        self._in_halt: Instance | None = None
        self._stuck: int | None = None
        """The thread that was in the instance which was abandoned last."""
        self._deciding = threading.Lock()
        """Held while a state is checked and changed; no other lock is acquired meanwhile."""

    @property
    def code(self) -> PluginCode:
        """The plugin's class and functions; imported on first use (ManifestError if that fails)."""
        if self.imported_code is None:
            self.imported_code = import_code(self.manifest, live=self._context.is_live)
        return self.imported_code

    @property
    def plugin_class(self) -> type[Plugin]:
        """The plugin's class (ManifestError if it cannot be imported)."""
        return self.code.plugin_class

    @property
    def level(self) -> Level:
        """The plugin's level; the highest if its class could not be imported."""
        return self.imported_code.plugin_class.level if self.imported_code is not None else max(Level)

    @property
    def period_s(self) -> float | None:
        """How often the plugin wants its step; None if it is passive or not active."""
        plugin = self.callable  # it may go meanwhile
        return plugin.period_s if plugin is not None else None

    @property
    def halts_itself(self) -> bool:
        """Whether code of the plugin's own runs in an emergency halt, which may hang."""
        instance = self.instance
        if instance is None:
            return False
        own = getattr(instance.plugin.emergency_halt, "__func__", None)
        return own is not Plugin.emergency_halt or instance.environment.ends_actions

    @property
    def caller(self) -> str:
        """See Environment.caller."""
        return self.turn.caller

    @property
    def mailbox(self) -> Mailbox:
        """Where notifications wait for the plugin."""
        return self.holdings.mailbox

    @property
    def plugin(self) -> Plugin:
        """The plugin itself, in any state (PluginInactive if there is none)."""
        return self._there().plugin

    def live_plugin(self) -> Plugin:
        """The plugin itself, if it may be called now.

        Raises:
            PluginUnloaded: it has gone.
            PluginInactive: it is there, but not active.

        """
        if self.state is PluginState.ACTIVE and self.instance is not None:
            return self.instance.plugin
        raise self._inactive(PluginUnloaded if self.state is PluginState.UNLOADED else PluginInactive)

    def holds(self, environment: Environment) -> bool:
        """Whether the instance that was given this is the one that is there now."""
        return self.instance is not None and self.instance.environment is environment

    def events(self) -> dict[str, Event[Any]]:
        """The events of the instance, by name; none if there is no instance."""
        instance = self.instance
        return instance.events() if instance is not None and instance.code.events else {}

    @property
    def settings(self) -> dict[str, Any]:
        """Its manifest's parameters, overridden by the robot's file."""
        return {**self.manifest.parameters, **self._context.parameters_of(self.name)}

    def apply(self, trigger: Trigger, reason: str = "", error: BaseException | None = None, *, lacks: str = "") -> None:
        """Change the state by the table of transitions, and run its actions; the only way to do either.

        Args:
            trigger: trigger of the transition.
            reason: the reason in words; the state keeps its reason if this is empty and the state stays.
            error: error of the plugin's code, if any.
            lacks: the plugin that it requires and that does not run, if this is the reason.

        Raises:
            TransitionRefused: that cannot happen in its state.
            Exception: error of the plugin's `deactivate`; all other actions have run.

        """
        steps = transition(self.name, self.state, trigger).steps
        wait_s = next((WAITS_S[step] for step in steps if step in WAITS_S), None)
        if wait_s is None or self.instance is None:
            self._follow(trigger, reason, error, lacks)
            return
        turn = self.turn
        if turn.acquire(wait_s):
            try:
                self._follow(trigger, reason, error, lacks)
            finally:
                turn.release()
            return
        logger.error("%s: plugin %s hangs and is abandoned", self._context.robot, self.name)
        self.apply(Trigger.ABANDON, reason or self.state_reason or "hangs", lacks=lacks)
        self.apply(trigger, reason, error, lacks=lacks)

    def _follow(self, trigger: Trigger, reason: str, error: BaseException | None, lacks: str) -> None:
        needs = error.needed if isinstance(error, PackageMissing) else ""
        where = raised(None if needs else error)
        with self._deciding:
            to, steps = transition(self.name, self.state, trigger)
            if to is not self.state or (steps and reason):
                self.state, self.state_reason, self.raised, self.lacks, self.needs = to, reason, where, lacks, needs
            self._update_callable()
        if trigger in (Trigger.ACTIVATED, Trigger.RESUME):
            self._context.newly_running = True
            self.holdings.mailbox.ring()  # its runner sleeps while there is nothing to step
        instance, failure = self.instance, None
        for step in steps:
            match step:
                case Effect.ASK if instance is not None:
                    try:
                        instance.plugin.deactivate()
                    except BaseException as raised_error:  # noqa: BLE001 - raised again when all is done
                        failure = raised_error
                case Effect.ASK_FAILED if instance is not None:
                    self._ask_failed(instance)
                case Effect.LEAVE:
                    self._leave()
                case Effect.RELEASE:
                    self._release()
                case Effect.END_ACTIONS if instance is not None:
                    instance.environment.end_actions("emergency halt")
                case Effect.END_WIRE if instance is not None:
                    instance.end_wire()
                case Effect.DISCARD if instance is not None:
                    self.instance = self.callable = None
                    instance.close()
                case Effect.REPORT:
                    logger.error("%s: plugin %s faulted: %s", self._context.robot, self.name, error, exc_info=error)
                    self._context.record_fault(self)
        if failure is not None:
            raise failure

    def _ask_failed(self, instance: Instance) -> None:
        try:
            instance.plugin.deactivate()
        except FOREIGN_ERRORS as error:  # foreign plugin code, and faulted at that
            logger.debug("%s: plugin %s could not clean up: %s", self._context.robot, self.name, error)
        finally:
            self._context.release(self.name)  # once more the resources that it used for that

    def stuck_at(self) -> TracebackType | None:
        """Where a thread is in the plugin, also in an instance that was abandoned; None if none is."""
        thread = self.turn.owner or self._stuck
        return traceback_in(thread, self.plugin_class) if thread and self.imported_code is not None else None

    def _leave(self) -> None:
        self._stuck = self.turn.owner
        if self._stuck is not None and self._stuck != threading.get_ident() and self.stuck_at() is not None:
            end_thread(self._stuck)
        self.leave_new()
        instance, self.instance, self.callable = self.instance, None, None
        self.turn = self._new_turn()
        if instance is not None:
            instance.environment.abandon()

    def _release(self) -> None:
        if self.instance is not None:
            self.instance.environment.end(self.state_reason or f"{self.name} is {self.state}")
        self.holdings.release()
        self._context.release(self.name)
        self.exclusive.end_lease(self.exclusive.outside)

    def load(self) -> None:
        """Create the plugin with its checked parameters and environment, and call its `init`."""
        self.instance = self.create(self.manifest, self.code)
        self._update_callable()
        self.apply(Trigger.INITIALISED)

    def create(self, manifest: Manifest, code: PluginCode, *, replaces: Instance | None = None) -> Instance:
        """Make an instance and call its `init`; it takes over the observers of the one that it replaces."""
        parameters = check_parameters(manifest, code, self._context.parameters_of(self.name))
        self.environment = self._making = environment = self._context.make_environment(self)
        try:
            plugin = code.plugin_class(environment, parameters)
            instance = Instance(code, plugin, environment, environment.wire)
            if replaces is not None:
                instance.take_over(replaces)
            plugin.init()
            self._check_there(environment)
        except BaseException:
            if not environment.has_gone:
                environment.close()
                if replaces is not None:
                    replaces.take_over(replaces)
                    self.environment = replaces.environment
            raise
        finally:
            if self._making is environment:
                self._making = None
        return instance

    def leave_new(self) -> None:
        """Close an instance that is being made, and leave it to the thread that is stuck in its `init`."""
        making, self._making = self._making, None
        if making is not None:
            making.abandon()
            making.close()

    def swap(self, instance: Instance | None, manifest: Manifest, code: PluginCode | None) -> None:
        """Have this instance, made from this manifest and code."""
        self.manifest, self.imported_code, self.instance = manifest, code, instance
        self.environment = instance.environment if instance is not None else None
        self.turn.set_limit(manifest.tag.hang_s)
        self._update_callable()

    def activate(self) -> None:
        """Call the plugin's `activate`; it is callable from then on (PluginHung if it was abandoned meanwhile)."""
        with self.turn:
            instance = self._there()
            instance.begin(self._context.make_environment(self).wire)
            instance.plugin.activate()
            self._check_there(instance.environment)
            period_s = instance.plugin.period_s
            if period_s is not None and not period_s > 0:
                raise PluginError(self.name, f"{self.name}: expected period_s > 0 or None, got {period_s}")
            self.period_ns = to_ns(period_s) if period_s is not None else 0
            self.due_ns = 0 if self.period_ns else NEVER_NS
            self.apply(Trigger.ACTIVATED)
            if self._context.halted:  # checked last: a halt that comes now finds it active
                self.refuse_calls()

    def fault(self, error: ForeignError) -> None:
        """The plugin raised, hangs or floods: it is not called any more; the host does the rest in its step."""
        self.apply(Trigger.FAIL, f"{type(error).__name__}: {error}", error)

    def refuse_calls(self) -> None:
        """The first half of a halt."""
        self.apply(Trigger.HALT, "emergency halt")

    def halt(self) -> None:
        """Refuse calls, then call `emergency_halt` without the lock; PluginHung if it still hangs in an earlier one."""
        self.refuse_calls()
        instance = self.instance
        if instance is None:
            return
        if self._in_halt is instance:
            raise PluginHung(self.name, f"{self.name} has not come back from an earlier emergency_halt")
        self._in_halt = instance
        try:
            instance.plugin.emergency_halt()
        finally:
            self._in_halt = None
            instance.environment.end_actions("emergency halt")

    def unload(self) -> None:
        """End the plugin for good: handles on it report that (an error of its `deactivate` is raised afterwards)."""
        try:
            self.apply(Trigger.UNLOAD, "it is being unloaded")
        finally:
            self.state_reason = "it was unloaded"

    def _update_callable(self) -> None:
        instance = self.instance if self.state is PluginState.ACTIVE else None
        self.callable = instance.plugin if instance is not None else None

    def _new_turn(self) -> PluginLock:
        kind = LockstepTurn if self._context.has_one_thread else PluginLock
        return kind(self.name, self.manifest.tag.hang_s, self._context.clock)

    def _there(self) -> Instance:
        if self.instance is None:
            raise self._inactive(PluginInactive)
        return self.instance

    def _inactive(self, kind: type[PluginInactive]) -> PluginInactive:
        return kind(self.name, f"{self.name} is {self.state}{f': {self.state_reason}' if self.state_reason else ''}")

    def _check_there(self, environment: Environment) -> None:
        if environment.has_gone:
            raise PluginHung(self.name, f"this instance of {self.name} was abandoned")

    def run(self, *, steps: bool) -> None:
        """As `run_in_turn`, after waiting for the plugin's turn; not while a caller is stuck in it."""
        turn = self.turn
        if turn.acquire(turn.limit_s):
            try:
                self.run_in_turn(steps=steps)
            finally:
                turn.release()

    def run_in_turn(self, *, steps: bool) -> None:
        """Deliver its notifications, and if it `steps` run its own step, for a runner that has the plugin's turn."""
        instance, turn = self.instance, self.turn
        if self.state is not PluginState.ACTIVE or instance is None:
            return
        turn.depth += 1
        try:
            if self.holdings.mailbox.waiting:
                self.holdings.mailbox.deliver()
            if steps and instance.plugin.period_s is not None:
                instance.plugin.step()
        except FOREIGN_ERRORS as error:  # foreign plugin code
            if instance is self.instance:
                self.blame(error)
        finally:
            turn.depth -= 1

    def blame(self, error: ForeignError) -> None:
        """An error of the plugin is its fault, unless it comes from a halt or end of a plugin that it calls."""
        if not self._context.excuses(self, error):
            self.fault(error)

    def use(self, name: str, interface: type[InterfaceT]) -> InterfaceT:
        """A handle on another plugin for this one; the other decides."""
        if name not in self.manifest.tag.requires:
            where = short_path(self.manifest.path)
            raise AccessDenied(name, f"{self.name} must name {name} in [tag] requires of {where} to use it")
        return cast(InterfaceT, self._context.request(self, name, interface))

    def observe(self, event: Event[Any] | ObservableEvent[Any], function: Callable[[Any], None]) -> None:
        """Notify the plugin of an event, through its mailbox."""
        self.holdings.observe(event, function)

    def hurry(self) -> None:
        """Have its next step run at once."""
        mailbox = self.holdings.mailbox
        mailbox.is_hurried = True
        mailbox.ring()

    def answer(self, topic: Query[Any, Any], handler: Handler[Any, Any], names: dict[str, str]) -> None:
        """Answer queries for the plugin, with its lock held."""
        environment = self._making or self.environment
        if environment is not None:
            environment.wire.answer(topic, query_handler(self, environment, handler), serve=Serve.AT_ONCE, **names)

    def do_tasks(self, desk: RobotTasks, accept: Accept, let_go: LetGo, work: TaskWork) -> None:
        """Register the plugin at the desk; it is called with its lock held, and only while it is active."""
        task_kind = self.imported_code.task_kind if self.imported_code is not None else None
        if task_kind is None:
            raise PluginError(self.name, f"{self.name} cannot take tasks: its class declares no `kind`")
        self.holdings.do_tasks(desk, task_kind.kind, *task_handlers(self, accept, let_go, work))

    def grant(self, caller: AccessiblePlugin, interface: type) -> Handle:
        """A handle on this plugin for a caller.

        Raises:
            AccessDenied: the level, the visibility or the interface speaks against it.
            PluginBusy: another holder has it.

        """
        check_use(self, caller, interface)
        if not self.manifest.tag.shared:
            self.exclusive.keep(caller, granted=True)
        return Handle(self, interface, caller, locks=not self._context.has_one_thread)

    def hold(self, by: str, lease_s: float) -> Lease:
        """Lease the plugin to a client alone for a time, or longer if the client has it.

        Raises:
            PluginBusy: another holder has it.
            PluginError: it cannot be held, or not now.
            BadName: the holder's name cannot be one.

        """
        check_outside(self)
        if self.manifest.tag.shared:
            raise PluginError(self.name, f"{self.name} is shared: nobody can hold it")
        self.live_plugin()
        return self.exclusive.lease(by, lease_s)

    def call_external(self, function: str, payload: bytes, *, by: str = "") -> Any:
        """Call an external function, known by its name or that of one signature, with JSON arguments.

        `payload` is an array by position, an object by name, or nothing. `by` names the caller: only the holder may
        call a plugin that is held (CallError with the code of the reason).
        """
        return call_from_outside(self, function, by, lambda known, plugin: known.call(plugin, payload))

    def call_external_text(self, function: str, words: list[str], *, by: str = "") -> str:
        """Call an external function with arguments as text; the result is text as well (CallError as above)."""
        return str(call_from_outside(self, function, by, lambda known, plugin: known.call_text(plugin, words)))
