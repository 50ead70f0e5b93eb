"""A serial device on a pseudo terminal, behind a path that stays the same while it is unplugged and plugged in."""

import os
import tty
from pathlib import Path


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
        """Be gone: whoever has the near end open is told so by the kernel."""
        self.path.unlink(missing_ok=True)
        if self._far is not None:
            os.close(self._far)
            self._far = None

    def send(self, data: bytes) -> int:
        """Send as much as the line takes at once; the number of bytes (OSError if it is not plugged in)."""
        if self._far is None:
            raise OSError(f"{self.path} is not plugged in")
        try:
            return os.write(self._far, data)
        except BlockingIOError:
            return 0

    def receive(self, most: int = 4096) -> bytes:
        """What the near end has sent; empty if there is nothing, or no near end."""
        try:
            return os.read(self._far, most) if self._far is not None else b""
        except OSError:  # nothing is there, or the near end is closed
            return b""
