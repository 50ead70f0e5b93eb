"""Elections: a coordinator asks its witnesses for their votes, repeatedly, until more than half elect it."""

import zlib
from collections.abc import Collection, Sequence
from typing import NamedTuple

from robrain.protocol.answers.later import Later
from robrain.protocol.clock import to_ns
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.messages.robots.witness_messages import (
    ROBOT_WITNESS,
    WitnessRefusal,
    WitnessReply,
    WitnessRequest,
    WitnessWish,
)
from robrain.protocol.wire.endpoint import Endpoint

ASK_TIMEOUT_S = 0.5
ASK_AGAIN_NS = to_ns(0.3)
"""Interval at which witnesses without a final answer are asked again."""
TEMPORARY = (WitnessRefusal.LEADER_SEEN, WitnessRefusal.UNWRITABLE)
"""Refusals that may not last."""
POLL_NS = to_ns(1.5)
"""Time limit of one election (chosen)."""
PAUSE_NS = to_ns(0.1)
PAUSES = 24
"""Pauses between elections are 1 to 24 times 0.1 s, drawn from the journal's name and the election's number. Longer
pauses than the 2 s for which a witness is bound to its vote keep two candidates from blocking each other (chosen)."""
WORDS = {
    WitnessRefusal.LEADER_SEEN: "has just heard or elected another coordinator",
    WitnessRefusal.OUTVOTED: "has taken part in a later election",
    WitnessRefusal.LACKS_CHANGES: "this journal may lack what another coordinator has acknowledged (robrain lead)",
    WitnessRefusal.UNWRITABLE: "cannot store its vote",
}


class _PendingVote(NamedTuple):
    since_ns: int
    reply: Later[WitnessReply]


class Poll:
    """Asks all witnesses one question, and those without a final answer again and again.

    Args:
        wire: the coordinator's Zenoh endpoint.
        witnesses: names of robots.
        voters: the witnesses that count.
        request: the question.
        now_ns: the time.

    """

    def __init__(
        self, wire: Endpoint, witnesses: Sequence[str], voters: Collection[str], request: WitnessRequest, now_ns: int
    ) -> None:
        self.request = request
        self.began_ns = self._ask_ns = now_ns
        self.granted_ns: dict[str, int] = {}
        """When each witness that has granted the request was asked."""
        self.refusals: dict[str, WitnessRefusal] = {}
        """Witnesses that have refused, and why."""
        self.journals_before: set[str] = set()
        """Journals of the coordinators that they had elected before this one."""
        self._elections: dict[str, int] = {}
        self._wire, self._witnesses, self._voters = wire, witnesses, voters
        self._waiting: dict[str, _PendingVote] = {}
        self._ask()

    @property
    def election(self) -> int:
        """The greatest number that more than half of the voters know at least; 0 if unknown.

        The greatest number of all could come from one faulty witness.
        """
        known = sorted((self._elections.get(name, 0) for name in self._voters), reverse=True)
        return known[(len(known) - 1) // 2]

    @property
    def is_won(self) -> bool:
        """Whether more than half of the voters have granted the request."""
        return 2 * len(self._granted) > len(self._voters)

    @property
    def is_lost(self) -> bool:
        """Whether half of the voters or more will not grant it."""
        final = sum(self.refusals.get(name, TEMPORARY[0]) not in TEMPORARY for name in self._voters)
        return 2 * final >= len(self._voters)

    @property
    def is_unanimous(self) -> bool:
        """Whether all witnesses have granted it."""
        return len(self.granted_ns) == len(self._witnesses)

    @property
    def silent(self) -> list[str]:
        """Witnesses that have not answered."""
        return [name for name in self._witnesses if name not in self.granted_ns and name not in self.refusals]

    @property
    def words(self) -> str:
        """The answers in one line."""
        parts = []
        for refusal, words in WORDS.items():
            if names := [name for name in self._witnesses if self.refusals.get(name) is refusal]:
                parts.append(f"{', '.join(names)}: {words}")
        if self.silent:
            parts.append(f"{', '.join(self.silent)}: no answer yet")
        return f"{len(self.granted_ns)} of {len(self._witnesses)} witnesses elect it; {'; '.join(parts)}"

    @property
    def won_ns(self) -> int:
        """More than half of the voters were asked at this time or later, and granted the request."""
        return sorted(self._granted, reverse=True)[len(self._voters) // 2]

    @property
    def _granted(self) -> list[int]:
        return [self.granted_ns[name] for name in self._voters if name in self.granted_ns]

    def step(self, now_ns: int) -> None:
        """Read the answers, and ask again."""
        for name, asked in list(self._waiting.items()):
            try:
                reply = asked.reply.poll()
            except (CallError, NobodyThere):
                del self._waiting[name]
                continue
            if reply is not None:
                del self._waiting[name]
                self._handle_reply(name, asked.since_ns, reply)
        if not 0 <= now_ns - self._ask_ns < ASK_AGAIN_NS:
            self._ask_ns = now_ns
            self._ask()

    def _handle_reply(self, name: str, asked_ns: int, reply: WitnessReply) -> None:
        self._elections[name] = reply.election
        if reply.refusal is not None:
            self.refusals[name] = reply.refusal
            return
        self.refusals.pop(name, None)
        self.granted_ns[name] = asked_ns
        self.journals_before.add(reply.before)

    def _ask(self) -> None:
        for name in self._witnesses:
            is_open = self.refusals.get(name) in (None, *TEMPORARY)
            if is_open and name not in self.granted_ns and name not in self._waiting:
                reply = self._wire.ask_later(ROBOT_WITNESS, self.request, timeout_s=ASK_TIMEOUT_S, robot=name)
                self._waiting[name] = _PendingVote(self._ask_ns, reply)


class Won(NamedTuple):
    """An election that a coordinator has won."""

    election: int
    """Its number."""
    asked_ns: int
    """Time at or after which more than half of the voters were asked; each votes for no other candidate for 2 s."""
    is_after_another: bool
    """Whether a coordinator with another journal led before; its last offers may still arrive."""


class Elected(NamedTuple):
    """A coordinator that was elected to lead."""

    witnesses: tuple[str, ...]
    """Names of the robots that elect."""
    voters: tuple[str, ...]
    """The witnesses that counted."""
    journal: str
    """Names its journal."""
    won: Won
    """The election."""


class Election:
    """Asks the witnesses for their votes.

    Args:
        wire: its Zenoh endpoint.
        witnesses: names of robots.
        journal: names the journal of the coordinator that is to be elected.
        voters: the witnesses that count; None for all.

    """

    def __init__(
        self, wire: Endpoint, witnesses: Sequence[str], journal: str, voters: Sequence[str] | None = None
    ) -> None:
        self.journal, self.witnesses = journal, tuple(witnesses)
        self.voters = self.witnesses if voters is None else tuple(voters)
        self.lost: Poll | None = None
        """The last election if it was lost; None if it was won."""
        self._wire = wire
        self.is_forced = False
        """Whether an operator confirms that no other journal has more."""
        self._began_ns = wire.clock.now_ns()
        self._greatest = 0
        """The greatest number of an election that is known."""
        self._poll: Poll | None = None
        self._again_ns: int | None = None

    @property
    def is_asking(self) -> bool:
        """Whether witnesses may be electing it just now."""
        return self._poll is not None

    def force(self) -> list[str]:
        """Record that the operator confirms: no other journal has more changes, and silent witnesses are inactive.

        Returns:
            The silent witnesses, which do not count until they answer again.

        """
        silent = [] if self.lost is None else self.lost.silent
        self.is_forced = True
        if len(silent) < len(self.witnesses):
            self.voters = tuple(name for name in self.witnesses if name not in silent)
        self.rest()
        return sorted(set(self.witnesses) - set(self.voters))

    def withdraw_force(self) -> None:
        """End the operator's confirmation, because the team has a coordinator again."""
        self.is_forced, self.voters = False, self.witnesses

    def record(self, election: int) -> None:
        """Record that an election with this number was held."""
        self._greatest = max(self._greatest, election)

    def rest(self) -> None:
        """Stand for no election; answers that are still to come do not count."""
        self._poll = self._again_ns = None

    def step(self, now_ns: int, *, is_copy: bool) -> Won | None:
        """Ask, or read answers; returns the election once it is won."""
        poll = self._poll
        if poll is None:
            if self._again_ns is not None and 0 < self._again_ns - now_ns <= PAUSES * PAUSE_NS:
                return None
            poll = self._begin(now_ns, is_copy=is_copy)
        poll.step(now_ns)
        self.record(poll.election)
        if poll.is_won:
            self.rest()
            self.lost = None
            return Won(poll.request.election, poll.won_ns, bool(poll.journals_before - {"", self.journal}))
        if poll.is_lost or not 0 <= now_ns - poll.began_ns <= POLL_NS:
            self.lost, self._poll, self._again_ns = poll, None, now_ns
            has_learnt_number = not poll.granted_ns and poll.election > poll.request.election
            if not has_learnt_number:
                draw = zlib.crc32(f"{self.journal} {poll.request.election}".encode()) % PAUSES
                self._again_ns = now_ns + (1 + draw) * PAUSE_NS
        return None

    def _begin(self, now_ns: int, *, is_copy: bool) -> Poll:
        self._greatest += 1
        request = WitnessRequest(
            wish=WitnessWish.ELECT,
            election=self._greatest,
            journal=self.journal,
            began_ns=self._began_ns,
            is_copy=is_copy,
            forced=self.is_forced,
        )
        self._poll = Poll(self._wire, self.witnesses, self.voters, request, now_ns)
        return self._poll
