"""Frames as identifier and bytes: a device reads and writes them many times a second, without a `can.Message` for each.

The bus of the simulator gives them at once; those of all other interfaces of python-can are wrapped.
"""

from collections.abc import Callable, Sized
from typing import NamedTuple, Protocol, runtime_checkable

import can

from robrain.protocol.can.payload import EXTENDED, ID_MASK, flagged_identifier
from robrain.protocol.clock import NS_PER_S


class Frame(NamedTuple):
    """A frame that was received."""

    identifier: int
    """With SocketCAN's flags for extended, remote and error frames; a plain data frame is below 2048."""
    data: bytes
    """Zeros in a remote frame, as many as it requests."""
    stamp_ns: int
    """Time stamp of the interface."""


@runtime_checkable
class FramePort(Protocol):
    """A node on a bus."""

    pending: Sized
    """Empty if `read_frames` has nothing to take."""
    wakes: bool
    """Whether `on_frame` is called."""
    on_frame: Callable[[], None] | None
    """Called after each frame that has arrived, on any thread."""

    def send_data(self, identifier: int, data: bytes) -> None:
        """Send a data frame; an identifier of 29 bits has the flag EXTENDED (can.CanError if it cannot be sent)."""

    def read_frames(self) -> list[Frame]:
        """Take all frames that have arrived, in order (can.CanError if the bus cannot be read)."""


def frame_port(bus: can.BusABC) -> FramePort:
    """A bus as a port; both end with the bus's `shutdown`."""
    return bus if isinstance(bus, FramePort) else MessagePort(bus)


class MessagePort:
    """A port over any of python-can's interfaces.

    Args:
        bus: the bus.

    """

    pending: Sized = (None,)
    wakes = False

    def __init__(self, bus: can.BusABC) -> None:
        self.on_frame: Callable[[], None] | None = None
        self._bus = bus

    def send_data(self, identifier: int, data: bytes) -> None:
        """As FramePort."""
        is_extended = bool(identifier & EXTENDED)
        self._bus.send(can.Message(arbitration_id=identifier & ID_MASK, data=data, is_extended_id=is_extended))

    def read_frames(self) -> list[Frame]:
        """As FramePort."""
        frames = []
        while (message := self._bus.recv(timeout=0)) is not None:
            frames.append(frame_of(message))
        return frames


def frame_of(message: can.Message) -> Frame:
    """A message as a frame."""
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(flagged_identifier(message), data, round(message.timestamp * NS_PER_S))
