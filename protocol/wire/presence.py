"""Presence of participants, by their liveliness tokens."""

from collections import deque
from typing import NamedTuple

from robrain.protocol.topic import Token


class Change(NamedTuple):
    """One token that came or went."""

    names: dict[str, str]
    present: bool


PRESENT_MAX = 16384
"""Tokens of one topic that are followed."""


class Presence:
    """Follows the tokens of one topic; callbacks append, the owner takes changes at its own step."""

    def __init__(self, topic: Token) -> None:
        self.topic = topic
        self.present: dict[str, dict[str, str]] = {}
        """Key of each token that is there, and the names in it."""
        self.dropped = 0
        """Tokens skipped because there are too many."""
        self.arrived: deque[tuple[str, bool]] = deque(maxlen=65536)
        """Changes that `changes` has not yet returned."""

    def append(self, key: str, present: bool) -> None:
        """Take a change in: the key of a token that has come or gone."""
        self.arrived.append((key, present))

    def changes(self) -> list[Change]:
        """Changes since the last call; ordered by key where the order of arrival is not repeatable."""
        latest: dict[str, bool] = {}
        for _ in range(len(self.arrived)):
            key, present = self.arrived.popleft()
            latest[key] = present
        changes = []
        for key in sorted(latest):
            names = self.topic.parse(key)
            if names is None or latest[key] == (key in self.present):
                continue
            if latest[key]:
                if len(self.present) >= PRESENT_MAX:
                    self.dropped += 1
                    continue
                self.present[key] = names
            else:
                del self.present[key]
            changes.append(Change(names, latest[key]))
        return changes
