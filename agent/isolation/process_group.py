"""A process with all that it starts: they end together, and leave no zombie."""

import os
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path


class ProcessGroup:
    """A process in a separate session.

    Args:
        command: program and arguments.
        stdin, stdout, stderr: as subprocess takes them.
        folder: where it runs; here if None.
        environment: all of its environment; this process's if None.
        keep: file descriptors that it inherits.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        stdin: int = subprocess.DEVNULL,
        stdout: int | None = None,
        stderr: int | None = None,
        folder: Path | None = None,
        environment: Mapping[str, str] | None = None,
        keep: Sequence[int] = (),
    ) -> None:
        self.process = subprocess.Popen(
            command,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            cwd=folder,
            env=environment,
            pass_fds=tuple(keep),
            start_new_session=True,
            bufsize=0,
        )
        self._lock = threading.Lock()
        self._is_over = False

    @property
    def status(self) -> int | None:
        """None while it runs, else as in subprocess: negative for the signal that ended it."""
        return self.process.poll()

    def wait(self, timeout_s: float) -> bool:
        """Whether it ends in time."""
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def ask_to_end(self) -> None:
        """Send SIGTERM to the process and all that it has started."""
        self._signal(signal.SIGTERM)

    def kill(self) -> None:
        """End the process and all that it has started, at once."""
        with self._lock:
            if not self._is_over:
                self._signal(signal.SIGKILL)
                self.process.wait()
                self._is_over = True

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):  # every process of the group has already ended
            os.killpg(self.process.pid, number)


def how_it_ended(status: int) -> str:
    """An exit status in words.

    >>> how_it_ended(-6), how_it_ended(3)
    ('was ended by SIGABRT', 'has ended with status 3')
    """
    if status >= 0:
        return f"has ended with status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"
