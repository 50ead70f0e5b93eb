"""A link: it carries the puts, queries and tokens of one endpoint to others, and theirs to it.

`ZenohLink` carries them by Zenoh, to every subscriber. `LocalLink` carries them within a lockstep run that no other
process can join, and declares nothing to Zenoh. Its `Exchange` alone decides which endpoint receives a message.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

from robrain.protocol.answers.asked import Answer, Asked
from robrain.protocol.clock import Clock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.topic import Topic, Urgency

OnSample = Callable[[str, bytes], None]
"""Takes key and payload of a sample that Zenoh delivers."""
OnQuery = Callable[[Asked], None]
OnAnswer = Callable[[Answer], None]
OnChange = Callable[[str, bool], None]
"""Takes the key of a token, and whether it has come or gone."""


class Declaration(Protocol):
    """Something that is declared until it is undeclared."""

    def undeclare(self) -> Any:
        """End it."""


class Replies(NamedTuple):
    """Reply to a query."""

    answers: Iterable[Answer]
    in_time: bool = True
    """Whether they came before the time limit, if that is known when the query returns."""
    from_outside: bool = False
    """Whether another process has answered a lockstep run, or has failed to in time."""


class Link(Protocol):
    """Carries the puts, queries and tokens of one endpoint. Key expressions are Zenoh's."""

    declarations: list[Declaration]
    """Kinds of declarations, in that order."""

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """A publisher of one key."""

    def subscribe(self, selector: str, topic: Topic[Any], inbox: Inbox, handle: OnSample, *, waits: bool) -> None:
        """Deliver all puts under the keys of `selector` to an inbox.

        Args:
            selector: which keys.
            topic: topic that a sample is read as.
            inbox: takes samples that need not travel.
            handle: takes those that do, for the inbox.
            waits: whether `handle` may wait for anything.

        """

    def queryable(self, selector: str, handle: OnQuery, *, waits: bool) -> None:
        """Have queries to the keys of `selector` answered; `waits` as in `subscribe`."""

    def token(self, key: str) -> None:
        """Declare presence."""

    def watch(self, selector: str, handle: OnChange) -> None:
        """Have tokens followed from now on; those that are there already come first."""

    def tokens(self, selector: str, timeout_s: float) -> list[str]:
        """Keys of the tokens that are there now."""

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """Send a query and wait for its replies; in lockstep the time limit is for other processes and threads alone.

        Replies that are errors come first. Of several to one key only one counts.
        """

    def ask_then(self, key: str, payload: bytes | None, handle: OnAnswer) -> None:
        """Send a query of a lockstep run, whose replies `handle` gets, on whatever thread sends them."""

    def close(self) -> None:
        """Undeclare everything, the last first."""
