"""The link of an endpoint in a lockstep run whose robots hear each other by radio, if at all."""

from threading import Event
from typing import Any

from robrain.protocol.answers.asked import Answer
from robrain.protocol.border.border import Heard
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.links.link import Replies, TakeAnswer
from robrain.protocol.links.local_link import DeclaringLink
from robrain.protocol.links.publisher import Publisher
from robrain.protocol.links.radio_exchange import RadioExchange
from robrain.protocol.table.topic import ANSWER_S, Topic, Urgency


class LocalRadioLink(DeclaringLink):
    """A `Link` within this process, for one party.

    Args:
        exchange: of the run.
        party: whose endpoint it is: a robot's name, `COORDINATOR`, or `EVERYWHERE` for arena, recorder and scripts.

    Raises:
        ValueError: there is no such party.

    """

    def __init__(self, exchange: RadioExchange, party: str) -> None:
        self._party = party
        self._exchange = exchange
        self._home = exchange.join(party)
        super().__init__(self._home)
        self._is_open = True

    def deliver(self, topic: Heard, key: str, payload: bytes) -> None:
        """Send a sample of this party."""
        self._exchange.deliver_from(self._party, topic, key, payload)

    def publisher(self, topic: Topic[Any], key: str, clock: Clock) -> Publisher:
        """See `Link`."""
        return Publisher(topic, key, clock, self)

    def ask(self, selector: str, payload: bytes | None, urgency: Urgency, timeout_s: float) -> Replies:
        """See `Link`; a query that is too late has failed at once."""
        answers: list[Answer] = []
        is_over = Event()
        query = self._exchange.ask_from(
            self._party, selector, payload or b"", to_ns(timeout_s), answers.append, is_over.set, waits=True
        )
        if not answers and query.is_late:
            return Replies((), in_time=False)
        in_time = bool(answers) or is_over.wait(timeout_s)
        return Replies(answers, in_time, from_outside=not in_time)

    def ask_then(self, key: str, payload: bytes | None, take: TakeAnswer) -> None:
        """See `Link`."""
        self._exchange.ask_from(self._party, key, payload or b"", to_ns(ANSWER_S), take, lambda: None, waits=False)

    def close(self) -> None:
        """See `Link`."""
        super().close()
        if self._is_open:
            self._is_open = False
            self._exchange.leave(self._home)
