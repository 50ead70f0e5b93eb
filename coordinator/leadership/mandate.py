"""Decides whether an elected coordinator still leads, and which changes it may acknowledge.

The witnesses store which journals hold every acknowledged change: the journal of this coordinator, and that of the
stand-by while it is in step. They elect no coordinator with another journal. The coordinator acknowledges a change once
every journal that they may elect holds it.

A coordinator leads while no other can have been elected. One of three conditions ensures that. No other journal may be
elected; or the stand-by that has one follows this coordinator. Or more than half of the witnesses have received it
recently. Robots and stand-by return the stamp of the last message that they received. The lease is therefore measured
by the coordinator's own clock, from the time when it sent that message. The lease ends before the stand-by or the
witnesses may act. Without it the coordinator offers no task and renews no robot's lease, and asks to be elected again.
"""

import logging

import msgspec

from robrain.coordinator.leadership.election import Elected, Election, Poll
from robrain.coordinator.team.roster import Roster
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.witness_messages import Lead, Led, WitnessRequest, WitnessWish
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.reasons import PlainReason, plain
from robrain.protocol.wire.endpoint import Endpoint

logger = logging.getLogger(__name__)

LEASE_NS = to_ns(1.7)
"""A witness votes for no other coordinator within 2 s of a summary (`agent/consensus/witness.py`). The difference
covers clock drift and long steps (chosen)."""
LISTEN_NS = to_ns(2.0)
"""A coordinator that replaces another one waits this long before its first offer. By then robots have reported the
other's last offers, or their leases have expired."""
LEAP_MAX = 1000
"""A witness that reports an election number this much greater than the coordinator's is ignored (chosen)."""
NOBODY = Led(election=0, stamp_ns=0)


class Mandate:
    """The right of one coordinator to lead.

    Args:
        wire: its Zenoh endpoint.
        roster: the robots that it receives.
        elected: its election.

    """

    def __init__(self, wire: Endpoint, roster: Roster, elected: Elected) -> None:
        self._wire, self._roster = wire, roster
        self.journal, self._won = elected.journal, elected.won
        self.witnesses = elected.witnesses
        """Names of the robots that elect."""
        self._election = Election(wire, elected.witnesses, elected.journal, elected.voters)
        self._election.record(self._won.election)
        now_ns = wire.clock.now_ns()
        self._listen_until_ns = now_ns + LISTEN_NS if self._won.is_after_another else now_ns
        self._inbox = Inbox()
        wire.subscribe(self._inbox, COORDINATOR_STATE)
        self.superseded = ""
        """Name of the coordinator that leads instead; empty if no other leads."""
        self._possible: frozenset[str] | None = None
        """Journals that the witnesses may elect; None while unknown."""
        self._held: frozenset[str] = frozenset()
        """Journals that more than half of the witnesses have stored."""
        self._copy, self._copy_led = "", NOBODY
        """The journal of the stand-by, and the last message that it received."""
        self._number = 0
        self._poll: Poll | None = None
        self._was_leading = True

    def leads(self, now_ns: int) -> bool:
        """Whether no other coordinator can have been elected."""
        if self.superseded:
            return False
        # No other journal may be elected, or only that of a stand-by that follows this coordinator.
        is_only = self._possible is not None and self._possible <= {self.journal, self._standby_journal(now_ns)}
        return (is_only and not self._is_deserted) or self._is_backed(now_ns)

    @property
    def _is_deserted(self) -> bool:
        """Whether more than half of the voters have taken part in a later election, as by an operator's word."""
        voters = self._election.voters
        later = sum(self._led(name).election > self._won.election for name in voters)
        return 2 * later > len(voters)

    def _is_backed(self, now_ns: int) -> bool:
        """Whether more than half of the voters currently refuse other candidates."""
        voters = self._election.voters
        is_elected_now = 0 <= now_ns - self._won.asked_ns <= LEASE_NS
        return is_elected_now or 2 * sum(self._is_confirmed_by(name, now_ns) for name in voters) > len(voters)

    def force(self) -> list[str]:
        """The operator wants this coordinator to lead; returns witnesses that do not count until they answer again."""
        return self._election.force() if not self.leads(self._wire.clock.now_ns()) else []

    def _standby_journal(self, now_ns: int) -> str:
        """The journal of a stand-by that has received this coordinator recently; empty if there is none."""
        return self._copy if self._is_fresh(self._copy_led, now_ns) else ""

    def record_copy(self, journal: str, led: Led) -> None:
        """Record which election a stand-by follows."""
        self._copy, self._copy_led = journal, led

    def confirmations(self, now_ns: int) -> int:
        """Number of witnesses that report a recent summary of this coordinator."""
        return sum(self._is_confirmed_by(name, now_ns) for name in self.witnesses)

    def refusal(self, now_ns: int) -> PlainReason | None:
        """Why no task is offered; None if tasks may be offered."""
        if not self.leads(now_ns):
            return self.not_leading_reason(now_ns)
        # No task may be done by a decision that is lost with this machine.
        is_held = bool(self._held) and self.journal in self._held
        if is_held and not 0 < self._listen_until_ns - now_ns <= LISTEN_NS:
            return None
        return plain("takes_over", "the coordinator has just taken over and listens first")

    def not_leading_reason(self, now_ns: int) -> PlainReason:
        """Number of witnesses that receive this coordinator, as the reason why it does not lead."""
        confirmed, witnesses = self.confirmations(now_ns), len(self.witnesses)
        text = f"{confirmed} of {witnesses} witnesses hear the coordinator, and another one may lead"
        return plain("not_leading", text, received=confirmed, witnesses=witnesses)

    def may_acknowledge(self, copy: str) -> bool:
        """Whether a change may be acknowledged that is in this journal and in one other.

        Args:
            copy: names the other journal; empty if there is none.

        """
        return self._possible is not None and self._possible <= {self.journal, copy}

    def lead(self, now_ns: int) -> Lead:
        """The state of the election, for the summary."""
        return Lead(
            election=self._won.election,
            journal=self.journal,
            is_suspended=not self.leads(now_ns),
            received=self.confirmations(now_ns),
            witnesses=list(self.witnesses),
        )

    def step(self, copy: str, now_ns: int) -> bool:
        """Receive other coordinators' summaries, ask to be elected if needed, and keep the witnesses up to date.

        Args:
            copy: the journal that is in step; empty if none is.
            now_ns: the time.

        Returns:
            Whether the summary must be sent at once.

        """
        self._receive()
        if self.superseded:
            return False
        election = self._won.election
        for name in self.witnesses:
            if (later := self._led(name).election) <= election + LEAP_MAX:
                self._election.record(later)
        leads = self.leads(now_ns)
        if self._was_leading and not leads:
            logger.error(
                "the coordinator does not lead any more: %d of %d witnesses hear it; it stands for election",
                self.confirmations(now_ns), len(self.witnesses),
            )  # fmt: skip
        if leads and not self._is_outvoted():
            self._election.rest()
            # Without enough witnesses the other could not be elected, and this one not continue without it.
            adds = copy if copy in self._held or self._is_backed(now_ns) else ""
            self._hold(frozenset({self.journal, adds} - {""}), now_ns)
        else:
            self._poll = None
            won = self._election.step(now_ns, is_copy=False)
            if won is not None:
                self._election.is_forced = False
                self._won, self._number, self._held = won, 0, frozenset()
                if not leads:
                    logger.warning("the coordinator leads again, by election %d", won.election)
        before, self._was_leading = (self._was_leading, election), self.leads(now_ns)
        return before != (self._was_leading, self._won.election)

    def _is_confirmed_by(self, name: str, now_ns: int) -> bool:
        return self._is_fresh(self._led(name), now_ns)

    def _is_fresh(self, led: Led, now_ns: int) -> bool:
        return led.election == self._won.election and 0 <= now_ns - led.stamp_ns <= LEASE_NS

    def _is_outvoted(self) -> bool:
        """Whether a witness has voted in a later election without a winner; until the next it follows none."""
        elections = [self._led(name).election - self._won.election for name in self.witnesses]
        return any(0 < later <= LEAP_MAX for later in elections)

    def _led(self, name: str) -> Led:
        robot = self._roster.robots.get(name)
        led = msgspec.UNSET if robot is None or robot.state is None else robot.state.led
        return NOBODY if led is msgspec.UNSET else led

    def _receive(self) -> None:
        for received in self._inbox.drain() if self._inbox.has_some else ():
            lead = received.message.lead
            if lead is msgspec.UNSET or lead.is_suspended:
                continue
            self._election.record(lead.election)
            # Of another process with a file that was copied from this one's, the number is greater.
            is_another = lead.journal != self.journal and lead.election == self._won.election
            if is_another or lead.election > self._won.election:
                self.superseded = f"another coordinator leads, by election {lead.election}"

    def _hold(self, holders: frozenset[str], now_ns: int) -> None:
        poll = self._poll
        if poll is None or frozenset(poll.request.holders) != holders:
            if poll is None and holders == self._held:
                return
            poll = self._ask_to_hold(holders, now_ns)
        poll.step(now_ns)
        self._election.record(poll.election)
        if poll.is_won:
            self._held = self._possible = holders
            # A witness that was silent when the operator forced the election counts again with its answer.
            self._election.voters = tuple(
                name for name in self.witnesses if name in self._election.voters or name in poll.granted_ns
            )
            if poll.is_unanimous:
                self._poll = None

    def _ask_to_hold(self, holders: frozenset[str], now_ns: int) -> Poll:
        self._number += 1
        self._possible = None if self._possible is None else self._possible | holders
        request = WitnessRequest(
            wish=WitnessWish.HOLD,
            election=self._won.election,
            journal=self.journal,
            number=self._number,
            holders=sorted(holders),
        )
        self._poll = Poll(self._wire, self.witnesses, self._election.voters, request, now_ns)
        return self._poll
