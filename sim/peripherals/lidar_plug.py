"""The serial line of a simulated lidar as a pseudo terminal, so that a real driver reads it in a live arena."""

from pathlib import Path

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ARENA_SERIAL
from robrain.sim.firmware.lidar_line import LINE
from robrain.sim.peripherals.serial_plug import SerialPlug


class LidarPlug:
    """One robot's; its owner calls `step()` often.

    Args:
        endpoint: where the bytes come from.
        robot: whose lidar.
        path: by which the line is opened; a link to the pseudo terminal.

    Raises:
        OSError: there are no pseudo terminals, or the path is taken by something else.

    """

    def __init__(self, endpoint: Endpoint, robot: str, path: Path) -> None:
        self.robot, self.path = robot, path
        self.lost_bytes = 0
        """Bytes that nobody has read in time."""
        self._inbox = Inbox(capacity=64)
        self._plug = SerialPlug(path)
        endpoint.subscribe(self._inbox, ARENA_SERIAL, robot=robot, line=LINE)

    def step(self) -> None:
        """Pass on what the lidar has sent."""
        self._plug.receive()  # what it is sent does not matter: it measures anyway
        for _, _, data in self._inbox.drain_raw() if self._inbox.has_some else ():
            self.lost_bytes += len(data) - self._plug.send(data)

    def close(self) -> None:
        """Pull it out."""
        self._plug.pull_out()
