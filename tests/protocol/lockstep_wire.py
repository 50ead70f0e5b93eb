"""Two components of a lockstep run, side by side."""

from robrain.protocol.clock import VirtualClock
from robrain.protocol.wire.endpoint import Drive, Endpoint


class Wire:
    """Two components on one session, and what came from outside."""

    def __init__(self, session):
        self.session = session
        self.clock = VirtualClock()
        self.outside = []
        self.robot = Endpoint(session, "t", self.clock, Drive.LOCKSTEP, on_outside=self._record)
        self.other = Endpoint(session, "t", self.clock, Drive.LOCKSTEP)

    def _record(self, key, payload):
        self.outside.append((key, payload))

    def close(self):
        self.robot.close()
        self.other.close()
