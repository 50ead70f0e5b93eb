"""The air between the radios of a team, as `RadioExchange` asks for it: who reaches whom, and what that costs."""

from collections.abc import Collection, Sequence
from typing import Protocol

from robrain.protocol.messages.team.arena_messages import LinkCounters

COORDINATOR = "coordinator"
"""The coordinator's party; robots are parties by their names."""
EVERYWHERE = ""
"""The party of arena, recorder and scripts: no radio is between them and anybody."""


class RadioNetwork(Protocol):
    """Decides how far messages of a team get. Times are in nanoseconds of the run's clock, sizes in bytes."""

    counters: LinkCounters
    """What became of the messages so far."""
    parties: Sequence[str]
    """Everybody who has a radio."""

    def look(self, now_ns: int, on: Collection[str]) -> bool:
        """Take in where the parties are now, and which of them are switched on; returns False if it is not yet time."""

    def reaches(self, speaker: str, hearer: str) -> bool:
        """Whether there is a way from one party to another, by relays or without."""

    def spread(self, speaker: str, hearers: Sequence[str], size: int, now_ns: int) -> dict[str, int]:
        """Send a sample once; returns how long it takes to each hearer that it reaches, and counts the others."""

    def overtakes(self, speaker: str, hearer: str) -> bool:
        """Whether samples from one party to another may overtake earlier ones now."""

    def carry(self, speaker: str, hearer: str, size: int, now_ns: int, limit_ns: int) -> int | None:
        """Send a request or a reply, again if it is lost; returns how long it takes, None if that is over the limit."""


def is_direct(speaker: str, hearer: str) -> bool:
    """Whether no radio is between two parties."""
    return speaker == hearer or EVERYWHERE in (speaker, hearer)
