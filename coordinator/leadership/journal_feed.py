"""The coordinator's side of a copied journal: it sends the changes to one candidate, which stands by.

A change counts as kept once the candidate has it on its disk too. If that takes longer than `PATIENCE_NS`, the
candidate is out of step: the coordinator goes on alone, once the witnesses know that, until the copy is complete again.
"""

import logging
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.mandate import Mandate
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
from robrain.protocol.reasons import MinorityHeard
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

OnKept = Callable[[], None]
OnLost = Callable[[str], None]


class _Waiting(NamedTuple):
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
        mandate: its right to lead. It goes on alone only once the witnesses know that.

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
        self._waiting: deque[_Waiting] = deque()
        journal.on_written = self._written
        wire.answer(COORDINATOR_COPY, self._page, serve=Serve.IN_STEP)

    def status(self, held_back: MinorityHeard | None = None) -> StandByStatus:
        """For the coordinator's summary, with the reason why no task is offered."""
        return StandByStatus(
            process=self.process,
            in_step=bool(self.stand_by),
            behind=self._last - self._on_disk,
            why=self._trouble,
            held_back=held_back,
        )

    def receive(self, said: StandByState, now_ns: int) -> None:
        """Read how far a candidate is; only one is waited for at a time."""
        if said.process != self.process and self.process and now_ns - self._received_ns <= PATIENCE_NS:
            return
        if said.process != self.process:
            self._leave(f"{said.process} stands by now")
            self.process, self._sent = said.process, 0
        if said.journal is not msgspec.UNSET and said.led is not msgspec.UNSET:
            self._mandate.record_copy(said.journal, said.led)
        if self.stand_by and (said.journal or "") != self.copy:
            self._leave("its journal has another name now")
        self._received_ns, self._trouble = now_ns, said.trouble
        is_of_here = said.term == self._term and said.on_disk <= self._last
        self._on_disk = said.on_disk if is_of_here else 0
        if said.trouble or not is_of_here:
            self._leave(said.trouble or "it has no whole copy")
        elif self._joins_at is None and now_ns >= self._pause_ns:
            self._joins_at = self._last
        if not self.stand_by and self._joins_at is not None and self._on_disk >= self._joins_at:
            self.stand_by, self.copy = said.process, said.journal or ""
            logger.warning("the coordinator that stands by, %s, is in step", said.process)
        self._end_waiting()

    def when_kept(self, on_kept: OnKept, on_lost: OnLost) -> None:
        """Call `on_kept` in a step once all changes so far are in every journal that the witnesses may elect.

        `on_lost` is called instead, with a reason, if the witnesses do not learn in time that no candidate is in step:
        then another coordinator may lead, with a journal that lacks the changes.
        """
        self._waiting.append(_Waiting(self._last, self._clock.now_ns(), on_kept, on_lost))
        self._end_waiting()

    def step(self, now_ns: int) -> None:
        """Send what is new; give up on one that is silent or too slow."""
        self._end_waiting()
        while self._waiting and now_ns - self._waiting[0].since_ns > GIVE_UP_NS:
            self._waiting.popleft().on_lost("this coordinator is not heard by enough witnesses, and another may lead")
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
                    lead=self._mandate.lead(now_ns),
                )
            )

    def close(self) -> None:
        """The coordinator ends; open waits are lost."""
        self._journal.on_written = None
        self._leave("the coordinator ends")
        while self._waiting:
            self._waiting.popleft().on_lost("this coordinator ends, and another may lead")

    def _leave(self, why: str) -> None:
        if self.stand_by:
            logger.error("the coordinator that stands by, %s, is out of step (%s): changes are acknowledged without it",
                         self.stand_by, why)  # fmt: skip
            self.stand_by = self.copy = ""
        self._joins_at = None
        self._trouble = why
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
