"""Whether this coordinator leads, and which changes it may acknowledge."""

from collections.abc import Sequence

from msgspec.structs import replace

from robrain.coordinator.core.core import Core
from robrain.coordinator.core.part import CoordinatorPart
from robrain.coordinator.leadership.election import Elected
from robrain.coordinator.leadership.journal_feed import JournalFeed, OnKept, OnLost
from robrain.coordinator.leadership.mandate import Mandate
from robrain.coordinator.leadership.offer_fence import OfferFence
from robrain.coordinator.team.roster import Robot
from robrain.protocol.border.border import Received
from robrain.protocol.messages.team.standing_messages import LeadReply, LeadRequest
from robrain.protocol.messages.team.team_messages import StandByStatus, TeamState
from robrain.protocol.reasons import TaskReason, told
from robrain.protocol.table.standing_topics import COORDINATOR_LEAD, COORDINATOR_STAND_BY
from robrain.protocol.wire.endpoint import Request, Serve


class Leadership(CoordinatorPart):
    """Holds offers back while robots out of reach may be allocating tasks among themselves.

    Args:
        core: the team.

    """

    def __init__(self, core: Core) -> None:
        super().__init__(core)
        self.fence = OfferFence(core.roster)
        self._clock = core.wire.clock
        core.wire.answer(COORDINATOR_LEAD, self._force, serve=Serve.IN_STEP)

    def check(self, now_ns: int) -> None:
        """Take back what most robots may not have heard of, when offers are first held back."""
        was_fenced = self.fence.reason is not None
        self.fence.step(now_ns)
        reason = self.fence.reason
        if reason is not None and not was_fenced:
            self.core.lifecycle.take_back(self.fence.received_by_most(now_ns), reason, now_ns)

    def robots_gone(self, robots: Sequence[Robot], now_ns: int) -> None:
        """The tokens of robots have gone."""
        self.fence.record_gone(robots, now_ns)

    def offer_refusal(self) -> TaskReason | None:
        """Why no task is offered; None if tasks may be offered."""
        return self.fence.reason

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add why no task is offered."""
        if self.fence.reason is None:
            return state
        return replace(state, stand_by=StandByStatus(process="", in_step=False, held_back=self.fence.reason))

    def _force(self, _request: Request[LeadRequest]) -> LeadReply:
        return LeadReply(left_out=self.force())

    def force(self) -> list[str]:
        """The operator wants this coordinator to lead; returns robots that do not count until they are heard again."""
        return self.fence.force(self._clock.now_ns())


class ElectedLeadership(Leadership):
    """Leads for as long as the team's witnesses want that, and sends its journal to a candidate.

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
        return self.mandate.refusal(self._clock.now_ns()) or self.fence.reason

    def request_refusal(self) -> str:
        """Why no task is accepted or cancelled, in words; empty if the coordinator leads."""
        now_ns = self._clock.now_ns()
        if self.mandate.leads(now_ns):
            return ""
        return told(self.mandate.not_leading_reason(now_ns))

    def when_kept(self, on_kept: OnKept, on_lost: OnLost) -> None:
        """Call `on_kept` once all changes so far are in each journal from which another may lead; see JournalFeed."""
        self.feed.when_kept(on_kept, on_lost)

    def summary(self, state: TeamState, now_ns: int) -> TeamState:
        """Add the election, and the candidate that stands by."""
        state = replace(super().summary(state, now_ns), lead=self.mandate.lead(now_ns))
        return replace(state, stand_by=self.feed.status(self.fence.reason)) if self.feed.process else state

    def publish(self, now_ns: int) -> None:
        """Send the journal's changes."""
        self.feed.step(now_ns)

    def close(self) -> None:
        """The coordinator ends."""
        self.feed.close()

    def force(self) -> list[str]:
        """As of `Leadership`; witnesses that do not answer do not count either."""
        return sorted({*super().force(), *self.mandate.force()})
