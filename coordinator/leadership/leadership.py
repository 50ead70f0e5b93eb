"""Whether this coordinator leads, and which changes it may acknowledge."""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
from msgspec.structs import replace

from robrain.coordinator.core.core import CoordinatorPart, Core
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.mandate import Mandate
from robrain.coordinator.team.roster import Robot
from robrain.protocol.border.border import Received
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team.standing_messages import (
    COORDINATOR_COPY,
    COORDINATOR_JOURNAL,
    COORDINATOR_LEAD,
    COORDINATOR_STAND_BY,
    ENTRIES_MAX,
    PAGE_TASKS,
    CopyRequest,
    JournalChanges,
    JournalEntry,
    JournalPage,
    LeadReply,
    StandByState,
)
from robrain.protocol.messages.team.team_messages import StandByStatus, TeamState
from robrain.protocol.reasons import MinorityReached, TaskReason, sentence_of
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

logger = logging.getLogger(__name__)

BEAT_NS = to_ns(0.2)
"""Period of reports on the progress of the journal; missing entries are sent again at the same times."""
PATIENCE_NS = to_ns(1.0)
"""A change that is on the other's disk no sooner, or a silence of that length, puts it out of step (chosen)."""
PAUSE_NS = to_ns(5.0)
"""One that was silent or too slow is waited for again after this, so that it does not delay every answer (chosen)."""
GIVE_UP_NS = 2 * PATIENCE_NS
"""A change that cannot be acknowledged by then, as another coordinator may lead, is not (chosen)."""
KEPT_MAX = 4096
"""Changes kept to be sent again. One that stands by and lacks more asks for a new copy."""
PAGE_BYTES = 4_000_000
COUNTED_NS = to_ns(600.0)
"""Robots count that were received within this time (chosen). While offers are held back, those count that did
before."""
FAREWELL_NS = to_ns(0.5)
"""A robot whose token goes this soon after its last state has ended; a cut link is silent for longer before."""
REPORT_NS = to_ns(1.0)
"""Reconnected robots report their tasks within this time; a restarted coordinator receives every reachable robot."""

OnKept = Callable[[], None]
OnLost = Callable[[str], None]


class _PendingAnswer(NamedTuple):
    number: int
    """Of the change that is waited for."""
    since_ns: int
    on_kept: OnKept
    on_lost: OnLost


class JournalFeed:
    """Sends the journal's changes to the one process that stands by.

    Args:
        wire: the coordinator's Zenoh endpoint.
        journal: its journal.
        term: the first epoch of this coordinator.
        mandate: its right to lead. It continues alone only once the witnesses know that.

    """

    def __init__(self, wire: Endpoint, journal: Journal, term: int, mandate: Mandate) -> None:
        self.stand_by = ""
        """The process that is in step; empty if none is."""
        self.copy = ""
        """The journal of the process that is in step, as witnesses remember it; empty if none is."""
        self._journal, self._term, self._clock, self._mandate = journal, term, wire.clock, mandate
        self._put = wire.publisher(COORDINATOR_JOURNAL).put
        self._last = 0
        self._kept: deque[JournalEntry] = deque(maxlen=KEPT_MAX)
        self.process = ""
        """The process that stands by; empty if none does."""
        self._trouble = ""
        self._received_ns = self._put_ns = self._clock.now_ns()
        self._sent = self._on_disk = 0
        self._joins_at: int | None = None
        """The number with which the process is in step; answers wait for it already."""
        self._pause_ns = self._clock.now_ns()
        self._waiting: deque[_PendingAnswer] = deque()
        journal.on_written = self._written
        wire.answer(COORDINATOR_COPY, self._page, serve=Serve.IN_STEP)

    def status(self, held_back: MinorityReached | None = None) -> StandByStatus:
        """For the coordinator's summary, with the reason why no task is offered."""
        return StandByStatus(
            process=self.process,
            in_step=bool(self.stand_by),
            behind=self._last - self._on_disk,
            why=self._trouble,
            held_back=held_back,
        )

    def receive(self, report: StandByState, now_ns: int) -> None:
        """Read how far a candidate is; only one is waited for at a time."""
        if report.process != self.process and self.process and now_ns - self._received_ns <= PATIENCE_NS:
            return
        if report.process != self.process:
            self._leave(f"{report.process} stands by now")
            self.process, self._sent = report.process, 0
        if report.journal is not msgspec.UNSET and report.led is not msgspec.UNSET:
            self._mandate.record_copy(report.journal, report.led)
        if self.stand_by and (report.journal or "") != self.copy:
            self._leave("its journal has another name now")
        self._received_ns, self._trouble = now_ns, report.trouble
        is_of_here = report.term == self._term and report.on_disk <= self._last
        self._on_disk = report.on_disk if is_of_here else 0
        if report.trouble or not is_of_here:
            self._leave(report.trouble or "its copy is incomplete")
        elif self._joins_at is None and now_ns >= self._pause_ns:
            self._joins_at = self._last
        if not self.stand_by and self._joins_at is not None and self._on_disk >= self._joins_at:
            self.stand_by, self.copy = report.process, report.journal or ""
            logger.warning("the coordinator that stands by, %s, is in step", report.process)
        self._end_waiting()

    def when_kept(self, on_kept: OnKept, on_lost: OnLost) -> None:
        """Call `on_kept` in a step once all changes up to now are in every journal that the witnesses may elect.

        `on_lost` is called instead, with a reason, if the witnesses do not learn in time that no candidate is in step.
        Another coordinator may then lead, with a journal that lacks the changes.
        """
        self._waiting.append(_PendingAnswer(self._last, self._clock.now_ns(), on_kept, on_lost))
        self._end_waiting()

    def step(self, now_ns: int) -> None:
        """Send new entries; drop a candidate that is silent or too slow."""
        self._end_waiting()
        while self._waiting and now_ns - self._waiting[0].since_ns > GIVE_UP_NS:
            self._waiting.popleft().on_lost("this coordinator is not heard by enough witnesses, and another may lead")
        is_slow = bool(self._waiting) and now_ns - self._waiting[0].since_ns > PATIENCE_NS
        if self._joins_at is not None and (is_slow or now_ns - self._received_ns > PATIENCE_NS):
            self._pause_ns = now_ns + PAUSE_NS
            self._leave("it is too slow" if now_ns - self._received_ns <= PATIENCE_NS else "it is silent")
        is_due = not 0 <= now_ns - self._put_ns < BEAT_NS
        if is_due:
            self._sent = self._on_disk  # entries that have not arrived by now are sent again
        if is_due or self._sent < self._last:
            self._put_ns = now_ns
            entries = [entry for entry in self._kept if entry.seq > self._sent][:ENTRIES_MAX]
            self._sent = entries[-1].seq if entries else self._last
            first = self._kept[0].seq if self._kept else 1
            self._put(
                JournalChanges(
                    term=self._term,
                    first=first,
                    last=self._last,
                    entries=entries,
                    stand_by=self.stand_by,
                    lead=self._mandate.lead(now_ns),
                )
            )

    def close(self) -> None:
        """The coordinator ends; open waits are lost."""
        self._journal.on_written = None
        self._leave("the coordinator ends")
        while self._waiting:
            self._waiting.popleft().on_lost("this coordinator ends, and another may lead")

    def _leave(self, reason: str) -> None:
        if self.stand_by:
            logger.error("the coordinator that stands by, %s, is out of step (%s): changes are acknowledged without it",
                         self.stand_by, reason)  # fmt: skip
            self.stand_by = self.copy = ""
        self._joins_at = None
        self._trouble = reason
        self._end_waiting()

    def _end_waiting(self) -> None:
        while self._waiting and self._is_kept(self._waiting[0].number):
            self._waiting.popleft().on_kept()

    def _is_kept(self, number: int) -> bool:
        if self._joins_at is None:
            return self._mandate.may_acknowledge("")
        return self._on_disk >= number and self._mandate.may_acknowledge(self.copy)

    def _written(self, entry: JournalEntry) -> None:
        self._last += 1
        self._kept.append(msgspec.structs.replace(entry, seq=self._last))

    def _page(self, request: Request[CopyRequest]) -> JournalPage:
        limit = PAGE_TASKS
        while True:
            page = self._journal.page(request.asked.after, limit, self._term, self._last)
            if limit == 1 or len(msgspec.json.encode(page)) <= PAGE_BYTES:
                return page
            limit //= 2


class Leadership(CoordinatorPart):
    """Holds offers back while robots out of the coordinator's reach may be allocating the tasks among themselves.

    Robots without a coordinator allocate the queued tasks once more than half of the team receive each other and no
    coordinator. A coordinator offers no task while more than half of its robots could be doing that.

    Args:
        core: the team; its roster also has the robots of a coordinator before this one.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.held_back: MinorityReached | None = None
        """Why nothing is offered; None if it may be."""
        self._roster, self._clock = core.roster, core.wire.clock
        self._counted: frozenset[str] = frozenset()
        """Robots that count while offers are held back."""
        self._apart_ns = 0
        self._held_since_ns: int | None = None
        self._is_reported = False
        core.wire.answer(COORDINATOR_LEAD, lambda _request: LeadReply(skipped=self.force()), serve=Serve.IN_STEP)

    def robots_gone(self, robots: Sequence[Robot], now_ns: int) -> None:
        """The tokens of robots have gone; those that ended do not count, if others are still there.

        If all go at once the coordinator has lost its own connection.
        """
        if not any(robot.has_token for robot in self._roster.robots.values()):
            return
        for robot in robots:
            if robot.received_ns is not None and now_ns - robot.received_ns <= FAREWELL_NS:
                robot.left_ns = robot.received_ns

    def check(self, now_ns: int) -> None:
        """Check which robots are reachable.

        When offers are first held back, changes are revoked that most robots may not have received.
        """
        if not self._roster.some_go_on:
            return
        counted = [robot for robot in self._roster.by_name if self._counts(robot, now_ns)]
        in_contact = sum(robot.is_up(now_ns) for robot in counted)
        apart = sum(robot.continues and not robot.is_in_contact(now_ns) for robot in counted)
        if 2 * apart > len(counted):
            is_new = self.held_back is None
            self._counted, self._apart_ns = frozenset(robot.name for robot in counted), now_ns
            self.held_back = MinorityReached(in_contact, len(counted))
            self._log(self.held_back, now_ns)
            if is_new:
                self.core.lifecycle.revoke(_received_by_most(counted), self.held_back, now_ns)
        elif now_ns - self._apart_ns > REPORT_NS:
            self._end()

    def offer_refusal(self) -> TaskReason | None:
        """Why no task is offered; None if tasks may be offered."""
        return self.held_back

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add why no task is offered."""
        if self.held_back is None:
            return state
        return replace(state, stand_by=StandByStatus(process="", in_step=False, held_back=self.held_back))

    def force(self) -> list[str]:
        """The operator wants this coordinator to lead, and confirms that silent robots do no tasks.

        Returns:
            The robots that do not count until their next message.

        """
        now_ns = self._clock.now_ns()
        silent = [robot for robot in self._roster.by_name if robot.name in self._counted and not robot.is_up(now_ns)]
        for robot in silent:
            robot.left_ns = robot.last_seen_ns
        self._end()
        return [robot.name for robot in silent]

    def _counts(self, robot: Robot, now_ns: int) -> bool:
        seen_ns = robot.last_seen_ns
        if not robot.was_there or robot.has_left or seen_ns is None:
            return False
        return robot.name in self._counted or now_ns - seen_ns <= COUNTED_NS

    def _log(self, reason: MinorityReached, now_ns: int) -> None:
        if self._held_since_ns is None:
            self._held_since_ns = now_ns
        if self._is_reported or now_ns - self._held_since_ns < REPORT_NS:
            return  # at the start, robots need a moment to receive the coordinator
        self._is_reported = True
        logger.error(
            "no task is offered: %d of %d robots are in contact, and the others continue by themselves; if none of "
            "them does any task, confirm that with `robrain lead`",
            reason.received, reason.robots,
        )  # fmt: skip

    def _end(self) -> None:
        if self._is_reported:
            logger.warning("tasks are offered again")
        self.held_back, self._counted = None, frozenset()
        self._held_since_ns, self._is_reported = None, False


def _received_by_most(counted: Sequence[Robot]) -> int:
    """Number of the latest task change that at least one robot of every possible majority has received."""
    changes = sorted(robot.changes_received for robot in counted if robot.continues)
    may_miss_it = len(counted) // 2
    return changes[may_miss_it]


class ElectedLeadership(Leadership):
    """Leads while the team's witnesses confirm it, and sends its journal to a candidate.

    Args:
        core: the team.
        elected: the election that it has won.

    """

    def __init__(self, core: Core, elected: Elected) -> None:
        super().__init__(core)
        self.mandate = Mandate(core.wire, core.roster, elected)
        """The right to lead that witnesses gave."""
        self.feed = JournalFeed(core.wire, core.tasks.journal, core.term, self.mandate)
        """Sends the journal's changes to a candidate."""
        self.subscribe(COORDINATOR_STAND_BY)

    def handle(self, received: Received, now_ns: int) -> None:
        """A candidate reports how far it is."""
        self.feed.receive(received.message, now_ns)

    def decide(self, now_ns: int) -> None:
        """Follow the witnesses."""
        if self.mandate.step(self.feed.copy, now_ns):
            self.core.report_soon()
        self.end_reason = self.mandate.superseded

    def may_act(self, now_ns: int) -> bool:
        """Whether no other coordinator can have been elected, and its last offers have been reported."""
        return self.mandate.refusal(now_ns) is None

    def offer_refusal(self) -> TaskReason | None:
        """Why no task is offered; None if tasks may be offered."""
        return self.mandate.refusal(self._clock.now_ns()) or self.held_back

    def request_refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if the coordinator leads."""
        now_ns = self._clock.now_ns()
        if self.mandate.leads(now_ns):
            return ""
        return sentence_of(self.mandate.not_leading_reason(now_ns))

    def when_kept(self, on_kept: OnKept, on_lost: OnLost) -> None:
        """Call `on_kept` once all changes are in each journal from which another may lead; see JournalFeed."""
        self.feed.when_kept(on_kept, on_lost)

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the election, and the candidate that stands by."""
        state = replace(super().summary(state, now_ns), lead=self.mandate.lead(now_ns))
        return replace(state, stand_by=self.feed.status(self.held_back)) if self.feed.process else state

    def publish(self, now_ns: int) -> None:
        """Send the journal's changes."""
        self.feed.step(now_ns)

    def close(self) -> None:
        """The coordinator ends."""
        self.feed.close()

    def force(self) -> list[str]:
        """As of `Leadership`; witnesses that do not answer do not count either."""
        return sorted({*super().force(), *self.mandate.force()})
