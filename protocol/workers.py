"""Threads and child processes of robrain: each has an owner that closes it."""

import fcntl
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVarTuple

logger = logging.getLogger(__name__)

Ts = TypeVarTuple("Ts")


class OwnedThread:
    """Runs a function on a daemon thread, from now on.

    Args:
        name: the thread's name.
        function: its error is logged, and kept.
        arguments: of the function.

    """

    def __init__(self, name: str, function: Callable[[*Ts], object], *arguments: *Ts) -> None:
        self.name = name
        self.error: BaseException | None = None
        """The error of the function."""
        self._thread = threading.Thread(target=self._run, args=(function, *arguments), name=name, daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the function runs."""
        return self._thread.is_alive()

    @property
    def is_current(self) -> bool:
        """Whether the caller is on this thread."""
        return self._thread is threading.current_thread()

    def close(self, timeout_s: float | None = None) -> bool:
        """Wait for the function's end, unless the caller is on this thread.

        Returns:
            Whether the function has ended. A thread that hangs is reported in the log, and abandoned.

        """
        if self.is_current:
            return False
        self._thread.join(timeout_s)
        if self.is_alive:
            logger.warning("the thread %s does not end, and is abandoned", self.name)
        return not self.is_alive

    def _run(self, function: Callable[[*Ts], object], *arguments: *Ts) -> None:
        try:
            function(*arguments)
        except BaseException as error:  # no caller receives it
            self.error = error
            logger.exception("the thread %s has failed", self.name)


def close_threads(threads: Iterable[OwnedThread], timeout_s: float) -> None:
    """Close several threads within one time limit."""
    deadline_s = time.monotonic() + timeout_s
    for thread in threads:
        thread.close(max(deadline_s - time.monotonic(), 0.0))


END_S = 5.0
"""A process that was asked to end is killed after this."""
KILLED_S = 5.0
"""A killed process that is there for longer waits for a disk, perhaps for ever."""


class ProcessGroup:
    """A process in a separate session: a Ctrl-C in the terminal does not reach it.

    Args:
        command: program and arguments.
        stdin, stdout, stderr: as subprocess takes them.
        folder: where it runs; here if None.
        environment: variables beside those of this process.
        keep: file descriptors that it inherits.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(
        self,
        command: Sequence[str | Path],
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
            env={**os.environ, **(environment or {})},
            pass_fds=keep,
            start_new_session=True,
        )
        self._lock = threading.Lock()
        self._is_over = False

    @property
    def pid(self) -> int:
        """Its process id."""
        return self.process.pid

    @property
    def status(self) -> int | None:
        """None while it runs, else as in subprocess: negative for the signal that ended it."""
        return self.process.poll()

    def ends_within(self, timeout_s: float) -> bool:
        """Wait for its end; whether it ends in time."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout_s)
        return self.status is not None

    def end_input(self) -> None:
        """Close its input, if that is a pipe."""
        if self.process.stdin is not None:
            with suppress(OSError):
                self.process.stdin.close()

    def ask_to_end(self) -> None:
        """Send SIGTERM to the process and all that it has started."""
        self._signal(signal.SIGTERM)

    def end(self, timeout_s: float = END_S) -> None:
        """Close its input and wait for its end; then kill what is left of it and of all that it has started."""
        self.end_input()
        self.ends_within(timeout_s)
        self.kill()

    def kill(self, timeout_s: float = KILLED_S) -> None:
        """Kill the process and all that it has started, and wait for its end."""
        with self._lock:
            if not self._is_over:
                self._signal(signal.SIGKILL)
                self._is_over = self.ends_within(timeout_s)

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):  # every process of the group has already ended
            os.killpg(self.pid, number)


class WorkerProcess(ProcessGroup):
    """A process of this Python with sockets to it; it ends with this one, and calls `end_with_parent` for that.

    Args:
        module: its program. The last arguments are the file descriptors of its sockets, and of its lifeline.
        arguments: those before.
        sockets: number of connections; the caller closes this end of each.
        stdout: as subprocess takes it.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(self, module: str, arguments: Sequence[str], sockets: int, stdout: int) -> None:
        pairs = [socket.socketpair() for _ in range(sockets)]
        self.sockets = [ours for ours, _ in pairs]
        lifeline, self._lifeline = os.pipe()
        theirs = [*(other.fileno() for _, other in pairs), lifeline]
        try:
            super().__init__([sys.executable, "-m", module, *arguments, *map(str, theirs)], stdout=stdout, keep=theirs)
        except BaseException:  # also Ctrl-C: the open ends must not leak
            os.close(self._lifeline)
            for ours in self.sockets:
                ours.close()
            raise
        finally:
            os.close(lifeline)
            for _, other in pairs:
                other.close()

    def kill(self, timeout_s: float = KILLED_S) -> None:
        """As a process group; its lifeline is cut."""
        super().kill(timeout_s)
        with self._lock:
            lifeline, self._lifeline = self._lifeline, -1
            if lifeline >= 0:
                os.close(lifeline)


def end_with_parent(lifeline: int) -> None:
    """Have the kernel kill this process, even a stopped one, when the parent's end of the pipe is closed."""
    fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
    fcntl.fcntl(lifeline, fcntl.F_SETFL, os.O_ASYNC | os.O_NONBLOCK)
    try:
        os.read(lifeline, 1)
    except BlockingIOError:
        return
    sys.exit(0)  # it was closed before


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
