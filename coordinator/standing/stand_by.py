"""A coordinator that stands by: it keeps a copy of the journal of the one that coordinates, over the wire.

It asks for the whole journal page by page, then follows the changes. A change with a number that does not follow is
left, and sent again; a coordinator with another term, or that no longer has the changes, is copied again.

If the team has witnesses, it asks them for their votes while it hears no coordinator that leads. This also applies to a
journal that is no copy: the witnesses know whether it is complete. While it asks, it follows no changes, so that no
change is acknowledged because of a copy that may already be in use.
"""

import logging
from enum import StrEnum

from msgspec import UNSET, UnsetType

from robrain.coordinator.journal.errors import JournalUnwritable
from robrain.coordinator.journal.journal import Journal
from robrain.coordinator.standing.candidate import Candidate, Elected
from robrain.protocol.answers.later import Later
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.witness_messages import Led
from robrain.protocol.messages.team.standing_messages import CopyRequest, JournalChanges, JournalPage, StandByState
from robrain.protocol.model.ranges import cut
from robrain.protocol.table.standing_topics import COORDINATOR_COPY, COORDINATOR_JOURNAL, COORDINATOR_STAND_BY
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

TELL_NS = to_ns(0.2)
SILENT_NS = to_ns(1.5)
"""A coordinator that is silent for longer is gone, as for robots."""
PAUSE_NS = to_ns(0.5)
"""A longer gap between two steps means that this process was stopped or its clock was set: the silence starts again."""
STAND_NS = to_ns(2.0)
"""Silence after which it asks for votes; longer than the lease that it gives (`mandate.LEASE_NS`)."""
ASK_TIMEOUT_S = 2.0


class Following(StrEnum):
    """How a copy stands."""

    NOTHING = "nothing"
    """No coordinator has been heard."""
    COPYING = "copying"
    BEHIND = "behind"
    """The copy is whole, and the coordinator does not wait for it: it may lack what was acknowledged."""
    IN_STEP = "in_step"
    """Nothing is acknowledged that is not in the copy."""
    ALONE = "alone"
    """It was in step when the coordinator was heard last."""


class StandBy:
    """Follows a coordinator's journal.

    Args:
        wire: this process's Zenoh endpoint.
        journal: its own journal, which becomes the copy.
        process: names this process.
        candidate: asks for votes; None if the team has no witnesses.

    """

    def __init__(self, wire: Endpoint, journal: Journal, process: str, candidate: Candidate | None = None) -> None:
        self.elected: Elected | None = None
        """The election that it has won; after that, `step` does nothing."""
        self._wire, self._journal, self._process, self._candidate = wire, journal, process, candidate
        self._stepped_ns = self._quiet_since_ns = wire.clock.now_ns()
        """Time of the last step, and start of the present silence."""
        self.unlike = ""
        """Why it neither follows the coordinator that it hears nor asks for votes, in words; empty if it may."""
        self._inbox = Inbox(capacity=4096)
        wire.subscribe(self._inbox, COORDINATOR_JOURNAL)
        self._tell = wire.publisher(COORDINATOR_STAND_BY)
        self._term = self._written = self._on_disk = self._told = 0
        self._name = "" if candidate is None else journal.name
        """Name of the journal; empty without witnesses."""
        self._election = 0
        """Number of the last election that was heard of."""
        self._led: Led | UnsetType = UNSET
        self._is_kept_by = ""
        self._received_ns: int | None = None
        self._publish_ns = 0
        self._trouble = ""
        self._copying_term = 0
        self._after = self._from = 0
        self._asked: Later[JournalPage] | None = None
        self._disk_waits = False

    def following(self, now_ns: int) -> Following:
        """How the copy stands."""
        if self._received_ns is None:
            return Following.NOTHING
        if self._copying_term:
            return Following.COPYING
        is_in_step = self._is_kept_by == self._process and not self._trouble
        if now_ns - self._received_ns > SILENT_NS and is_in_step:
            return Following.ALONE
        return Following.IN_STEP if is_in_step else Following.BEHIND

    def is_silent(self, now_ns: int) -> bool:
        """Whether a coordinator was heard, and is not any more."""
        return self._received_ns is not None and now_ns - self._received_ns > SILENT_NS

    def step(self) -> None:
        """Hear and write what has changed, report progress, and ask for votes if needed."""
        now_ns = self._wire.clock.now_ns()
        if self.elected is not None:
            return
        if not 0 <= now_ns - self._stepped_ns <= PAUSE_NS:
            self._quiet_since_ns = now_ns
        self._stepped_ns = now_ns
        try:
            for received in self._inbox.drain() if self._inbox.has_some else ():
                self._receive(received.message, now_ns)
            if self._copying_term:
                self._copy()
            if self._written != self._on_disk and not self._disk_waits:
                if self._trouble:
                    self._journal.follow(())  # what a failed disk has kept is not known: it is written once more
                self._wait_for_disk()
        except JournalUnwritable as error:  # it is sent again
            self._trouble = cut(str(error))
        if self._on_disk != self._told or not 0 <= now_ns - self._publish_ns < TELL_NS:
            self._publish_ns, self._told = now_ns, self._on_disk
            self._tell.put(
                StandByState(
                    process=self._process,
                    term=self._term,
                    on_disk=self._on_disk,
                    trouble=self._trouble or self.unlike,
                    journal=self._name or UNSET,
                    led=self._led,
                )
            )
        if self._candidate is not None:
            self._run_for_election(self._candidate, now_ns)

    def _run_for_election(self, candidate: Candidate, now_ns: int) -> None:
        if now_ns - self._quiet_since_ns <= STAND_NS or self._journal.copied == "partial" or self.unlike:
            candidate.rest()
            return
        candidate.journal = self._name
        won = candidate.step(now_ns, is_copy=bool(self._journal.copied))
        if won is not None:
            self.elected = Elected(candidate.witnesses, self._name, won)

    def _is_heard(self, candidate: Candidate, changes: JournalChanges, now_ns: int) -> bool:
        """Whether to follow changes: their coordinator leads, and no vote for this one is pending."""
        lead = changes.lead
        self.unlike = ""
        if lead is UNSET:
            self.unlike = "the coordinator that is heard was started without witnesses"
        elif tuple(lead.witnesses) != candidate.witnesses:
            self.unlike = f"the coordinator that is heard has other witnesses: {', '.join(lead.witnesses)}"
        if lead is UNSET or self.unlike:
            self._quiet_since_ns = now_ns
            return False
        if lead.journal == self._name:
            if lead.is_suspended or now_ns - self._quiet_since_ns < PAUSE_NS:
                return False  # perhaps its own, from just before its end
            self._name = self._journal.draw_name()  # this file, or that of the other, is a copy that somebody has made
        candidate.note(lead.election)
        if lead.election < self._election:
            return False
        if not lead.is_suspended:
            self._election, self._quiet_since_ns = lead.election, now_ns
            self._led = Led(election=lead.election, stamp_ns=changes.stamp_ns)
            candidate.rest()
            candidate.is_forced = False  # the operator's word was for a team without a coordinator
        return not candidate.is_asking and (not lead.is_suspended or changes.term == self._term)

    def _receive(self, changes: JournalChanges, now_ns: int) -> None:
        if self._candidate is not None and not self._is_heard(self._candidate, changes, now_ns):
            return
        if changes.lead is not UNSET and changes.lead.is_suspended:
            self._follow(changes)
            return
        if self._candidate is None and changes.term < max(self._term, self._copying_term):
            return  # of a coordinator that was replaced
        self._received_ns, self._is_kept_by = now_ns, changes.stand_by
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
        self._name = self._journal.name if self._name else ""
        while self._journal.told:
            logger.warning("%s", self._journal.told.pop(0))
        self._term, self._copying_term, self._trouble = 0, term, ""
        self._after, self._from, self._asked = 0, -1, None
        self._written = self._on_disk = 0

    def _copy(self) -> None:
        if self._asked is None:
            self._asked = self._wire.ask_later(
                COORDINATOR_COPY, CopyRequest(after=self._after), timeout_s=ASK_TIMEOUT_S
            )
        try:
            page = self._asked.take()
        except (CallError, NobodyThere):
            self._asked = None
            return
        if page is None:
            return
        self._asked = None
        if page.term != self._copying_term:
            return  # of another coordinator; its changes are heard as well
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

        def told(error: JournalUnwritable | None) -> None:
            if error is not None:
                self._trouble = cut(str(error))
            elif term == self._term:
                self._on_disk, self._trouble = written, ""
            self._disk_waits = False

        self._journal.when_on_disk(told)
