"""Standard streams of a command: output that cannot be written ends the command with one sentence."""

import _thread
import errno
import io
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

EXIT_OUTPUT = 1
STDIN, STDOUT, STDERR = range(3)


class _Output(io.FileIO):
    """Standard output; the first failure to write ends the command, and what is written afterwards is discarded."""

    has_failed = False

    def write(self, data: "bytes | bytearray | memoryview") -> int:  # type: ignore[override]
        try:
            return super().write(data)
        except OSError as error:
            self.has_failed = True
            reason = "it is closed" if error.errno == errno.EBADF else error.strerror
            sys.stderr.write(f"robrain: the output cannot be written: {reason}\n")
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, STDOUT)
            os.close(null)
            if threading.current_thread() is threading.main_thread():
                raise SystemExit(EXIT_OUTPUT) from error
            _thread.interrupt_main()
            return len(data)


class _Messages(io.FileIO):
    """Standard error; a command continues without messages that cannot be written."""

    def write(self, data: "bytes | bytearray | memoryview") -> int:  # type: ignore[override]
        try:
            return super().write(data)
        except OSError:
            return len(data)


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Guard the standard streams of this process, closed ones as well, unless they are captured.

    Raises SystemExit at the end of the block if the output could not be written at any time.
    """
    for number, mode in ((STDIN, os.O_RDONLY), (STDOUT, os.O_RDONLY), (STDERR, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # gets the lowest free number, so that no other file gets it later
    if sys.stdin is None:
        sys.stdin = open(STDIN, encoding="utf-8", closefd=False)  # noqa: SIM115 - until the process ends
    if sys.stderr is sys.__stderr__:
        sys.stderr = _text(_Messages(STDERR, "w", closefd=False), sys.stderr)
    if sys.stdout is not sys.__stdout__:
        yield
        return
    output = _Output(STDOUT, "w", closefd=False)
    sys.stdout = _text(output, sys.stdout)
    try:
        yield
    finally:
        sys.stdout.flush()
        if output.has_failed:
            raise SystemExit(EXIT_OUTPUT)


def _text(raw: io.FileIO, before: TextIO | None) -> TextIO:
    encoding = before.encoding if before is not None else "utf-8"
    # File names that are not UTF-8 are printed as they are; other encodings may lack characters of the program's texts.
    errors = "surrogateescape" if isinstance(raw, _Output) and encoding == "utf-8" else "backslashreplace"
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors, line_buffering=True)
