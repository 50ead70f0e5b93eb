"""What a client listens to for a time, each with an endpoint of its own that is closed with it."""

from collections.abc import Iterator
from typing import TypeVar

from robrain.client.transport import Transport
from robrain.protocol.wire.endpoint import Endpoint

T = TypeVar("T")


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
        wire = Endpoint(transport.session, transport.team, transport.clock, transport.drive)
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
