"""Packets on a TinyOS serial line: acknowledged ones, their acknowledgements, and those that need none.

A frame's body starts with a protocol byte; the numbers are those of `SERIAL_PROTO_*` in tos/lib/serial/Serial.h of
tinyos-main (older TinyOS had 64 to 66, as TEP 113 prints). The host sends acknowledged packets, one at a time, each
with a sequence number; the mote sends packets that need no acknowledgement and carry no number (TEP 113 section
3.3; tos/lib/serial/SerialP.nc). Nothing here reads or writes, so that it can be tested byte by byte.
"""

from collections import deque
from enum import IntEnum

import msgspec

from robrain.protocol.tinyos.hdlc import Deframer, LineCounters, frame

NUMBERS = 256


class Proto(IntEnum):
    """What a frame is."""

    ACK = 67
    """Sequence number: that packet has arrived."""
    PACKET_ACK = 68
    """Sequence number, packet: acknowledge it."""
    PACKET_NOACK = 69
    """Packet."""


class LinkCounters(msgspec.Struct):
    """How the packets fared."""

    received: int = 0
    duplicates: int = 0
    """Sent again by the other side although they had arrived."""
    unknown: int = 0
    """Good frames of a kind that is none of `Proto`, or without a packet."""
    sent: int = 0
    """Acknowledged by the other side."""
    resent: int = 0
    unsent: int = 0
    """Given up: never acknowledged, or too many were waiting."""


class SerialLink:
    """One end of a line.

    Args:
        ack_timeout_ns: how long an acknowledgement is waited for (TinyOS' tools wait 1 s).
        resends: how often a packet is sent again before it is given up.
        capacity: packets that may wait to be sent; one more is not taken in.

    """

    def __init__(self, *, ack_timeout_ns: int, resends: int, capacity: int = 64) -> None:
        self.counters = LinkCounters()
        self._deframer = Deframer()
        self._ack_timeout_ns = ack_timeout_ns
        self._resends = resends
        self._capacity = capacity
        self._to_write = bytearray()
        self._waiting: deque[bytes] = deque()
        self._number = 0
        self._in_flight: bytes | None = None
        self._due_ns = 0
        self._tries = 0
        self._last_body = b""

    @property
    def line(self) -> LineCounters:
        """What the line has brought."""
        return self._deframer.counters

    @property
    def is_idle(self) -> bool:
        """Whether nothing waits to be sent or to be acknowledged."""
        return self._in_flight is None and not self._waiting

    def send(self, packet: bytes) -> bool:
        """Have a packet sent until it is acknowledged; False, and counted, if too many wait already."""
        if len(self._waiting) >= self._capacity:
            self.counters.unsent += 1
            return False
        self._waiting.append(packet)
        return True

    def send_unacknowledged(self, packet: bytes) -> None:
        """Send a packet once, as motes do."""
        self._to_write += frame(bytes([Proto.PACKET_NOACK]) + packet)

    def receive(self, data: bytes) -> list[bytes]:
        """Packets that are complete with these bytes, each once."""
        packets = []
        for body in self._deframer.feed(data):
            kind = body[0]
            if kind == Proto.ACK and len(body) == 2:
                self._acknowledged(body[1])
            elif kind == Proto.PACKET_NOACK:
                packets.append(body[1:])
            elif kind == Proto.PACKET_ACK and len(body) > 2:
                self._to_write += frame(bytes([Proto.ACK, body[1]]))
                if body == self._last_body:  # our acknowledgement was lost
                    self.counters.duplicates += 1
                else:
                    packets.append(body[2:])
                self._last_body = body
            else:
                self.counters.unknown += 1
        self.counters.received += len(packets)
        return packets

    def to_write(self, now_ns: int) -> bytes:
        """What is to be written to the line now; ask often, this is also where packets are sent again."""
        if self._in_flight is not None and now_ns >= self._due_ns:
            if self._tries > self._resends:
                self.counters.unsent += 1
                self._in_flight = None
            else:
                self.counters.resent += 1
                self._write_in_flight(now_ns)
        if self._in_flight is None and self._waiting:
            self._number = (self._number + 1) % NUMBERS
            self._in_flight = frame(bytes([Proto.PACKET_ACK, self._number]) + self._waiting.popleft())
            self._tries = 0
            self._write_in_flight(now_ns)
        written, self._to_write = bytes(self._to_write), bytearray()
        return written

    def _write_in_flight(self, now_ns: int) -> None:
        assert self._in_flight is not None
        self._to_write += self._in_flight
        self._due_ns = now_ns + self._ack_timeout_ns
        self._tries += 1

    def _acknowledged(self, number: int) -> None:
        if self._in_flight is not None and number == self._number:
            self._in_flight = None
            self.counters.sent += 1
