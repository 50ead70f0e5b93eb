"""The Serial Forwarder's protocol: packets of a base station over TCP, to as many clients as like.

Each side first sends `U` and a byte for the version of the protocol, a space since TinyOS 2.0. Both sides use the lower
of both versions. Then each packet is a byte with its length and the packet's bytes, in both directions
(support/sdk/c/sf/sfsource.c and SFProtocol.java of tinyos-main). TCP loses nothing, so it is not possible to find the
next packet after garbage: a client with a wrong greeting is disconnected.
"""

GREETING = b"U "
DEFAULT_PORT = 9002
"""TinyOS' own."""
MAX_PACKET_BYTES = 255


class BadGreeting(ValueError):
    """The other side speaks no Serial Forwarder protocol of TinyOS 2; its text is one sentence for a person."""


def encode(packet: bytes) -> bytes:
    """A packet as it goes over TCP (ValueError if it is empty or longer than 255 bytes)."""
    if not 1 <= len(packet) <= MAX_PACKET_BYTES:
        raise ValueError(f"expected a packet of 1 to {MAX_PACKET_BYTES} bytes, got {len(packet)}")
    return len(packet).to_bytes() + packet


class PacketDecoder:
    """Reads the input from the other side, in pieces of any size, and returns its packets."""

    def __init__(self) -> None:
        self.has_greeted = False
        """Whether the other side's greeting has arrived."""
        self._waiting = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Packets that are complete with these bytes; those of length 0 are skipped.

        Raises:
            BadGreeting: the first two bytes are no greeting.

        """
        waiting = self._waiting + data
        if not self.has_greeted:
            if waiting[:1] not in (b"", b"U"):
                raise BadGreeting(f"expected a Serial Forwarder's greeting {GREETING!r}, got {waiting[:16]!r}")
            if len(waiting) < len(GREETING):
                self._waiting = waiting
                return []
            if waiting[1] < GREETING[1]:
                raise BadGreeting(f"expected a Serial Forwarder of TinyOS 2 ({GREETING!r}), got {waiting[:2]!r}")
            self.has_greeted = True
            waiting = waiting[len(GREETING) :]
        packets = []
        start = 0
        while start < len(waiting) and start + 1 + waiting[start] <= len(waiting):
            end = start + 1 + waiting[start]
            if end > start + 1:
                packets.append(waiting[start + 1 : end])
            start = end
        self._waiting = waiting[start:]
        return packets
