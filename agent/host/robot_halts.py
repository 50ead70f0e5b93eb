"""A robot's emergency halt: it receives halts, stops the plugins, reports it at once, and resumes only when it may.

Halts come with the topic `halt`, from an operator's query, or, for a robot that was not there in time, from the
coordinator's summary. A direct halt always counts; the summary only if it is newer than all direct ones, and it never
resumes a robot.
"""

import logging
import threading
from collections.abc import Callable

import msgspec

from robrain.agent.errors import FOREIGN_ERRORS
from robrain.agent.host.plugin_manager import PluginManager
from robrain.agent.host.robot_log import RobotLog
from robrain.agent.lifecycle.managed_plugin import ManagedPlugin
from robrain.agent.lifecycle.worker_pool import WorkerPool
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HaltAnswer
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import (
    COORDINATOR_HALT,
    COORDINATOR_STATE,
    HALT,
    HaltStatus,
    TeamState,
)
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.protocol.wire.endpoint import Drive, Endpoint

logger = logging.getLogger(__name__)

LIMIT_S = 0.1
"""How long the plugins of one level may take to halt before the next level's turn comes."""
THREADS = 4
"""Maximum number of threads that stand by to halt plugins of a level in parallel; more are started when these are
stuck."""
ASK_TIMEOUT_S = 1.0
LOG_SOURCE = "halt"


class RobotHalts:
    """Halts and resumes one robot. May be called on any thread; needs no plugin's lock.

    Args:
        manager: of the robot's plugins.
        wire: the host's endpoint.
        log: the robot's.
        publish_state: publishes the robot's state at once.

    """

    def __init__(
        self, manager: PluginManager, wire: Endpoint, log: RobotLog, publish_state: Callable[[], None]
    ) -> None:
        live = wire.drive is Drive.LIVE
        self.arrivals, self.summaries = Inbox(), Inbox()
        """Halts, and the coordinator's summaries: `receive` has something to do if one of them has some."""
        if live:
            # At once, on the thread of the subscription: to hand over to another one would cost several ms in a process
            # that is kept busy, as that thread must first be given a processor, and then Python's own lock.
            self.arrivals.on_arrival = self.receive
            self.arrivals.acts_at_once = True
        self._manager = manager
        self._robot = manager.robot
        self._wire = wire
        self._guard = RecordGuard(wire.refusals)
        self._publish_state = publish_state
        self._log = log
        self._latch = HaltLatch()
        self._team_halt_ns = 0
        self._not_halted: list[str] = []
        self._guards: dict[str, Callable[[], str]] = {}
        """By plugin: the reason why a halt must not end yet."""
        self._is_started = self._is_closed = False
        self._stopping = False
        """The plugins are being stopped."""
        self._acting = threading.RLock()
        self._pool = WorkerPool(f"halt-{self._robot}", LIMIT_S) if live else None

    def listen(self) -> None:
        """Receive halts from now on; one that is in force by a query to the coordinator, if there is one."""
        self._wire.subscribe(self.arrivals, HALT)
        self._wire.subscribe(self.summaries, COORDINATOR_STATE)
        try:
            status = self._wire.ask(COORDINATOR_HALT, timeout_s=ASK_TIMEOUT_S)
        except (CallError, NobodyThere) as error:
            logger.debug("%s: the coordinator does not say whether the team is halted: %s", self._robot, error)
        else:
            self._record_team(status)

    def started(self) -> None:
        """The plugins have been started, and nothing has called them yet: handle the halts that arrived meanwhile."""
        self.stand_by()
        with self._acting:
            self._is_started = True
            self.receive()
            if self._latch.is_held and not self._manager.halted:
                self._halt_plugins()

    def stand_by(self) -> None:
        """Have a thread for each plugin of a level that stops something by itself; called when plugins have come."""
        if self._pool is not None:
            self._pool.stand_by(min(THREADS, self._manager.most_to_halt()))

    def receive(self) -> None:
        """Halt or resume by the team's orders, in the order of arrival.

        The host's step does this. In live a halt itself does not wait for it, only the coordinator's summary does.
        """
        if not self.arrivals.has_some and not self.summaries.has_some:
            return
        with self._acting:
            if self._is_closed:
                return
            self._guard.messages(self.arrivals.drain(), self._handle)
            self._guard.messages(self.summaries.drain(), self._handle)

    def _handle(self, received: Received) -> None:
        message = received.message
        if isinstance(message, TeamState):
            self._record_team(message.halt)
        elif message.halted:
            self._team_halt_ns = message.stamp_ns
            self._halt([message.by], message.reason, message.stamp_ns)
        else:
            self._resume(message.by, message.stamp_ns)

    def halt(self, by: str, reason: str) -> HaltAnswer:
        """Halt this robot alone."""
        with self._acting:
            self._halt([by], reason)
            return self._answer()

    def resume(self, by: str) -> HaltAnswer:
        """End this robot's halt.

        Raises:
            CallError: another name holds it; the robot stays halted.

        """
        with self._acting:
            reason = self._resume(by)
            if reason:
                raise CallError(ErrorCode.REFUSED, f"{self._robot} stays halted: {reason}")
            return self._answer()

    def guard(self, plugin: str, reason: Callable[[], str]) -> None:
        """Have a plugin asked before a halt ends, while there is a plugin of that name."""
        with self._acting:
            self._guards[plugin] = reason

    def mark(self, state: RobotState) -> RobotState:
        """The robot's state with its halts; it is halted when its plugins have been ordered to stop."""
        halted = self._manager.registry.halted and not self._stopping
        if not halted:
            return state
        return msgspec.structs.replace(
            state,
            halted=True,
            halted_by=self._latch.holders,
            team_halt_ns=self._team_halt_ns,
            not_halted=self._not_halted,
        )

    def close(self) -> None:
        """Receive no more, and end the threads."""
        with self._acting:
            self._is_closed = True
        if self._pool is not None:
            self._pool.close()

    def _record_team(self, status: HaltStatus | None) -> None:
        if status is None or not status.halted or status.stamp_ns <= self._latch.stamp_ns:
            return
        self._team_halt_ns = status.stamp_ns
        self._halt(status.by, status.reason, status.stamp_ns)

    def _halt(self, by: list[str], reason: str, stamp_ns: int = 0) -> None:
        for each in by or [""]:
            self._latch.hold(each, reason, stamp_ns)
        if self._is_started:  # else `started` does it
            self._halt_plugins()
        names = ", ".join(by) or "nobody named"
        self._log_text(f"halted by {names}{f': {reason}' if reason else ''}")
        if self._not_halted:
            self._log_text(f"not stopped in time: {', '.join(self._not_halted)}", "error")

    def _halt_plugins(self) -> None:
        self._stopping = True
        try:
            self._not_halted = self._manager.halt(self._pool)
        finally:
            self._stopping = False
        self._publish_state()

    def _resume(self, by: str, stamp_ns: int = 0) -> str:
        reason = self._halt_guard_reason() or self._latch.release(by, stamp_ns)
        if reason:
            self._log_text(f"{by or 'nobody named'} tried to resume it, and it stays halted: {reason}")
            return reason
        if self._manager.halted:
            self._team_halt_ns = 0
            self._not_halted = []
            self._manager.resume()
            self._publish_state()
            self._log_text(f"resumed by {by or 'nobody named'}")
        return ""

    def _halt_guard_reason(self) -> str:
        """Why the halt may not end yet; the plugin that gives the reason holds the halt from now on."""
        if not self._latch.is_held:
            return ""
        for name, plugin in self._manager.plugins.items():
            reason = self._halt_guard_reason_of(plugin)
            if reason:
                if name not in self._latch.holders:
                    self._latch.hold(name, reason)
                    self._publish_state()
                return reason
        return ""

    def _halt_guard_reason_of(self, plugin: ManagedPlugin) -> str:
        tag, guard = plugin.manifest.tag, self._guards.get(plugin.name)
        # One that has faulted is started again after the halt, and its guard knows whether it can be.
        if tag.essential and not plugin.state.is_running and (guard is None or tag.restart == "no"):
            return f"{plugin.name} does not run: {plugin.state_reason or plugin.state}"
        if guard is None:
            return ""
        try:
            return guard()
        except FOREIGN_ERRORS as error:  # foreign plugin code
            return f"{plugin.name} does not say whether the robot may drive: {type(error).__name__}: {error}"

    def _answer(self) -> HaltAnswer:
        return HaltAnswer(
            robot=self._robot, halted=self._manager.halted, by=self._latch.holders, not_halted=self._not_halted
        )

    def _log_text(self, text: str, level: str = "warning") -> None:
        self._log.put(LOG_SOURCE, level, text)
        logger.log(logging.getLevelName(level.upper()), "%s: %s", self._robot, text)
