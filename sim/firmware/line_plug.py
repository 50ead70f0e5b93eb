"""A serial line of a simulated robot as a pseudo terminal, so that a real driver opens it in a live arena."""

import os
import tty
from pathlib import Path

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_SERIAL, ARENA_SERIAL_TX
from robrain.protocol.wire.endpoint import Endpoint


class SerialPlug:
    """The far end of a serial line.

    Args:
        path: by which the near end is opened; a link to the pseudo terminal.

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._far: int | None = None
        self.plug_in()

    def plug_in(self) -> None:
        """Be there (OSError if there are no pseudo terminals)."""
        self.pull_out()
        far, near = os.openpty()
        tty.setraw(near)
        self.path.symlink_to(os.ttyname(near))
        os.close(near)
        os.set_blocking(far, False)
        self._far = far

    def pull_out(self) -> None:
        """Remove the line: the kernel reports it to the process that has the near end open."""
        self.path.unlink(missing_ok=True)
        if self._far is not None:
            os.close(self._far)
            self._far = None

    def send(self, data: bytes) -> int:
        """Send as many bytes as the line accepts at once; the number of bytes (OSError if it is not plugged in)."""
        if self._far is None:
            raise OSError(f"{self.path} is not plugged in")
        try:
            return os.write(self._far, data)
        except BlockingIOError:
            return 0

    def receive(self, most: int = 4096) -> bytes:
        """Bytes that the near end has sent; empty if there are none, or no near end."""
        try:
            return os.read(self._far, most) if self._far is not None else b""
        except OSError:  # nothing is there, or the near end is closed
            return b""


class LinePlug:
    """One robot's; its owner calls `step()` often.

    Args:
        endpoint: source of the bytes.
        robot: robot whose hardware it is.
        line: its name, such as `lidar`.
        path: by which the line is opened; a link to the pseudo terminal.

    Raises:
        OSError: there are no pseudo terminals, or the path exists already.

    """

    def __init__(self, endpoint: Endpoint, robot: str, line: str, path: Path) -> None:
        self.robot, self.line, self.path = robot, line, path
        self.lost_bytes = 0
        """Bytes that were not read in time."""
        self._inbox = Inbox(capacity=64)
        self._plug = SerialPlug(path)
        endpoint.subscribe(self._inbox, ARENA_SERIAL, robot=robot, line=line)
        self._sent = endpoint.publisher(ARENA_SERIAL_TX, robot=robot, line=line)

    def step(self) -> None:
        """Forward sent bytes, in both directions."""
        if data := self._plug.receive():
            self._sent.put_bytes(data)
        for _, _, data in self._inbox.drain_raw() if self._inbox.has_some else ():
            self.lost_bytes += len(data) - self._plug.send(data)

    def close(self) -> None:
        """Pull it out."""
        self._plug.pull_out()
