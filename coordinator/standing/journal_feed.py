"""The coordinator's side of a copied journal: what is sent, what has arrived, and who waits for that.

A change counts as kept once the one that stands by has it on its disk too. If that takes longer than `PATIENCE_NS`, it
is out of step: the coordinator goes on alone and says so, until the other has everything again.
"""

import logging
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.standing.mandate import Mandate
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.team.standing_messages import (
    ENTRIES_MAX,
    PAGE_TASKS,
    CopyRequest,
    JournalChanges,
    JournalEntry,
    JournalPage,
    StandByState,
)
from robrain.protocol.messages.team.team_messages import StandByStatus
from robrain.protocol.reasons.tasks import MinorityHeard
from robrain.protocol.table.standing_topics import COORDINATOR_COPY, COORDINATOR_JOURNAL
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

logger = logging.getLogger(__name__)

BEAT_NS = to_ns(0.2)
"""How often is said how far the journal is; also when what has not arrived is sent again."""
PATIENCE_NS = to_ns(1.0)
"""A change that is on the other's disk no sooner, or a silence of that length, puts it out of step (chosen)."""
PAUSE_NS = to_ns(5.0)
"""One that was silent or too slow is waited for again after this, so that it does not delay every answer (chosen)."""
GIVE_UP_NS = 2 * PATIENCE_NS
"""A change that cannot be acknowledged by then, as another coordinator may lead, is not (chosen)."""
KEPT_MAX = 4096
"""Changes kept to be sent again. One that stands by and lacks more asks for a new copy."""
PAGE_BYTES = 4_000_000

Tell = Callable[[], None]
Fail = Callable[[str], None]


class _Waiting(NamedTuple):
    number: int
    """Of the change that is waited for."""
    since_ns: int
    tell: Tell
    fail: Fail


class JournalFeed:
    """Sends the journal's changes to the one process that stands by.

    Args:
        wire: the coordinator's Zenoh endpoint.
        journal: its journal.
        term: the first epoch of this coordinator.
        mandate: its right to lead, if the team has witnesses. It goes on alone only once they know that.

    """

    def __init__(self, wire: Endpoint, journal: Journal, term: int, mandate: Mandate | None = None) -> None:
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
        self._had_copy, self._copy_received_ns = journal.copied_by, self._clock.now_ns()
        """The process that had a whole copy last, and when it was heard to follow this coordinator."""
        self._recorded_copy = self._had_copy
        self._waiting: deque[_Waiting] = deque()
        journal.on_written = self._written
        wire.answer(COORDINATOR_COPY, self._page, serve=Serve.IN_STEP)

    def status(self, held_back: MinorityHeard | None = None) -> StandByStatus:
        """As the coordinator's summary tells it, with why it offers no task."""
        return StandByStatus(
            process=self.process,
            in_step=bool(self.stand_by),
            behind=self._last - self._on_disk,
            why=self._trouble,
            held_back=held_back,
        )

    def hear(self, said: StandByState, now_ns: int) -> None:
        """Take in how far a process that stands by is; only one is waited for at a time."""
        if said.process != self.process and self.process and now_ns - self._received_ns <= PATIENCE_NS:
            return
        if said.process != self.process:
            self._leave(f"{said.process} stands by now")
            self.process, self._sent = said.process, 0
        if self._mandate is not None and said.journal is not msgspec.UNSET and said.led is not msgspec.UNSET:
            self._mandate.record_copy(said.journal, said.led)
        if self.stand_by and (said.journal or "") != self.copy:
            self._leave("its journal has another name now")
        self._received_ns, self._trouble = now_ns, said.trouble
        is_of_here = said.term == self._term and said.on_disk <= self._last
        self._on_disk = said.on_disk if is_of_here else 0
        if is_of_here:
            self._record_copy(said.process, now_ns)
        if said.trouble or not is_of_here:
            self._leave(said.trouble or "it has no whole copy")
        elif self._joins_at is None and now_ns >= self._pause_ns:
            self._joins_at = self._last
        if not self.stand_by and self._joins_at is not None and self._on_disk >= self._joins_at:
            self.stand_by, self.copy = said.process, said.journal or ""
            logger.warning("the coordinator that stands by, %s, is in step", said.process)
        self._publish_kept()

    def silent_copy(self, now_ns: int, silence_ns: int) -> str:
        """The process that has a copy of the journal and has not been heard to follow it for so long; empty if none."""
        return self._had_copy if now_ns - self._copy_received_ns > silence_ns else ""

    def when_kept(self, tell: Tell, fail: Fail) -> None:
        """Call `tell` in a step once all changes so far are on the other's disk; at once if none is in step.

        With witnesses, `fail` is called instead, with a reason, if they do not learn in time that none is in step: then
        another coordinator may lead, with a journal that lacks the changes.
        """
        self._waiting.append(_Waiting(self._last, self._clock.now_ns(), tell, fail))
        self._publish_kept()

    def step(self, now_ns: int) -> None:
        """Send what is new; give up on one that is silent or too slow."""
        self._publish_kept()
        while self._waiting and now_ns - self._waiting[0].since_ns > GIVE_UP_NS:
            self._waiting.popleft().fail("this coordinator is not heard by enough witnesses, and another may lead")
        is_slow = bool(self._waiting) and now_ns - self._waiting[0].since_ns > PATIENCE_NS
        if self._joins_at is not None and (is_slow or now_ns - self._received_ns > PATIENCE_NS):
            self._pause_ns = now_ns + PAUSE_NS
            self._leave("it is too slow" if now_ns - self._received_ns <= PATIENCE_NS else "it is silent")
        is_due = not 0 <= now_ns - self._put_ns < BEAT_NS
        if is_due:
            self._sent = self._on_disk  # what has not arrived by now is sent again
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
                    lead=msgspec.UNSET if self._mandate is None else self._mandate.lead(now_ns),
                )
            )

    def close(self) -> None:
        """The coordinator ends; who waits still is told that nothing more is waited for."""
        self._journal.on_written = None
        self._leave("the coordinator ends")
        while self._waiting:
            self._waiting.popleft().fail("this coordinator ends, and another may lead")

    def _leave(self, why: str) -> None:
        if self.stand_by:
            logger.error("the coordinator that stands by, %s, is out of step (%s): changes are acknowledged without it",
                         self.stand_by, why)  # fmt: skip
            self.stand_by = self.copy = ""
        self._joins_at = None
        self._trouble = why
        self._publish_kept()

    def _publish_kept(self) -> None:
        """Tell those who wait for changes that are kept wherever they have to be."""
        while self._waiting and self._is_kept(self._waiting[0].number):
            self._waiting.popleft().tell()

    def _is_kept(self, number: int) -> bool:
        is_on_disk = self._joins_at is not None and self._on_disk >= number
        if self._mandate is None:
            return self._joins_at is None or is_on_disk
        if self._joins_at is None:
            return self._mandate.may_acknowledge("")
        return is_on_disk and self._mandate.may_acknowledge(self.copy)

    def _record_copy(self, process: str, now_ns: int) -> None:
        self._had_copy, self._copy_received_ns = process, now_ns
        if process != self._recorded_copy:
            try:
                self._journal.record_copied_by(process)  # a coordinator that starts again must know as well
                self._recorded_copy = process
            except JournalUnwritable:
                logger.debug("that %s has a copy is written down once the journal can be written", process)

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
