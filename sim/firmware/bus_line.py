"""The line between a simulated robot's nodes and its on-board computer; it can be cut and shorted.

The error counters are those of ISO 11898-1 (fault confinement): eight for a frame that could not be sent, one back for
one that was. A sender that nobody acknowledges becomes error passive and stays so (the exception for acknowledgement
errors); on a shorted line it goes bus off. A frame is repeated at once until it is through, so that either takes a
controller less than a millisecond: here it happens with the first frame.
"""

from enum import StrEnum

import can

from robrain.protocol.can.bus_state import BUS_OFF_ERRORS, PASSIVE_ERRORS, BusState, error_frame, state_of

ERRORS_A_FAILURE = 8


class LineFault(StrEnum):
    """What has happened to the line."""

    NONE = "none"
    CUT = "cut"
    """Nothing passes; nobody is told."""
    SHORTED = "shorted"
    """Nothing passes; every controller goes bus off, and the host's tells its driver so."""


class BusLine(can.BusABC):
    """All nodes of one robot, seen from its on-board computer.

    Args:
        bus: what carries the frames; shut down with the line.

    """

    def __init__(self, bus: can.BusABC) -> None:
        self.fault = LineFault.NONE
        self.transmit_errors = 0
        self.channel_info = bus.channel_info
        self._bus = bus
        super().__init__(channel=bus.channel_info)

    @property
    def node_state(self) -> BusState:
        """State of the nodes' CAN controllers."""
        return state_of(self.transmit_errors, 0)

    def break_down(self, fault: LineFault) -> None:
        """Cut or short the line, or repair it."""
        before, self.fault = self.fault, fault
        if fault is LineFault.SHORTED:
            self._bus.send(error_frame(BusState.OFF))
        elif before is LineFault.SHORTED:
            self._bus.send(error_frame(BusState.ACTIVE))
            # Whoever comes back from bus off starts at nothing.
            self.transmit_errors = 0

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send, if the line is whole."""
        if self.fault is LineFault.NONE:
            if self.transmit_errors:
                self.transmit_errors -= 1
            self._bus.send(msg, timeout)
        else:
            self.transmit_errors = PASSIVE_ERRORS if self.fault is LineFault.CUT else BUS_OFF_ERRORS

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame; what was sent while the line was broken is lost."""
        frame = self._bus.recv(timeout)
        while frame is not None and self.fault is not LineFault.NONE:
            frame = self._bus.recv(0)
        return frame

    def shutdown(self) -> None:
        """Leave the bus."""
        super().shutdown()
        self._bus.shutdown()
