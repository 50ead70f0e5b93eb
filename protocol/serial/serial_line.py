"""A line that bytes come over and go out on, without waiting."""

import os
from collections.abc import Callable
from typing import Protocol

import serial
from serial import Serial

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SERIAL, ARENA_SERIAL_TX
from robrain.protocol.wire.endpoint import Endpoint

CHUNK_BYTES = 65_536
SIMULATED = "zenoh:"
"""A port that begins with this is a line of the simulator, such as `zenoh:lidar`."""


class SerialLine(Protocol):
    """A line; reading and writing raise OSError when it is lost, as when its plug is pulled."""

    def read(self) -> bytes:
        """Received bytes, at most `CHUNK_BYTES`; empty if there are none."""

    def write(self, data: bytes) -> bool:
        """Send these bytes; bytes that the line does not accept at once are dropped. Whether it took all."""

    def close(self) -> None:
        """Leave it."""


def write_at_once(port: serial.SerialBase, data: bytes) -> int:
    """Send the bytes that a port accepts without waiting; returns their number.

    pyserial waits until the port has taken all, for ever if it is to wait for 0 s.

    Raises:
        OSError: the line is lost.

    """
    if os.name != "posix" or not isinstance(port, Serial):
        return port.write(data) or 0
    try:
        return os.write(port.fileno(), data)
    except BlockingIOError:
        return 0


class PortLine:
    """A serial port of this computer, or a pty.

    Args:
        port: such as `/dev/ttyUSB0`, or a URL of pyserial's.
        baud: bits a second.
        has_dtr: set DTR while the port is open, as most adapters expect.

    Raises:
        OSError: it cannot be opened (pyserial's errors are such).
        ValueError: it cannot be as fast, or the URL is none.

    """

    def __init__(self, port: str, baud: int, *, has_dtr: bool = True) -> None:
        self._port = serial.serial_for_url(port, baud, timeout=0, write_timeout=0, do_not_open=True)
        if not has_dtr:
            self._port.dtr = False
        self._port.open()

    def read(self) -> bytes:
        """As SerialLine."""
        data: bytes = self._port.read(CHUNK_BYTES)
        return data

    def write(self, data: bytes) -> bool:
        """As SerialLine."""
        return write_at_once(self._port, data) == len(data)

    def close(self) -> None:
        """As SerialLine."""
        self._port.close()


class SimulatedLine:
    """A line of the simulator's: samples on the wire, in both drives.

    Args:
        wire: the plugin's own endpoint, with which the line ends.
        robot: owner of the line.
        name: of the line, such as `lidar`.
        wake: called when bytes have arrived.

    """

    def __init__(self, wire: Endpoint, robot: str, name: str, wake: Callable[[], None]) -> None:
        self._inbox = Inbox(capacity=256)
        self._inbox.on_arrival = wake
        wire.subscribe(self._inbox, ARENA_SERIAL, robot=robot, line=name)
        self._sent = wire.publisher(ARENA_SERIAL_TX, robot=robot, line=name)

    def read(self) -> bytes:
        """As SerialLine."""
        return b"".join(data for _, _, data in self._inbox.drain_raw()) if self._inbox.has_some else b""

    def write(self, data: bytes) -> bool:
        """As SerialLine."""
        self._sent.put_bytes(data)
        return True

    def close(self) -> None:
        """The endpoint's owner closes it."""
