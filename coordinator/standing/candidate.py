"""A coordinator that asks its witnesses for their votes, repeatedly, until more than half elect it."""

import zlib
from collections.abc import Sequence
from typing import NamedTuple

from robrain.coordinator.standing.poll import Poll
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.robots.witness_messages import WitnessRefusal, WitnessRequest, WitnessWish
from robrain.protocol.wire.endpoint import Endpoint

POLL_NS = to_ns(1.5)
"""Time limit of one election (chosen)."""
PAUSE_NS = to_ns(0.1)
PAUSES = 24
"""Pauses between elections are 1 to 24 times 0.1 s, drawn from the journal's name and the election's number. Longer
pauses than the 2 s for which a witness is bound to its vote keep two candidates from blocking each other (chosen)."""
WORDS = {
    WitnessRefusal.LEADER_HEARD: "has just heard or elected another coordinator",
    WitnessRefusal.OUTVOTED: "has taken part in a later election",
    WitnessRefusal.LACKS_CHANGES: "this journal may lack what another coordinator has acknowledged (--lead-anyway)",
    WitnessRefusal.UNWRITABLE: "cannot store its vote",
}


class Won(NamedTuple):
    """An election that a coordinator has won."""

    election: int
    """Its number."""
    asked_ns: int
    """Time at or after which more than half of the witnesses were asked; each votes for no other candidate for 2 s."""
    is_after_another: bool
    """Whether a coordinator with another journal led before; its last offers may still arrive."""


class Lost(NamedTuple):
    """An election that a coordinator has not won."""

    witnesses: tuple[str, ...]
    """Names of the robots that elect."""
    granted: frozenset[str]
    """Who has elected it."""
    refusals: tuple[tuple[str, WitnessRefusal], ...]
    """Each witness that refused, and why; witnesses without an answer are missing."""

    @property
    def words(self) -> str:
        """In one line."""
        refusals = dict(self.refusals)
        parts = []
        for refusal, words in WORDS.items():
            if names := [name for name in self.witnesses if refusals.get(name) is refusal]:
                parts.append(f"{', '.join(names)}: {words}")
        if silent := [name for name in self.witnesses if name not in self.granted and name not in refusals]:
            parts.append(f"{', '.join(silent)}: no answer yet")
        return f"{len(self.granted)} of {len(self.witnesses)} witnesses elect it; {'; '.join(parts)}"


class Elected(NamedTuple):
    """A coordinator that was elected to lead."""

    witnesses: tuple[str, ...]
    """Names of the robots that elect."""
    journal: str
    """Names its journal."""
    won: Won
    """The election."""


class Candidate:
    """Asks the witnesses for their votes.

    Args:
        wire: its Zenoh endpoint.
        witnesses: names of robots.
        journal: names its journal.
        is_forced: an operator confirms that no other journal has more.

    """

    def __init__(self, wire: Endpoint, witnesses: Sequence[str], journal: str, *, is_forced: bool = False) -> None:
        self.journal, self.witnesses, self.is_forced = journal, tuple(witnesses), is_forced
        self.lost: Lost | None = None
        """How the last election was lost; None if it was won."""
        self._wire = wire
        self._began_ns = wire.clock.now_ns()
        self._greatest = 0
        """The greatest number of an election that was heard of."""
        self._poll: Poll | None = None
        self._again_ns: int | None = None

    @property
    def is_asking(self) -> bool:
        """Whether witnesses may be electing it just now."""
        return self._poll is not None

    def note(self, election: int) -> None:
        """An election of this number was held."""
        self._greatest = max(self._greatest, election)

    def rest(self) -> None:
        """Stand for no election; what witnesses answer yet does not count."""
        self._poll = self._again_ns = None

    def step(self, now_ns: int, *, is_copy: bool) -> Won | None:
        """Ask, or take in answers; returns the election once it is won."""
        poll = self._poll
        if poll is None:
            if self._again_ns is not None and 0 < self._again_ns - now_ns <= PAUSES * PAUSE_NS:
                return None
            poll = self._begin(now_ns, is_copy=is_copy)
        poll.step(now_ns)
        self.note(poll.election)
        if poll.is_won:
            self._poll = self._again_ns = None
            self.lost = None
            return Won(poll.request.election, poll.won_ns, bool(poll.befores - {"", self.journal}))
        if poll.is_lost or not 0 <= now_ns - poll.began_ns <= POLL_NS:
            self.lost = Lost(self.witnesses, frozenset(poll.granted_ns), tuple(sorted(poll.refusals.items())))
            self._poll, self._again_ns = None, now_ns
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
        self._poll = Poll(self._wire, self.witnesses, request, now_ns)
        return self._poll
