"""The line between a simulated robot's nodes and its on-board computer; it can be cut and shorted, and be slow.

The error counters are those of ISO 11898-1 (fault confinement): eight for a frame that could not be sent, one back for
one that was. A sender that nobody acknowledges becomes error passive and stays so (the exception for acknowledgement
errors); on a shorted line it goes bus off. A frame is repeated at once until it is through. Thus either change of state
takes a controller less than a millisecond; here it happens with the first frame.
"""

from collections.abc import Callable
from enum import StrEnum

import can

from robrain.protocol.can.bus_state import BUS_OFF_ERRORS, PASSIVE_ERRORS, BusState, error_frame
from robrain.protocol.can.frame_port import Frame, frame_port
from robrain.protocol.clock import Clock
from robrain.sim.firmware.disturbance import DelayLine


class LineFault(StrEnum):
    """Fault of the line."""

    NONE = "none"
    CUT = "cut"
    """Nothing passes; the driver gets no error."""
    SHORTED = "shorted"
    """Nothing passes; every controller goes bus off, and the host's controller reports it to its driver."""


class FrameStamps:
    """Clock for the stamps of a line's frames: the current time or, for a late frame, the time at which it was sent.

    Args:
        clock: the run's clock.
        stamps_sending: whether late frames are stamped with their time of sending.

    """

    def __init__(self, clock: Clock, *, stamps_sending: bool) -> None:
        self._clock = clock
        self._stamps_sending = stamps_sending
        self._sent_ns: int | None = None

    def now_ns(self) -> int:
        """Stamp of the next frame."""
        return self._clock.now_ns() if self._sent_ns is None else self._sent_ns

    def record_sent(self, sent_ns: int | None) -> None:
        """Set the time of sending of the next frames; None for the current time."""
        self._sent_ns = sent_ns if self._stamps_sending else None


class BusLine(can.BusABC):
    """All nodes of one robot, seen from its on-board computer; a `FramePort` as well as a bus of python-can.

    Args:
        bus: bus of the frames; shut down with the line.
        late: delays the nodes' frames; None for no delay.
        stamps: gets the time of sending of late frames.

    """

    wakes = False

    def __init__(
        self, bus: can.BusABC, late: DelayLine[can.Message] | None = None, stamps: FrameStamps | None = None
    ) -> None:
        self.fault = LineFault.NONE
        self.transmit_errors = 0
        self.channel_info = bus.channel_info
        self._bus = bus
        self._port = frame_port(bus)
        self.pending = self._port.pending
        self.on_frame: Callable[[], None] | None = None
        self._late = late
        self._stamps = stamps
        super().__init__(channel=bus.channel_info)

    def break_down(self, fault: LineFault) -> None:
        """Cut or short the line, or repair it."""
        before, self.fault = self.fault, fault
        if fault is LineFault.SHORTED:
            self._bus.send(error_frame(BusState.OFF))
        elif before is LineFault.SHORTED:
            self._bus.send(error_frame(BusState.ACTIVE))
            # A controller that returns from bus off starts at 0.
            self.transmit_errors = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send, if the line is whole."""
        if self.fault is LineFault.NONE:
            if self.transmit_errors:
                self.transmit_errors -= 1
            if self._late is None:
                self._bus.send(msg, timeout)
            else:
                self._late.put(msg)
        else:
            self.transmit_errors = PASSIVE_ERRORS if self.fault is LineFault.CUT else BUS_OFF_ERRORS

    def send_data(self, identifier: int, data: bytes) -> None:
        """As `send`, for a data frame with an identifier of 11 bits."""
        if self.fault is LineFault.NONE and self._late is None and not self.transmit_errors:
            self._port.send_data(identifier, data)
        else:
            self.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def deliver(self) -> None:
        """Pass on the late frames that have arrived by now; a broken line loses them."""
        for sent_ns, frame in self._late.arrivals() if self._late is not None else ():
            if self.fault is not LineFault.NONE:
                continue
            if self._stamps is not None:
                self._stamps.record_sent(sent_ns)
            self._bus.send(frame)
        if self._stamps is not None:
            self._stamps.record_sent(None)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; frames sent while the line was broken are lost."""
        frame = self._bus.recv(timeout)
        while frame is not None and self.fault is not LineFault.NONE:
            frame = self._bus.recv(0)
        return frame

    def read_frames(self) -> list[Frame]:
        """All frames that have arrived; frames sent while the line was broken are lost."""
        frames = self._port.read_frames()
        return frames if self.fault is LineFault.NONE else []

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        self._bus.shutdown()
