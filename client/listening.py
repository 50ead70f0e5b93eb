"""What a client listens to for a time, each with an endpoint of its own that is closed with it."""

from collections.abc import Iterator
from typing import TypeVar

from robrain.client.transport import Transport
from robrain.protocol.answers.asked import BY
from robrain.protocol.table.topic import Q, Query, R
from robrain.protocol.wire.endpoint import Endpoint

T = TypeVar("T")


class _NotedEndpoint(Endpoint):
    """Tells its transport of each query that may change something, before it asks."""

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport.session, transport.team, transport.clock, transport.drive, party=transport.party)
        self._transport = transport

    def ask(
        self,
        topic: Query[Q, R],
        request: Q | None = None,
        *,
        timeout_s: float | None = None,
        by: str = "",
        **names: str,
    ) -> R:
        """As `Endpoint.ask`."""
        if not topic.reads_only:
            key = topic.key(self.team, **names)
            body = b"" if request is None else topic.requests.write(request)
            self._transport.record_query(f"{key}?{BY}={by}" if by else key, body)
        return super().ask(topic, request, timeout_s=timeout_s, by=by, **names)


class Listening:
    """Opens endpoints, and closes those that are left.

    Args:
        transport: to the team.

    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._open: list[Endpoint] = []

    def open(self) -> Endpoint:
        """A new endpoint of the team."""
        transport = self._transport
        wire = _NotedEndpoint(transport)
        self._open.append(wire)
        return wire

    def until_done(self, wire: Endpoint, items: Iterator[T]) -> Iterator[T]:
        """The items, after which the endpoint is closed."""
        try:
            yield from items
        finally:
            self.end(wire)

    def end(self, wire: Endpoint) -> None:
        """Close an endpoint, unless it is closed already."""
        if wire in self._open:
            self._open.remove(wire)
            wire.close()

    def close(self) -> None:
        """Close all that are open."""
        while self._open:
            self._open.pop().close()
