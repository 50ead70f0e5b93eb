"""A base station on a serial line, and the line opened again when it was pulled out."""

import serial

from robrain.plugins.device.mote_base.link import Backoff
from robrain.protocol.serial.serial_line import write_at_once
from robrain.protocol.tinyos.serial_line import SerialLink

CHUNK_BYTES = 16_384


class SerialLineLink:
    """A base station's serial line.

    Args:
        device: such as `/dev/ttyUSB0`.
        baud: bits a second (57,600 on a Mica2).
        ack_timeout_ns: how long the base station's acknowledgement is waited for.
        resends: how often a packet is sent again.
        backoff: when to open the line again.

    Raises:
        OSError: it cannot be opened (pyserial's errors are such).
        ValueError: the line cannot be as fast.

    """

    def __init__(self, device: str, baud: int, *, ack_timeout_ns: int, resends: int, backoff: Backoff) -> None:
        self.dropped = 0
        self._device = device
        self._baud = baud
        self._backoff = backoff
        self._why_down = ""
        self._reopened = 0
        self._left = b""
        self._link = SerialLink(ack_timeout_ns=ack_timeout_ns, resends=resends)
        self._port: serial.Serial | None = self._open()

    def receive(self, now_ns: int) -> list[bytes]:
        """Packets since the last step; also where packets are sent again."""
        if self._port is None:
            if self._backoff.is_due(now_ns):
                self._open_again(now_ns)
            return []
        try:
            packets = self._link.receive(self._port.read(CHUNK_BYTES))
            self._write(now_ns)
        except OSError as error:
            self._lose(error, now_ns)
            return []
        return packets

    def send(self, packet: bytes, now_ns: int) -> None:
        """Queue a packet; it is sent until the base station has acknowledged it."""
        if self._link.send(packet) and self._port is not None:
            try:
                self._write(now_ns)
            except OSError as error:
                self._lose(error, now_ns)

    def why_down(self) -> str:
        """Why the line is not open."""
        return self._why_down

    def counters(self) -> dict[str, int]:
        """What line and packets have met with."""
        line, link = self._link.line, self._link.counters
        return {
            "bad_crc": line.bad_crc,
            "bad_length": line.bad_length,
            "bad_escape": line.bad_escape,
            "stray_bytes": line.stray_bytes,
            "duplicates": link.duplicates,
            "unknown": link.unknown,
            "resent": link.resent,
            "unsent": link.unsent,
            "reopened": self._reopened,
        }

    def close(self) -> None:
        """Close the line."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _open(self) -> serial.Serial:
        return serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)

    def _open_again(self, now_ns: int) -> None:
        try:
            self._port = self._open()
        except (OSError, ValueError):
            self._backoff.failed(now_ns)
            return
        self._why_down, self._left = "", b""
        self._reopened += 1
        self._backoff.succeeded()

    def _write(self, now_ns: int) -> None:
        assert self._port is not None
        self._left += self._link.to_write(now_ns)
        if self._left:
            self._left = self._left[write_at_once(self._port, self._left) :]

    def _lose(self, error: OSError, now_ns: int) -> None:
        self.close()
        self._why_down = f"{self._device}: {error}"
        self._backoff.failed(now_ns)
