"""Whether this coordinator leads, and which changes it may acknowledge."""

from collections.abc import Callable, Sequence

from msgspec import UNSET, UnsetType

from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.journal_feed import JournalFeed, OnKept, OnLost
from robrain.coordinator.leadership.mandate import Mandate
from robrain.coordinator.leadership.offer_fence import OfferFence
from robrain.coordinator.tasks.task_book import TaskBook
from robrain.coordinator.team.roster import Robot, Roster
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.witness_messages import Lead
from robrain.protocol.messages.team.standing_messages import LeadReply, LeadRequest
from robrain.protocol.messages.team.team_messages import StandByStatus
from robrain.protocol.reasons import MinorityHeard, PlainReason, TaskReason, told
from robrain.protocol.table.standing_topics import COORDINATOR_LEAD, COORDINATOR_STAND_BY
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve


class Leadership:
    """Leads alone, or for as long as the team's witnesses want that.

    Args:
        wire: the coordinator's Zenoh endpoint.
        book: its tasks.
        roster: the robots of the team.
        term: the first epoch of this coordinator.
        elected: the election that it has won; None if it is alone.
        take_back: requeues tasks; see `TaskLifecycle.take_back`.

    """

    def __init__(
        self,
        wire: Endpoint,
        book: TaskBook,
        roster: Roster,
        term: int,
        elected: Elected | None,
        take_back: Callable[[int, TaskReason, int], None],
    ) -> None:
        self.fence = OfferFence(roster)
        self.mandate: Mandate | None = None
        """The right to lead that witnesses gave; None if the coordinator is alone."""
        self.feed: JournalFeed | None = None
        """Sends the journal's changes to a candidate; None if the coordinator is alone."""
        self._clock, self._take_back = wire.clock, take_back
        self._inbox, self._guard = Inbox(), RecordGuard(wire.refusals)
        if elected is not None:
            self.mandate = Mandate(wire, roster, elected)
            self.feed = JournalFeed(wire, book.journal, term, self.mandate)
            wire.subscribe(self._inbox, COORDINATOR_STAND_BY)
        wire.answer(COORDINATOR_LEAD, self._force, serve=Serve.IN_STEP)

    def leads(self, now_ns: int) -> bool:
        """Whether no other coordinator can have been elected."""
        return self.mandate is None or self.mandate.leads(now_ns)

    def step(self, now_ns: int) -> bool:
        """Follow the witnesses and the candidate; returns whether the summary must be sent at once."""
        if self.mandate is None or self.feed is None:
            return False
        if self._inbox.has_some:
            feed = self.feed
            self._guard.messages(self._inbox.drain(), lambda received: feed.receive(received.message, now_ns))
        return self.mandate.step(self.feed.copy, now_ns)

    def check_robots(self, now_ns: int) -> None:
        """Hold offers back if most robots may be allocating tasks among themselves."""
        was_fenced = self.fence.reason is not None
        self.fence.step(now_ns)
        reason = self.fence.reason
        if reason is not None and not was_fenced:
            self._take_back(self.fence.received_by_most(now_ns), reason, now_ns)

    def record_gone(self, gone: Sequence[Robot], now_ns: int) -> None:
        """The tokens of robots have gone."""
        self.fence.record_gone(gone, now_ns)

    def offer_refusal(self) -> MinorityHeard | PlainReason | None:
        """Why no task is offered; None if tasks may be offered."""
        refusal = None if self.mandate is None else self.mandate.refusal(self._clock.now_ns())
        return refusal or self.fence.reason

    def refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if the coordinator leads."""
        now_ns = self._clock.now_ns()
        if self.mandate is None or self.mandate.leads(now_ns):
            return ""
        return told(self.mandate.not_leading_reason(now_ns))

    def when_kept(self, on_kept: OnKept, on_lost: OnLost) -> None:
        """Call `on_kept` once all changes so far are in each journal from which another may lead; see JournalFeed."""
        if self.feed is None:
            on_kept()
        else:
            self.feed.when_kept(on_kept, on_lost)

    def publish(self, now_ns: int) -> None:
        """Send the journal's changes."""
        if self.feed is not None:
            self.feed.step(now_ns)

    def close(self) -> None:
        """The coordinator ends."""
        if self.feed is not None:
            self.feed.close()

    def lead(self, now_ns: int) -> Lead | UnsetType:
        """The election, for the summary."""
        return UNSET if self.mandate is None else self.mandate.lead(now_ns)

    def stand_by(self) -> StandByStatus | UnsetType:
        """The candidate that stands by, for the summary, with the reason why no task is offered."""
        reason = self.fence.reason
        if self.feed is not None and self.feed.process:
            return self.feed.status(reason)
        return UNSET if reason is None else StandByStatus(process="", in_step=False, held_back=reason)

    def _force(self, _request: Request[LeadRequest]) -> LeadReply:
        now_ns = self._clock.now_ns()
        witnesses = [] if self.mandate is None else self.mandate.force()
        return LeadReply(left_out=sorted({*self.fence.force(now_ns), *witnesses}))
