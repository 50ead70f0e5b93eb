"""The host of one robot: its place on the wire, its plugins, its desk for tasks, its emergency halt.

`step()` is called by the owner of time: the lockstep runner once a tick, the live process about as often.
"""

import logging
import threading
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from heapq import heappop, heappush
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import msgspec
import zenoh

from robrain.agent.board import HALTED, IDLE, Board
from robrain.agent.environment import Environment, PluginRequests
from robrain.agent.errors import PluginMissing, RobotFileError
from robrain.agent.host.command_door import TextCommandDoor
from robrain.agent.host.host_extension import HOST_EXTENSIONS, HostExtension, MakeExtension
from robrain.agent.host.host_verbs import AT_ONCE, answer_verb
from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.host.robot_file import RobotFile, folder_of
from robrain.agent.host.robot_halts import RobotHalts
from robrain.agent.host.robot_log import RobotLog
from robrain.agent.isolation.foreign_plugins import ForeignPlugins
from robrain.agent.lifecycle.managed_plugin import NEVER_NS, ManagedPlugin
from robrain.agent.lifecycle.plugin_folders import entry_point_places
from robrain.agent.lifecycle.registry import PluginRegistry, plugin_faults, plugin_info
from robrain.agent.lifecycle.worker_pool import WorkerPool
from robrain.agent.manifest import COMMAND
from robrain.agent.plugin import PluginState
from robrain.agent.robot_tasks import RobotTasks
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import Clock, clock_difference_ns, to_ns
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.thinning import Thinning
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_LOG_KEPT, ROBOT_PLUGINS, PluginInfo
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, PluginFault, RobotState
from robrain.protocol.messages.tasks.offer_messages import (
    ROBOT_COSTS,
    ROBOT_OFFER,
    ROBOT_WITHDRAW,
    CostsRequest,
    TaskAnswer,
    TaskCost,
    TaskOffer,
    TaskWithdrawal,
)
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.ranges import cut
from robrain.protocol.reasons import ProcessPaused, RobotHalted
from robrain.protocol.refusals import Refusals, most_refused
from robrain.protocol.table.topics import HOST_VERB
from robrain.protocol.wire.endpoint import Drive, Endpoint, OnOutside, Request, Serve

logger = logging.getLogger(__name__)

T = TypeVar("T")

STATE_PERIOD_NS = to_ns(1 / 10)
PAUSED_NS = to_ns(0.5)
"""After this time between two steps the process was paused. It is many times the usual period, and a coordinator's time
limit for the answer to an offer."""
WAKING_NS = to_ns(0.2)
"""For this time after the pause, messages count as received right after the last step before it, and offers are
refused. Messages that waited in the process arrive in the first step, those that waited in the network soon after
it."""
WOKEN_PASSES = 2
"""For a task that follows another at once: the first pass notifies its behavior, the second the driver."""
IDLE_S = 1.0
"""A thread that has started plugins ends when there has been nothing to start for this long."""
START_POOL_TIMEOUT_S = 1.0
"""How long the end waits for plugins that are being started."""


class LockstepSchedule:
    """Runs the steps of one robot's plugins, one pass a tick.

    In a pass each plugin gets its notifications, then its step if that is due. A notification for a later plugin is
    delivered in the same pass, for an earlier plugin in the next.

    Args:
        has_one_thread: whether plugins' turns need not be waited for.

    """

    def __init__(self, *, has_one_thread: bool) -> None:
        self._has_one_thread = has_one_thread
        self._plugins: list[ManagedPlugin] = []
        self._known: dict[str, ManagedPlugin] = {}
        self._wanted = bytearray()
        """For each plugin, 1 if the next pass must visit it: set by its mailbox and when its step is due."""
        self._due: list[tuple[int, int]] = []
        """A heap of due times and plugins; an entry may be void, as a plugin's `due_ns` counts."""
        self._queued: list[int] = []
        """The due time of each plugin's last entry in the heap; `NEVER_NS` if there is none."""

    def step(self, plugins: dict[str, ManagedPlugin], now_ns: int) -> None:
        """One pass over `plugins`, which are in start order."""
        if plugins is not self._known:
            self._rebuild(plugins)
        wanted, due, queued = self._wanted, self._due, self._queued
        while due and due[0][0] <= now_ns:
            _, index = heappop(due)
            wanted[index] = 1
            queued[index] = NEVER_NS
        index = wanted.find(1)
        while index >= 0:
            wanted[index] = 0
            plugin = self._plugins[index]
            run = plugin.run_in_turn if self._has_one_thread else plugin.run
            if plugin.holdings.mailbox.waiting:
                run(steps=False)
            mailbox = plugin.holdings.mailbox  # another one if the plugin has faulted
            if mailbox.is_hurried:
                mailbox.is_hurried = False
                if plugin.period_ns:
                    plugin.due_ns = min(plugin.due_ns, now_ns - plugin.period_ns)
            if now_ns >= plugin.due_ns:
                plugin.due_ns += plugin.period_ns
                if plugin.due_ns <= now_ns:  # missed steps are not caught up
                    plugin.due_ns = now_ns + plugin.period_ns
                run(steps=True)
            if plugin.due_ns != queued[index]:
                queued[index] = plugin.due_ns
                heappush(due, (plugin.due_ns, index))
            index = wanted.find(1, index + 1)

    def _rebuild(self, plugins: dict[str, ManagedPlugin]) -> None:
        for plugin in self._plugins:
            plugin.holdings.ring_at(None, 0)
        self._known, self._plugins = plugins, list(plugins.values())
        self._wanted = bytearray(b"\1" * len(self._plugins))
        self._due = []
        self._queued = [NEVER_NS] * len(self._plugins)
        for index, plugin in enumerate(self._plugins):
            plugin.holdings.ring_at(self._wanted, index)


class AgentHost:
    """Runs the plugins of one robot.

    Args:
        robot_file: the robot's ROBOT.toml.
        base: folder that the file's places are relative to.
        session: shared in lockstep, the process's own in live.
        clock: the run's clock.
        drive: source of time.
        seed: of the run; each plugin draws from its own generator, made from seed, robot and plugin.
        on_outside: called with queries from other processes, in lockstep.
        has_one_thread: in lockstep, that no other thread ever calls a plugin, so that none is locked.
        distributions: `entry_point_places()`, where several robots share a process; None searches for them.
        manifests: files found by the robots of a run that were set up before, by folder; None searches again.
        extensions: host extensions that replace those of the same name.

    """

    def __init__(
        self,
        robot_file: RobotFile,
        base: Path,
        session: zenoh.Session,
        clock: Clock,
        drive: Drive,
        *,
        seed: int = 0,
        on_outside: OnOutside | None = None,
        has_one_thread: bool = False,
        distributions: list[tuple[Path, str]] | None = None,
        manifests: dict[Path, list[Path]] | None = None,
        extensions: Mapping[str, MakeExtension] = MappingProxyType({}),
    ) -> None:
        self.name = robot_file.robot.name
        self.robot_file = robot_file
        self.drive = drive
        self.clock = clock
        self.board = Board()
        self.desk = RobotTasks(self._names)
        self._schedule = LockstepSchedule(has_one_thread=has_one_thread) if drive is Drive.LOCKSTEP else None
        self._seed = seed
        self._on_outside = on_outside
        self._session = session
        self._wires: list[Endpoint] = []
        self.refusals = Refusals(clock)
        """Messages that its wires have refused, and failures of parts of the host."""
        self._guard = RecordGuard(self.refusals)
        bytes_per_s = robot_file.zenoh.telemetry_bytes_per_s
        self.thinning = None if not bytes_per_s else Thinning(bytes_per_s, clock)
        """Drops telemetry on a thin link; None if the robot's file sets no limit."""
        self.wire = self._open_wire()
        live = drive is Drive.LIVE
        self._registry = PluginRegistry(
            robot=self.name,
            clock=clock,
            make_environment=self._make_environment,
            parameters=robot_file.parameters,
            has_one_thread=has_one_thread,
            starters=WorkerPool(f"start-{self.name}", START_POOL_TIMEOUT_S, idle_s=IDLE_S) if live else None,
            foreign=ForeignPlugins(self.wire, self.name, lambda: self._registry.halted) if live else None,
        )
        self.manager = PluginManager(self._registry, self._guard)
        self._inbox = Inbox()
        self._state = self.wire.publisher(ROBOT_STATE, robot=self.name)
        self._state_due_ns = 0
        self._stepped_ns = self.clock.now_ns()
        self._slept_ns, self._awake_ns = 0, 0
        """When its process was last paused, and the time from which no message that waited for it arrives any more."""
        self._halts = 0
        self.log = RobotLog(self.wire, self.name)
        self._faults: dict[str, PluginFault] = {}
        self._down: set[str] = set()
        self._publishing = threading.Lock()
        self._published = RobotState(robot=self.name)
        self._published_facts = self.desk.facts
        self.halting = RobotHalts(self.manager, self.wire, self.log, self._publish_halt)
        self.door = TextCommandDoor(self._registry)
        self._manifests = manifests
        self._distributions = entry_point_places() if distributions is None else distributions
        self._came_with: dict[Path, str] = {}
        """The distribution of each manifest that was asked for; empty for those of robrain and of the robot."""
        own = [folder_of(base, place) for place in robot_file.robot.places]
        self.loadable = [folder_of(base, folder) for folder in robot_file.robot.loadable]
        self._places = [stock_place(), *(place for place, _ in self._distributions), *own]
        self.extensions: dict[str, HostExtension] = {}
        """Host extensions by name."""
        self.extensions = {name: extensions.get(name, make)(self) for name, make in HOST_EXTENSIONS.entries().items()}
        self._steps = [
            (name, extension.step)
            for name, extension in self.extensions.items()
            if type(extension).step is not HostExtension.step
        ]

    def open_folder(self, folder: Path) -> None:
        """Allow loading plugins by path from a folder, as if it were listed in the robot's `loadable`."""
        self.loadable = [*self.loadable, folder]

    def follows(self, summary: TeamState) -> bool:
        """Whether a summary is of a coordinator that leads, by the knowledge of all extensions."""
        return all(extension.follows(summary) for extension in self.extensions.values())

    def on_wanted(self, wake: Callable[[], None]) -> None:
        """Have `wake` called, on any thread, whenever the next `step()` should not wait: in live, by its own loop."""
        self.wire.on_waiting = wake
        self.desk.on_line = wake

    def start(self) -> None:
        """Find, load and start the plugins, then announce the robot.

        Raises:
            ManifestError, PluginMissing, RobotFileError: the robot's plugins differ from its file.

        """
        table = self.robot_file.robot
        found = self.manager.discover(self._places, table.load, self._manifests, table.roles)
        for name in self.robot_file.parameters:
            if name not in found:
                known = ", ".join(found)
                raise RobotFileError(f"{self.name}: [parameters.{name}]: no plugin of that name; there are: {known}")
        self.halting.listen()  # before anything of the robot's can move
        self.manager.start()
        self.halting.started()
        wire, robot = self.wire, self.name
        wire.subscribe(self._inbox, COORDINATOR_STATE)
        wire.answer(ROBOT_PLUGINS, self._reply_plugins, serve=Serve.SHARED, at_once=("plugins",), robot=robot)
        wire.answer(ROBOT_LOG_KEPT, self.log.kept, serve=Serve.SHARED, robot=robot)
        wire.answer(ROBOT_CALL, self._call, serve=Serve.POOL, robot=robot)
        wire.answer(HOST_VERB, partial(answer_verb, self, wire), serve=Serve.SHARED, at_once=AT_ONCE, robot=robot)
        wire.answer(ROBOT_OFFER, self._offer, serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_COSTS, self._costs, serve=Serve.IN_STEP, robot=robot)
        wire.answer(ROBOT_WITHDRAW, self._withdraw, serve=Serve.IN_STEP, robot=robot)
        for extension in self.extensions.values():
            extension.start()
        wire.token(ROBOT_ALIVE, robot=robot)

    def step(self) -> None:
        """Do the host's own work, and in lockstep the steps of all plugins that are due."""
        now_ns = self.clock.now_ns()
        halting = self.halting
        if halting.arrivals.has_some or halting.summaries.has_some:
            halting.receive()
        if now_ns - self._stepped_ns > PAUSED_NS:
            self._slept_ns, self._awake_ns = self._stepped_ns, now_ns + WAKING_NS
            for extension in self.extensions.values():
                extension.restart_silence(now_ns)
        if self._inbox.has_some:
            # A process that was stopped finds summaries of any age: they may have come right after its last step.
            received_ns = self._slept_ns if now_ns < self._awake_ns else now_ns
            for received in self._inbox.drain():
                self.desk.coordinator_ahead_ns = clock_difference_ns(received.message.stamp_ns, now_ns)
                counts = [each.receive_summary(received.message, now_ns) for each in self.extensions.values()]
                if all(counts):
                    self.desk.renew_lease(received.message, self.name, received_ns)
        self._stepped_ns = now_ns
        for wire in self._wires:
            if wire.has_waiting:
                wire.serve()
        halts, self._halts = self._halts, self._registry.halts
        if self._registry.halted or halts != self._halts:  # a halt that is over already has stopped the plugins as well
            self.desk.halted()
        if self._registry.halted:
            self.board.behavior = HALTED
        elif self.board.behavior == HALTED:  # its earlier actions are over
            self.board.behavior = IDLE
        for name, step in self._steps:
            self._guard.stage(name, None, step, now_ns, may_begin=not self._registry.halted)
        self.desk.check_lease(now_ns)
        if self._registry.foreign is not None and self._registry.foreign.follow():
            self._registry.newly_running = True
        if self._registry.new_faults or now_ns >= self.manager.faults.check_ns:
            self._guard.stage("faults", None, self.manager.settle, now_ns)
        if self._schedule is not None:
            self._schedule.step(self._registry.plugins, now_ns)
        if self.desk.held is not None and self.desk.go_on(now_ns) and self._schedule is not None:
            for _ in range(WOKEN_PASSES):
                self._schedule.step(self._registry.plugins, now_ns)
        if now_ns >= self._state_due_ns:
            self._state_due_ns = max(self._state_due_ns + STATE_PERIOD_NS, now_ns)
            self._publish_state()
        elif self.desk.differs_from(self._published_facts):  # the next task must not wait for the period
            self._publish_state()

    def task_id(self) -> str:
        """Id of the task that the robot is at, else of the one that it begins next; empty if none."""
        status, held = self.desk.status, self.desk.held
        return status.id if status is not None and not status.state.ended else held.offer.task.id if held else ""

    def close(self) -> None:
        """Stop the plugins and leave the wire."""
        self.halting.close()
        self.manager.stop()
        if self._registry.starters is not None:
            self._registry.starters.close()
        self.wire.close()

    def _publish_state(self) -> None:
        board = self.board
        self._report_faults()
        self._published_facts = self.desk.facts
        situation = self.desk.situation(self.clock.now_ns())
        with self._publishing:
            state = RobotState(
                robot=self.name,
                pose=board.pose,
                pose_covariance=board.pose_covariance,
                velocity=board.velocity,
                radius_m=board.radius_m,
                battery=board.battery,
                energy=board.energy,
                behavior=board.behavior,
                waits_for=board.waits_for,
                waits_at=board.waits_at or msgspec.UNSET,
                reservations=msgspec.UNSET if board.reservations is None else board.reservations,
                task=situation.task,
                next_task=situation.next_task,
                task_before=situation.before,
                lost=cut(board.lost),
                frame=board.frame,
                map_agreement=board.map_agreement,
                loaded=self._loaded(),
                refused=most_refused(self.refusals) if self.refusals.total else msgspec.UNSET,
                skipped=(self.thinning.total if self.thinning is not None else 0) or msgspec.UNSET,
                faulted=list(self._faults.values()),
            )
            for extension in self.extensions.values():
                state = extension.extend_state(state)
            self._published = state
            self._state.put(self.halting.mark(state))

    def _loaded(self) -> int:
        names = [*self._registry.plugins, *(self._registry.foreign or ())]
        return zlib.crc32(" ".join(names).encode(), 1)

    def _report_faults(self) -> None:
        plugins, before, were_down = self._registry.plugins, self._faults, self._down
        down = [plugin for plugin in plugins.values() if plugin.lacks or plugin.state is PluginState.FAULTED]
        if not (down or before):
            return
        self._down = {plugin.name for plugin in down}
        self._faults = {fault.plugin: fault for fault in plugin_faults(self._registry)}
        for name, fault in self._faults.items():
            if name not in before:
                text = f"does not run: {fault.why}"
                detail = plugins[name].raised.detail
                self.log.put(name, "error", f"{text}\n{detail}" if detail else text)
        for plugin in down:
            if plugin.manifest.tag.essential and plugin.name not in were_down:
                self.halting.halt(
                    plugin.name, f"{plugin.name} does not run: {cut(plugin.raised.after(plugin.state_reason))}"
                )
        for name in [name for name in before if name not in self._faults]:
            self.log.put(name, "warning", "runs again, or has gone")

    def _publish_halt(self) -> None:
        """At once, on the thread that halted or resumed the robot; the rest is as it was sent last."""
        with self._publishing:
            self._state.put(self.halting.mark(self._published))

    def _reply_plugins(self, _request: Request[None]) -> list[PluginInfo]:
        return [*map(self.info, self._registry.plugins.values()), *self._registry.foreign_infos()]

    def _names(self) -> set[str]:
        return {self.name, *self._registry.plugins, *(info.name for info in self._registry.foreign_infos())}

    def info(self, plugin: ManagedPlugin) -> PluginInfo:
        """A plugin as the host reports it."""
        distribution = self._distribution_of(plugin.manifest.path)
        return msgspec.structs.replace(plugin_info(plugin, self._registry), distribution=distribution)

    def _distribution_of(self, manifest: Path) -> str:
        known = self._came_with.get(manifest)
        if known is None:  # to resolve thirty paths takes longer than all the rest of the answer
            path = manifest.resolve()
            known = next((name for place, name in self._distributions if path.is_relative_to(place)), "")
            self._came_with[manifest] = known
        return known

    def _call(self, request: Request[bytes]) -> Any:
        name, function = request.names["plugin"], request.names["function"]
        foreign = self._registry.foreign
        if foreign is not None and self._registry.is_foreign(name):
            return foreign.relay(name, function, request.asked)
        try:
            plugin = self.manager.get(name)
        except PluginMissing as error:
            raise CallError(ErrorCode.UNKNOWN_PLUGIN, str(error)) from error
        return plugin.call_external(function, request.asked, by=request.by)

    def _offer(self, request: Request[TaskOffer]) -> TaskAnswer:
        if self._registry.halted:
            return TaskAnswer.refused(RobotHalted())
        now_ns = self.clock.now_ns()
        if now_ns < self._awake_ns or now_ns - self._stepped_ns > PAUSED_NS:
            # The coordinator may have given the offer up, or have ended.
            return TaskAnswer.refused(ProcessPaused())
        for extension in self.extensions.values():
            if reason := extension.offer_refusal(request.asked.task.id, now_ns):
                return TaskAnswer.refused(reason)
        return self.desk.offer(request.asked, now_ns)

    def _costs(self, request: Request[CostsRequest]) -> list[TaskCost]:
        return [self.desk.cost(task) for task in request.asked.tasks]

    def _withdraw(self, request: Request[TaskWithdrawal]) -> TaskAnswer:
        now_ns = self.clock.now_ns()
        for extension in self.extensions.values():
            if reason := extension.withdrawal_refusal(now_ns):
                return TaskAnswer.refused(reason)
        return self.desk.withdraw(request.asked)

    def _open_wire(self) -> Endpoint:
        wire = Endpoint(
            self._session,
            self.robot_file.robot.team,
            self.clock,
            self.drive,
            on_outside=self._on_outside,
            refusals=self.refusals,
            party=self.name,
            thinning=self.thinning,
        )
        # A new list: the host's own thread may be going through the old one. Closed endpoints are released.
        self._wires = [*(each for each in self._wires if not each.is_closed), wire]
        return wire

    def _make_environment(self, plugin: PluginRequests) -> Environment:
        return Environment(
            plugin,
            self.name,
            self._open_wire(),
            (self._seed, zlib.crc32(self.name.encode()), zlib.crc32(plugin.name.encode())),
            self.board,
            self.desk,
            halt=self.halting.halt,
            guard=self.halting.guard,
            outside=self.door if plugin.name == COMMAND else None,
            connect=list(self.robot_file.zenoh.connect),
        )


def stock_place() -> Path:
    """The folder of the plugins that come with robrain."""
    return Path(str(resources.files("robrain.plugins")))
