"""Program: wraps any executable by its manifest alone.

A manifest of your own, `NAME.toml`, with

    [plugin]
    class = "robrain.plugins.unit.program:Program"

    [parameters]
    command = ["bc", "--quiet"]

makes it the plugin NAME: `robrain call ROBOT NAME send '"1+2"'`, or from a plugin of a higher level
`env.use("NAME", ProgramInterface).send("1+2")`. Each manifest makes one program. A program that fails is a fault of
its plugin; with `restart = "on-failure"` in [tag] it is started again.
"""

import logging
import os
import select
import shutil
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Literal, Protocol

import msgspec

from robrain.agent.errors import HardwareAbsent, PluginError
from robrain.agent.event import Event
from robrain.agent.plugin import Unit, external
from robrain.protocol.codec import BAD_PAYLOAD
from robrain.protocol.errors import ErrorCode
from robrain.protocol.line_splitter import LineSplitter
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import Positive, PositiveInt
from robrain.protocol.wire.endpoint import Drive
from robrain.protocol.workers import OwnedThread, ProcessGroup, close_threads, how_it_ended

WAITING_LINES = 256
END_TIMEOUT_S = 1.0
"""A program that was asked to end is killed after this."""
STDERR_LINES_A_SECOND = 100
"""Lines that a program writes to stderr beyond this are counted, not logged."""


class LineProcess(ProcessGroup):
    """One run of a program.

    Args:
        plugin: whose it is, for the log.
        wanted: the program, and the limit of its lines.
        on_line: receives each line of the program, on a separate thread of the process; returns False to skip it.

    Raises:
        OSError: it cannot be started.

    """

    def __init__(self, plugin: str, wanted: "Program.Parameters", on_line: Callable[[str], bool]) -> None:
        self.lines = 0
        self.skipped = 0
        self._plugin = plugin
        self._max_line_bytes = wanted.max_line_bytes
        self._on_line = on_line
        self._stated: deque[str] = deque(maxlen=WAITING_LINES)
        self._change = threading.Condition()
        self.is_silent = False
        """Whether it has closed its output, so that no more lines come."""
        super().__init__(
            wanted.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            folder=Path(wanted.folder),
            environment=wanted.environment,
        )
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        self._stdin = process.stdin.fileno()
        os.set_blocking(self._stdin, False)
        self._threads = [
            OwnedThread(f"stdout-{plugin}", self._read_stdout, process.stdout),
            OwnedThread(f"stderr-{plugin}", self._read_stderr, process.stderr),
        ]

    def write(self, line: str, limit_s: float) -> bool:
        """Send it a line; False if it does not accept the line in time.

        Raises:
            OSError: it no longer listens.

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
        """Earlier lines of the program answer nothing."""
        with self._change:
            self._stated.clear()

    def next_line(self, limit_s: float) -> str | None:
        """The next line of the program; None if none comes in time, or the output is closed."""
        with self._change:
            self._change.wait_for(lambda: bool(self._stated) or self.is_silent, limit_s)
            return self._stated.popleft() if self._stated else None

    def end(self, timeout_s: float = END_TIMEOUT_S) -> None:
        """Terminate it and its child processes, and release all resources."""
        self.ask_to_end()
        super().end(timeout_s)
        # Something that left the group may hold the other end open: its thread is abandoned, and closes then.
        close_threads(self._threads, timeout_s)

    def _read_stdout(self, stream: IO[bytes]) -> None:
        try:
            with stream:
                for line in self._lines(stream):
                    self.lines += 1
                    if not self._on_line(line):
                        self.skipped += 1
                        continue
                    with self._change:
                        self._stated.append(line)
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
                    self._report_kept_back(count)
                    second, count = now, 0
                count += 1
                if count <= STDERR_LINES_A_SECOND:
                    logger.info("%s: %s", self._plugin, line)
        self._report_kept_back(count)

    def _report_kept_back(self, count: int) -> None:
        kept_back = count - STDERR_LINES_A_SECOND
        if kept_back > 0:
            logger.warning("%s: %d more lines on stderr were not logged", self._plugin, kept_back)

    def _lines(self, stream: IO[bytes]) -> Iterator[str]:
        splitter = LineSplitter(self._max_line_bytes)
        while received := os.read(stream.fileno(), max(self._max_line_bytes, 1)):
            yield from self._whole(splitter.feed(received))
        if splitter.has_begun:
            yield from self._whole(splitter.feed(b"\n"))  # the last line need not end with a line's end

    def _whole(self, lines: list[bytes | None]) -> Iterator[str]:
        for line in lines:
            if line is not None:
                yield line.decode(errors="replace")
            else:
                self.skipped += 1
                logger.warning("%s: ignored a line of more than %d bytes", self._plugin, self._max_line_bytes)


class ProgramAbsent(HardwareAbsent):
    """There is no such executable; the plugin is omitted as if its hardware were absent."""


class BadLine(PluginError):
    """Text that cannot be sent to the program."""

    code = ErrorCode.BAD_ARGUMENTS


class ProgramEnded(PluginError):
    """The program does not run."""

    code = ErrorCode.INACTIVE


class ProgramLate(PluginError):
    """The program did not answer in time, and was killed."""

    code = ErrorCode.TIMEOUT


class ProgramState(msgspec.Struct, frozen=True, kw_only=True):
    """State of a program."""

    pid: int | None = None
    """None if it does not run."""
    lines: int = 0
    """Lines that it has written."""
    lines_skipped: int = 0
    """Lines that were too long, or no JSON where JSON was expected."""
    why: str = ""
    """Reason of its last end."""


class ProgramInterface(Protocol):
    """Lines in, lines out."""

    printed: Event[str]
    """Each line of the program's standard output, also those that answer a `send`."""

    def send(self, text: str) -> str:
        """Give the program one line and return the next line that it writes."""

    def write_line(self, text: str) -> None:
        """Give the program one line; its lines come as `printed`."""

    def state(self) -> ProgramState:
        """State of the program."""


logger = logging.getLogger(__name__)

Form = Literal["lines", "json"]

A_MOMENT_S = 0.1
"""Time between a program's last output and its end."""
SILENT_S = 2.0
"""The same for one that has closed its output, and so is ending: on a busy machine that takes its time."""


class Program(Unit):
    """Runs a program and exchanges lines with it, over its standard input and output."""

    class Parameters(Checked, frozen=True, forbid_unknown_fields=True):
        """Lines are UTF-8.

        With `json` each line is a JSON document, and other lines are refused or skipped.
        """

        command: list[str]
        input: Form = "lines"
        output: Form = "lines"
        time_limit_s: Positive = 2.0
        """A program that takes longer to answer is killed: its next line would count as the wrong answer."""
        folder: str = ""
        """Working directory; relative to that of the robot's agent, which is the default."""
        environment: dict[str, str] = msgspec.field(default_factory=dict)
        """Variables beside those of the robot's agent."""
        max_line_bytes: PositiveInt = 65536
        kill_on_halt: bool = False
        """An emergency halt ends it at once; it is started again after the resume."""

        def __post_init__(self) -> None:
            super().__post_init__()
            if not self.command or not self.command[0]:
                raise ValueError("expected command = [program, arguments …], got nothing")

    interface = ProgramInterface
    printed = Event[str]()
    period_s = 0.1
    parameters: Parameters

    def init(self) -> None:
        if self.env.wire.drive is Drive.LOCKSTEP:
            raise PluginError(self.env.plugin, f"{self.env.plugin}: programs run only in the live drive")
        self._process: LineProcess | None = None
        self._reason = ""
        self._was_halted = False

    def activate(self) -> None:
        folder, program, plugin = Path(self.parameters.folder), self.parameters.command[0], self.env.plugin
        if not folder.is_dir():
            raise ProgramAbsent(plugin, f"no folder {folder}: correct [parameters] folder")
        if shutil.which(folder.absolute() / program if os.sep in program else program) is None:
            what = f"no executable {program}: install it, or correct [parameters] command of {plugin}"
            raise ProgramAbsent(plugin, what)
        self._start()

    def step(self) -> None:
        process = self._process
        if process is not None and process.status is not None:
            self._ended(process.status)

    def deactivate(self) -> None:
        self._end()

    def emergency_halt(self) -> None:
        process = self._process
        if self.parameters.kill_on_halt and process is not None:
            self._was_halted = True
            process.kill()

    @external
    def send(self, text: str) -> str:
        """Give the program one line and return the next line that it writes."""
        process = self._running()
        line = self._line(text)
        process.forget()
        self._write(process, line)
        answer = process.next_line(self.parameters.time_limit_s)
        if answer is None:
            raise self._late(process, "answer")
        return answer

    @external
    def write_line(self, text: str) -> None:
        """Give the program one line; its lines come as the event `printed`."""
        process = self._running()
        self._write(process, self._line(text))

    @external
    def state(self) -> ProgramState:
        """Whether the program runs, or how it ended."""
        process = self._process
        return ProgramState(
            pid=process.pid if process is not None and process.status is None else None,
            lines=process.lines if process is not None else 0,
            lines_skipped=process.skipped if process is not None else 0,
            why=self._reason,
        )

    def _start(self) -> None:
        wanted = self.parameters
        try:
            self._process = LineProcess(self.env.plugin, wanted, self._receive)
        except OSError as error:
            raise ProgramAbsent(self.env.plugin, f"{wanted.command[0]} cannot be started: {error}") from error

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.end()

    def _ended(self, status: int) -> None:
        """The program has ended by itself, or was killed."""
        self._reason = f"{self.parameters.command[0]} {how_it_ended(status)}"
        self._end()
        if self._was_halted:
            self._was_halted = False
            self._start()
        elif status == 0:
            logger.info("%s: %s", self.env.plugin, self._reason)
        else:
            raise ProgramEnded(self.env.plugin, self._reason)

    def _running(self) -> LineProcess:
        process = self._process
        if process is None or process.status is not None:
            raise self._trouble(ProgramEnded, f"does not run: {self._reason or 'it has just ended'}")
        return process

    def _line(self, text: str) -> str:
        if self.parameters.input == "json":
            try:
                return msgspec.json.format(text.encode(), indent=-1).decode()
            except (*BAD_PAYLOAD, UnicodeEncodeError) as error:
                raise self._trouble(BadLine, f"takes JSON: {error}") from error
        if "\n" in text or "\r" in text:
            raise self._trouble(BadLine, "takes one line at a time")
        if len(text.encode(errors="replace")) > self.parameters.max_line_bytes:
            raise self._trouble(BadLine, f"takes lines of up to {self.parameters.max_line_bytes} bytes")
        return text

    def _write(self, process: LineProcess, line: str) -> None:
        try:
            is_accepted = process.write(line, self.parameters.time_limit_s)
        except OSError as error:
            raise self._trouble(ProgramEnded, f"no longer accepts input: {error}") from error
        if not is_accepted:
            raise self._late(process, "take a line")

    def _late(self, process: LineProcess, what: str) -> PluginError:
        moment_s = SILENT_S if process.is_silent else A_MOMENT_S
        if process.ends_within(moment_s) and process.status is not None:
            return self._trouble(ProgramEnded, f"{how_it_ended(process.status)} and did not {what}")
        process.kill()
        return self._trouble(ProgramLate, f"did not {what} within {self.parameters.time_limit_s:g} s and was killed")

    def _trouble(self, kind: type[PluginError], what: str) -> PluginError:
        return kind(self.env.plugin, f"{self.env.plugin} {what}")

    def _receive(self, line: str) -> bool:
        """Handle a line of the program, on the thread that reads it."""
        if self.parameters.output == "json":
            try:
                msgspec.json.decode(line.encode(errors="replace"), type=msgspec.Raw)
            except BAD_PAYLOAD:
                logger.warning("%s: ignored a line that is not JSON: %.200s", self.env.plugin, line)
                return False
        self.printed.notify(line)
        return True
