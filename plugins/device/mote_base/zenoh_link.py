"""The simulator's base station: packets are samples on the wire, in both drives."""

from collections.abc import Callable

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ARENA_RADIO_RX, ARENA_RADIO_TX


class ZenohLink:
    """A robot's place in the simulated air; it ends with the endpoint.

    Args:
        wire: the plugin's own endpoint.
        robot: whose base station it is.
        capacity: packets that may wait for the next step.
        wake: called when a packet has arrived.

    """

    def __init__(self, wire: Endpoint, robot: str, capacity: int, wake: Callable[[], None] | None = None) -> None:
        self._inbox = Inbox(capacity)
        self._inbox.on_arrival = wake
        self._publisher = wire.publisher(ARENA_RADIO_TX, robot=robot)
        wire.subscribe(self._inbox, ARENA_RADIO_RX, robot=robot)

    @property
    def dropped(self) -> int:
        """Packets that came while too many waited already."""
        return self._inbox.dropped

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step."""
        return [packet for _, _, packet in self._inbox.drain_raw()] if self._inbox.has_some else []

    def send(self, packet: bytes, now_ns: int) -> None:
        """Put a packet on the air."""
        self._publisher.put_bytes(packet)

    def why_down(self) -> str:
        """The simulated air is always there."""
        return ""

    def counters(self) -> dict[str, int]:
        """Nothing of its own."""
        return {}

    def close(self) -> None:
        """The endpoint's owner closes it."""
