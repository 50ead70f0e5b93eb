"""Emergency halts as the coordinator follows them: the holders, and the robots that have not stopped.

The coordinator stops no robot: robots receive the halt directly. It sends the halt to robots that come late, or were
cut off.
"""

from typing import Any

from robrain.coordinator.team.roster import Roster
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import COORDINATOR_HALT, HALT, HaltStatus
from robrain.protocol.model.tasks.halt_latch import HaltLatch
from robrain.protocol.wire.endpoint import Endpoint, Request

REMIND_NS = to_ns(0.1)
"""Between two summaries for a robot that has not received a halt. With two of three messages lost, nine of ten such
robots have received it after 0.6 s (by calculation). At the summaries' own period that takes 3 s."""


class TeamHalts:
    """Follows the team's halts.

    Args:
        wire: the coordinator's place on the wire.
        roster: the robots that there are.

    """

    def __init__(self, wire: Endpoint, roster: Roster) -> None:
        self._clock = wire.clock
        self._roster = roster
        self._latch = HaltLatch()
        self._has_halted = False
        self._arrivals = Inbox()
        self._guard = RecordGuard(wire.refusals)
        self._known_stopped: list[str] = []
        self._reported_ns = 0
        wire.subscribe(self._arrivals, HALT)
        wire.answer(COORDINATOR_HALT, self._answer)

    @property
    def is_halted(self) -> bool:
        """Whether the team is to stand."""
        return self._latch.is_held

    def receive(self) -> bool:
        """Process new messages; True if a summary is due: there is a change, or a robot has not received the halt."""
        received_halts = self._arrivals.drain() if self._arrivals.has_some else []
        if not received_halts and not self.is_halted:
            return False
        self._guard.messages(received_halts, self._handle)
        now_ns = self._clock.now_ns()
        stopped, self._known_stopped = self._known_stopped, self._stopped(now_ns)
        is_due = bool(received_halts) or (
            self.is_halted and (stopped != self._known_stopped or self._needs_reminder(now_ns))
        )
        if is_due:
            self._reported_ns = now_ns
        return is_due

    def _needs_reminder(self, now_ns: int) -> bool:
        """Whether a robot that is present does not report that it is halted: summaries to it may be lost."""
        if 0 <= now_ns - self._reported_ns < REMIND_NS:
            return False
        return any(robot.state is not None and not robot.state.halted for robot in self._roster.up(now_ns))

    def _handle(self, received: Received) -> None:
        halt = received.message
        if halt.halted:
            self._has_halted = True
            self._latch.hold(halt.by, halt.reason, halt.stamp_ns)
        else:
            self._latch.release(halt.by, halt.stamp_ns)

    def record_state(self, state: RobotState) -> None:
        """Record a halt that a robot obeys and that this coordinator missed, because it was down or disconnected."""
        if state.team_halt_ns > self._latch.stamp_ns:
            self._has_halted = True
            for holder in state.halted_by:
                self._latch.hold(holder, f"reported by {state.robot}", state.team_halt_ns)

    def status(self, now_ns: int) -> HaltStatus | None:
        """State of the team's halts; None until the first halt."""
        latch = self._latch
        if not self._has_halted:
            return None
        stopped = self._stopped(now_ns)
        return HaltStatus(
            halted=latch.is_held,
            by=latch.holders or [latch.opened_by],
            reason=latch.reason,
            since_ns=latch.since_ns,
            stamp_ns=latch.stamp_ns,
            stopped=stopped,
            not_stopped=sorted(self._roster.robots.keys() - set(stopped)),
        )

    def _stopped(self, now_ns: int) -> list[str]:
        robots = self._roster.up(now_ns)
        return [robot.name for robot in robots if robot.state is not None and robot.state.has_stopped]

    def _answer(self, request: Request[Any]) -> HaltStatus | None:
        return self.status(self._clock.now_ns())
