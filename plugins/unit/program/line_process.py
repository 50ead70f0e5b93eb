"""A process that is spoken to in lines, and never waited for without a limit."""

import logging
import os
import select
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO

from robrain.agent.isolation.process_group import ProcessGroup

logger = logging.getLogger(__name__)

WAITING_LINES = 256
END_TIMEOUT_S = 1.0
"""A program that was asked to end is killed after this."""
STDERR_LINES_A_SECOND = 100
"""What a program says to stderr beyond this is counted, not logged."""


class LineProcess:
    """One run of a program.

    Args:
        plugin: whose it is, for the log.
        command: program and arguments.
        folder: where it runs; here if None.
        environment: variables beside those of this process.
        max_line_bytes: longer lines are left out.
        on_line: told of each line that it says, on a thread of the process's own; False if it is to be left out.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(
        self,
        plugin: str,
        command: Sequence[str],
        folder: Path | None,
        environment: Mapping[str, str],
        max_line_bytes: int,
        on_line: Callable[[str], bool],
    ) -> None:
        self.lines = 0
        self.left_out = 0
        self.started_s = time.monotonic()
        self._plugin = plugin
        self._max_line_bytes = max_line_bytes
        self._on_line = on_line
        self._said: deque[str] = deque(maxlen=WAITING_LINES)
        self._change = threading.Condition()
        self.is_silent = False
        """Whether it has closed its output, so that it will say no more."""
        self._group = ProcessGroup(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            folder=folder,
            environment={**os.environ, **environment},
        )
        process = self._group.process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        self._stdin = process.stdin.fileno()
        os.set_blocking(self._stdin, False)
        self._threads = [
            threading.Thread(target=read, args=(stream,), name=f"{name}-{plugin}", daemon=True)
            for name, read, stream in (
                ("stdout", self._read_stdout, process.stdout),
                ("stderr", self._read_stderr, process.stderr),
            )
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._group.process.pid

    @property
    def status(self) -> int | None:
        """None while it runs, else as in subprocess."""
        return self._group.status

    def write(self, line: str, limit_s: float) -> bool:
        """Give it a line; False if it does not take it in time.

        Raises:
            OSError: it does not listen any more.

        """
        left = memoryview(f"{line}\n".encode())
        deadline_s = time.monotonic() + limit_s
        while left:
            ready = select.select([], [self._stdin], [], max(deadline_s - time.monotonic(), 0.0))[1]
            if not ready:
                return False
            left = left[os.write(self._stdin, left) :]
        return True

    def forget(self) -> None:
        """Lines that it has said so far answer nothing."""
        with self._change:
            self._said.clear()

    def next_line(self, limit_s: float) -> str | None:
        """The next line that it says; None if none comes in time, or none will come any more."""
        with self._change:
            self._change.wait_for(lambda: bool(self._said) or self.is_silent, limit_s)
            return self._said.popleft() if self._said else None

    def end(self) -> None:
        """Ask it to end, see that it does, with all that it has started, and give everything back."""
        self._group.ask_to_end()
        self._group.wait(END_TIMEOUT_S)
        self.kill()
        for thread in self._threads:
            # Something that left the group may hold the other end open: its thread is left behind, and closes then.
            thread.join(END_TIMEOUT_S)
        if self._group.process.stdin is not None:
            self._group.process.stdin.close()

    def ends_within(self, timeout_s: float) -> bool:
        """Whether it has ended by then."""
        return self._group.wait(timeout_s)

    def kill(self) -> None:
        """End it at once, with all that it has started."""
        self._group.kill()

    def _read_stdout(self, stream: IO[bytes]) -> None:
        try:
            with stream:
                for line in self._lines(stream):
                    self.lines += 1
                    if not self._on_line(line):
                        self.left_out += 1
                        continue
                    with self._change:
                        self._said.append(line)
                        self._change.notify_all()
        finally:
            with self._change:
                self.is_silent = True
                self._change.notify_all()

    def _read_stderr(self, stream: IO[bytes]) -> None:
        second, count = 0, 0
        with stream:
            for line in self._lines(stream):
                now = int(time.monotonic())
                if now != second:
                    self._note_kept_back(count)
                    second, count = now, 0
                count += 1
                if count <= STDERR_LINES_A_SECOND:
                    logger.info("%s: %s", self._plugin, line)
        self._note_kept_back(count)

    def _note_kept_back(self, count: int) -> None:
        kept_back = count - STDERR_LINES_A_SECOND
        if kept_back > 0:
            logger.warning("%s: %d more lines on stderr were not logged", self._plugin, kept_back)

    def _lines(self, stream: IO[bytes]) -> "Lines":
        return Lines(stream.fileno(), self._max_line_bytes, self._note_too_long)

    def _note_too_long(self) -> None:
        self.left_out += 1
        logger.warning("%s: ignored a line of more than %d bytes", self._plugin, self._max_line_bytes)


class Lines:
    """Iterates over the lines of a file descriptor; never holds more than one line of the greatest length.

    Args:
        number: the file descriptor.
        max_bytes: of one line.
        on_too_long: told of each line that is longer, and left out.

    """

    def __init__(self, number: int, max_bytes: int, on_too_long: Callable[[], None]) -> None:
        self._number = number
        self._max_bytes = max_bytes
        self._on_too_long = on_too_long
        self._waiting: deque[bytes] = deque()
        self._begun = bytearray()
        self._is_too_long = False

    def __iter__(self) -> "Lines":
        return self

    def __next__(self) -> str:
        while not self._waiting:
            received = os.read(self._number, max(self._max_bytes, 1))
            if not received:
                if not self._begun:
                    raise StopIteration
                received = b"\n"  # the last line need not end with a line's end
            self._take(received)
        return self._waiting.popleft().decode(errors="replace")

    def _take(self, received: bytes) -> None:
        *whole, rest = received.split(b"\n")
        for part in whole:
            self._begin(part)
            if not self._is_too_long:
                self._waiting.append(bytes(self._begun).removesuffix(b"\r"))
            self._begun.clear()
            self._is_too_long = False
        self._begin(rest)

    def _begin(self, part: bytes) -> None:
        if self._is_too_long:
            return
        self._begun += part
        if len(self._begun) > self._max_bytes:
            self._begun.clear()
            self._is_too_long = True
            self._on_too_long()
