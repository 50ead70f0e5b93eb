"""A serial line of a simulated robot as a pseudo terminal, so that a real driver opens it in a live arena."""

from pathlib import Path

from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ARENA_SERIAL, ARENA_SERIAL_TX
from robrain.sim.peripherals.serial_plug import SerialPlug


class LinePlug:
    """One robot's; its owner calls `step()` often.

    Args:
        endpoint: where the bytes come from.
        robot: whose hardware.
        line: its name, such as `lidar`.
        path: by which the line is opened; a link to the pseudo terminal.

    Raises:
        OSError: there are no pseudo terminals, or the path is taken by something else.

    """

    def __init__(self, endpoint: Endpoint, robot: str, line: str, path: Path) -> None:
        self.robot, self.line, self.path = robot, line, path
        self.lost_bytes = 0
        """Bytes that nobody has read in time."""
        self._inbox = Inbox(capacity=64)
        self._plug = SerialPlug(path)
        endpoint.subscribe(self._inbox, ARENA_SERIAL, robot=robot, line=line)
        self._sent = endpoint.publisher(ARENA_SERIAL_TX, robot=robot, line=line)

    def step(self) -> None:
        """Pass on what has been sent, both ways."""
        if data := self._plug.receive():
            self._sent.put_bytes(data)
        for _, _, data in self._inbox.drain_raw() if self._inbox.has_some else ():
            self.lost_bytes += len(data) - self._plug.send(data)

    def close(self) -> None:
        """Pull it out."""
        self._plug.pull_out()
