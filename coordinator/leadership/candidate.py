"""A coordinator that does not lead: it copies the journal of the one that leads, and stands for election without one.

It asks for the whole journal page by page, then follows the changes. A change with a number that does not follow is
dropped, and sent again. A coordinator with another term, or that no longer has the changes, is copied again.

While it receives no coordinator that leads, it asks the witnesses for their votes. This also applies to a journal that
is no copy: the witnesses know whether it is complete. While it asks, it follows no changes, so that no change is
acknowledged because of a copy that may already be in use.
"""

import logging
from enum import StrEnum

from msgspec import UNSET, UnsetType

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.leadership.election import Elected, Election
from robrain.protocol.answers.later import Later
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.witness_messages import Led
from robrain.protocol.messages.team.standing_messages import (
    COORDINATOR_COPY,
    COORDINATOR_JOURNAL,
    COORDINATOR_LEAD,
    COORDINATOR_STAND_BY,
    CopyRequest,
    JournalChanges,
    JournalPage,
    LeadReply,
    LeadRequest,
    StandByState,
)
from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

logger = logging.getLogger(__name__)

REPORT_NS = to_ns(0.2)
PAUSE_NS = to_ns(0.5)
"""A longer gap between two steps means that this process was stopped or its clock was set: the silence starts again."""
CANDIDACY_NS = to_ns(2.0)
"""Silence after which it asks for votes; longer than the lease that it gives (`mandate.LEASE_NS`)."""
ASK_TIMEOUT_S = 2.0


class Following(StrEnum):
    """State of the copy."""

    NOTHING = "nothing"
    """No message of a coordinator has arrived."""
    COPYING = "copying"
    BEHIND = "behind"
    """The copy is whole, and the coordinator does not wait for it: it may lack acknowledged changes."""
    IN_STEP = "in_step"
    """Nothing is acknowledged that is not in the copy."""


class Candidate:
    """Follows the journal of the coordinator that leads, or asks for votes.

    Args:
        wire: this process's Zenoh endpoint.
        journal: its own journal, which becomes the copy.
        process: names this process.
        election: asks for votes.

    """

    def __init__(self, wire: Endpoint, journal: Journal, process: str, election: Election) -> None:
        self.elected: Elected | None = None
        """The election that it has won; after that, `step` does nothing."""
        self.unlike = ""
        """Why it neither follows the coordinator that it receives nor asks for votes, as text; empty if it may."""
        self.election = election
        self._wire, self._journal, self._process = wire, journal, process
        self._stepped_ns = self._quiet_since_ns = wire.clock.now_ns()
        """Time of the last step, and start of the present silence."""
        self._inbox = Inbox(capacity=4096)
        wire.subscribe(self._inbox, COORDINATOR_JOURNAL)
        self._report = wire.publisher(COORDINATOR_STAND_BY)
        self._term = self._written = self._on_disk = self._reported = 0
        self._led_election = 0
        """Number of the last election that was received."""
        self._led: Led | UnsetType = UNSET
        self._kept_by = ""
        self._received_ns: int | None = None
        """Time of the last message of any coordinator."""
        self._has_followed = False
        self._report_ns = 0
        self._trouble = ""
        self._copying_term = 0
        self._after = self._from = 0
        self._asked: Later[JournalPage] | None = None
        self._disk_waits = self._answers_lead = False

    @property
    def following(self) -> Following:
        """State of the copy at the coordinator's last message."""
        if not self._has_followed:
            return Following.NOTHING
        if self._copying_term:
            return Following.COPYING
        return Following.IN_STEP if self._kept_by == self._process and not self._trouble else Following.BEHIND

    def step(self) -> None:
        """Read and write changes, report progress, and ask for votes if needed."""
        now_ns = self._wire.clock.now_ns()
        if self.elected is not None:
            return
        if not 0 <= now_ns - self._stepped_ns <= PAUSE_NS:
            self._quiet_since_ns = now_ns
        self._stepped_ns = now_ns
        if self._wire.has_waiting:
            self._wire.serve()
        try:
            for received in self._inbox.drain() if self._inbox.has_some else ():
                self._receive(received.message, now_ns)
            if self._copying_term:
                self._copy()
            if self._written != self._on_disk and not self._disk_waits:
                if self._trouble:
                    self._journal.follow(())  # the contents after a disk failure are unknown: it is written once more
                self._wait_for_disk()
        except JournalUnwritable as error:  # it is sent again
            self._trouble = cut(str(error))
        if self._on_disk != self._reported or not 0 <= now_ns - self._report_ns < REPORT_NS:
            self._report_ns, self._reported = now_ns, self._on_disk
            self._report.put(
                StandByState(
                    process=self._process,
                    term=self._term,
                    on_disk=self._on_disk,
                    trouble=self._trouble or self.unlike,
                    journal=self.election.journal,
                    led=self._led,
                )
            )
        self._campaign(now_ns)

    def _campaign(self, now_ns: int) -> None:
        if now_ns - self._quiet_since_ns <= CANDIDACY_NS or self._journal.copied == "partial" or self.unlike:
            self.election.rest()
            return
        if not self._answers_lead:
            self._answers_lead = True
            self._wire.answer(COORDINATOR_LEAD, self._lead, serve=Serve.IN_STEP)
        won = self.election.step(now_ns, is_copy=bool(self._journal.copied))
        if won is not None:
            self.elected = Elected(self.election.witnesses, self.election.voters, self.election.journal, won)

    def _lead(self, _request: Request[LeadRequest]) -> LeadReply:
        """The operator wants it to lead, unless it receives a coordinator: then the request is for that one."""
        now_ns = self._wire.clock.now_ns()
        has_leader = self._received_ns is not None and now_ns - self._received_ns <= CANDIDACY_NS
        return LeadReply(skipped=[] if has_leader else self.election.force())

    def _is_followed(self, changes: JournalChanges, now_ns: int) -> bool:
        """Whether to follow changes: their coordinator leads, and no vote for this one is pending."""
        lead, election = changes.lead, self.election
        self._received_ns, self.unlike = now_ns, ""
        if lead is UNSET:
            self.unlike = "the coordinator that is heard was started without witnesses"
        elif tuple(lead.witnesses) != election.witnesses:
            self.unlike = f"the coordinator that is heard has other witnesses: {', '.join(lead.witnesses)}"
        if lead is UNSET or self.unlike:
            self._quiet_since_ns = now_ns
            return False
        if lead.journal == election.journal:
            if lead.is_suspended or now_ns - self._quiet_since_ns < PAUSE_NS:
                return False  # perhaps its own, from just before its end
            # This file, or that of the other, is a copy made outside robrain.
            election.journal = self._journal.draw_name()
        election.record(lead.election)
        if lead.election < self._led_election:
            return False
        if not lead.is_suspended:
            self._led_election, self._quiet_since_ns = lead.election, now_ns
            self._led = Led(election=lead.election, stamp_ns=changes.stamp_ns)
            election.rest()
            election.withdraw_force()
        return not election.is_asking and (not lead.is_suspended or changes.term == self._term)

    def _receive(self, changes: JournalChanges, now_ns: int) -> None:
        if not self._is_followed(changes, now_ns):
            return
        if changes.lead is not UNSET and not changes.lead.is_suspended:
            self._has_followed, self._kept_by = True, changes.stand_by
            if changes.term != (self._copying_term or self._term):
                self._begin_copy(changes.term)
                return
        self._follow(changes)

    def _follow(self, changes: JournalChanges) -> None:
        if self._copying_term:
            return  # sent again once the copy is whole
        if changes.first > self._written + 1:
            self._begin_copy(changes.term)
            return
        new = [entry for entry in changes.entries if entry.seq > self._written]
        following = [entry for place, entry in enumerate(new) if entry.seq == self._written + 1 + place]
        if following:
            self._journal.follow(following)
            self._written = following[-1].seq

    def _begin_copy(self, term: int) -> None:
        self._journal.begin_copy()
        self.election.journal = self._journal.name
        while self._journal.opening_report:
            logger.warning("%s", self._journal.opening_report.pop(0))
        self._term, self._copying_term, self._trouble = 0, term, ""
        self._after, self._from, self._asked = 0, -1, None
        self._written = self._on_disk = 0

    def _copy(self) -> None:
        if self._asked is None:
            self._asked = self._wire.ask_later(
                COORDINATOR_COPY, CopyRequest(after=self._after), timeout_s=ASK_TIMEOUT_S
            )
        try:
            page = self._asked.poll()
        except (CallError, NobodyThere):
            self._asked = None
            return
        if page is None:
            return
        self._asked = None
        if page.term != self._copying_term:
            return  # of another coordinator, whose changes are received as well
        self._journal.put_page(page)
        if self._from < 0:
            self._from = page.seq  # later pages may have more; to write that again changes nothing
        if page.tasks:
            self._after = page.tasks[-1].number
            return
        self._term, self._copying_term, self._trouble = page.term, 0, ""
        self._written, self._on_disk = self._from, 0

    def _wait_for_disk(self) -> None:
        written, term = self._written, self._term
        self._disk_waits = True

        def on_disk(error: JournalUnwritable | None) -> None:
            if error is not None:
                self._trouble = cut(str(error))
            elif term == self._term:
                self._on_disk, self._trouble = written, ""
            self._disk_waits = False

        self._journal.when_on_disk(on_disk)
