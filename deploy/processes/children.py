"""Child processes: started with their parent's endpoint, and stopped with their parent."""

import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import IO, Self

from robrain.deploy.processes.lifeline import LIFELINE_VARIABLE, LifelineEnd
from robrain.deploy.processes.live_process import PARENT_VARIABLE

STOP_TIMEOUT_S = 5.0
KEPT_LINES = 200


class Child:
    """One `robrain` process.

    Its last 200 lines of output are kept; each line is passed to `on_line`.

    Args:
        name: its name in messages.
        arguments: the command line after `robrain`.
        on_line: called with each line, on a thread of the child's own.
        lifeline: a new one, whose other end the child gets; closed with the child's end. None for a child that is not
            supervised.

    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        on_line: Callable[[str], None] | None = None,
        lifeline: LifelineEnd | None = None,
    ) -> None:
        self.name = name
        passed = {} if lifeline is None else {LIFELINE_VARIABLE: str(lifeline.pass_on)}
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._on_line = on_line
        self._process = subprocess.Popen(
            [sys.executable, "-m", "robrain.cli", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env={**os.environ, PARENT_VARIABLE: str(os.getpid()), "PYTHONUNBUFFERED": "1", **passed},
            pass_fds=() if lifeline is None else (lifeline.pass_on,),
            start_new_session=True,  # a Ctrl-C in the terminal reaches the parent, which stops the children in order
        )
        if lifeline is not None:
            lifeline.passed()
        assert self._process.stdout is not None
        self._reader = threading.Thread(
            target=self._read, args=(self._process.stdout,), name=f"output-{name}", daemon=True
        )
        self._reader.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def exit_status(self) -> int | None:
        """None while it runs."""
        return self._process.poll()

    def ask_to_stop(self) -> None:
        """Send it SIGTERM, if it still runs."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it and what it has started, at once, even if it is stopped."""
        if self._process.poll() is None:
            self.kill_group()

    def kill_group(self) -> None:
        """End what is left of its process group, in which are the processes that it started."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)

    def wait(self, timeout_s: float = STOP_TIMEOUT_S) -> int:
        """Wait for its end; kill it if it does not end in time."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.kill_group()
            with suppress(subprocess.TimeoutExpired):  # one that waits for a disk for ever cannot be killed
                self._process.wait(STOP_TIMEOUT_S)
        self._reader.join(STOP_TIMEOUT_S)
        status = self._process.returncode
        return -signal.SIGKILL if status is None else status

    def _read(self, stream: IO[str]) -> None:
        with stream:
            for line in stream:
                self.lines.append(line.rstrip("\n"))
                if self._on_line is not None:
                    self._on_line(line.rstrip("\n"))


class Children:
    """All children of a process; leaving the `with` block stops them, the last started first."""

    def __init__(self) -> None:
        self.all: list[Child] = []

    def start(self, name: str, arguments: Sequence[str], on_line: Callable[[str], None] | None = None) -> Child:
        """Start another child."""
        child = Child(name, arguments, on_line)
        self.all.append(child)
        return child

    def stop(self) -> None:
        """Ask all children to stop, and wait for them."""
        for child in reversed(self.all):
            child.ask_to_stop()
        for child in reversed(self.all):
            child.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()
