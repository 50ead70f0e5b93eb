"""First setup of each process: its logs, its standard streams, and the threads of native libraries."""

import _thread
import ctypes
import errno
import io
import logging
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TextIO

import msgspec

from robrain.deploy.errors import UsageError
from robrain.protocol.safe_text import safe_json, safe_lines

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Their matrices are small: a pool for each costs memory and wakes processors without need."""
ONE_LINK = "(rx: (worker_threads: 1))"
"""Zenoh's runtime for a process with one link, such as an agent; by default two threads receive."""
M_ARENA_MAX, ARENAS = -8, 2
"""Option of glibc's `mallopt`: by default threads share eight heaps a core, which keep most of their freed memory.
Measured: 118 of the 261 MB of an agent that had run for half an hour."""


def limit_native_threads() -> None:
    """One thread for each native library, few heaps for all threads; the user's settings stay.

    The first holds in processes that this one starts too.
    """
    for name in ONE_THREAD:
        os.environ.setdefault(name, "1")
    if "MALLOC_ARENA_MAX" not in os.environ and hasattr(ctypes.CDLL(None), "mallopt"):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, ARENAS)


def limit_zenoh_threads() -> None:
    """One receiving thread for the sessions of this process; the user's settings stay."""
    os.environ.setdefault("ZENOH_RUNTIME", ONE_LINK)


FORMAT_VARIABLE = "ROBRAIN_LOG_FORMAT"
OPTION = "--log-format"
FORMATS = ("text", "json")
TEXT = "%(levelname)s %(name)s: %(message)s"


class LogContext:
    """Subject of a process's records."""

    def __init__(self) -> None:
        self.robot = ""
        """Name of the robot whose process it is; empty for other processes."""
        self.plugin: Callable[[], str] = str
        """Name of the plugin whose code runs on the calling thread; empty if none."""
        self.task: Callable[[], str] = str
        """Id of the task that the robot is at; empty if none."""


CONTEXT = LogContext()
"""The context of this process."""


class JsonLines(logging.Formatter):
    """Formats each record as one JSON object on one line.

    Args:
        context: of the process.

    """

    def __init__(self, context: LogContext) -> None:
        super().__init__()
        self._context = context

    def format(self, record: logging.LogRecord) -> str:
        """The line, without a line break."""
        fields: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "robot": self._context.robot,
            "plugin": getattr(record, "plugin", "") or self._context.plugin(),
            "task": self._context.task(),
            "process": record.process,
        }
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return safe_json(msgspec.json.encode({name: value for name, value in fields.items() if value != ""}))


class SafeLines(logging.Formatter):
    """Formats a record for a terminal, with indented lines after the first: a message cannot pass for two."""

    def format(self, record: logging.LogRecord) -> str:
        """The line and the traceback."""
        return safe_lines(super().format(record), "  ")


def set_up_logs(words: list[str]) -> list[str]:
    """Set up the logs of this process by `--log-format` before a command, or the environment.

    Args:
        words: the command line, without the program's name.

    Returns:
        The words without the option.

    Raises:
        UsageError: there is no such format.

    """
    chosen, rest = os.environ.get(FORMAT_VARIABLE, "") or "text", words
    if words[:1] == [OPTION]:
        chosen, rest = (words[1] if len(words) > 1 else ""), words[2:]
    elif words and words[0].startswith(f"{OPTION}="):
        chosen, rest = words[0].partition("=")[2], words[1:]
    if chosen not in FORMATS:
        raise UsageError(f"{OPTION} {chosen}: expected {' or '.join(FORMATS)}")
    os.environ[FORMAT_VARIABLE] = chosen  # processes that this one starts do the same
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines(CONTEXT) if chosen == "json" else SafeLines(TEXT))
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns of a cache that it cannot write, and works
    return rest


EXIT_OUTPUT = 1
STDIN, STDOUT, STDERR = range(3)


class _Output(io.FileIO):
    """Standard output; the first failure to write ends the command, and later output is discarded."""

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
