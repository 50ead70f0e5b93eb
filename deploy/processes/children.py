"""Child processes: started with their parent's endpoint and stopped with their parent, and their output for it."""

import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import IO, Self
from urllib.parse import urlsplit

from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.live_process import LIFELINE_VARIABLE, PARENT_VARIABLE, LifelineEnd
from robrain.protocol.workers import END_S, KILLED_S, OwnedThread, ProcessGroup

COMMANDS = "robrain.cli"
KEPT_LINES = 200


class Child(ProcessGroup):
    """One process of this Python: of `robrain`, or of another module.

    Its last 200 lines of output are kept; each line is passed to `on_line`.

    Args:
        name: its name in messages.
        arguments: the command line after the module.
        on_line: called with each line, on a thread of the child's own.
        lifeline: a new one, whose other end the child gets; closed with the child's end. None for a child that is not
            supervised.
        module: its program; a program other than `robrain` has a pipe as its input, which ends with this process.

    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        on_line: Callable[[str], None] | None = None,
        lifeline: LifelineEnd | None = None,
        module: str = COMMANDS,
    ) -> None:
        is_command = module == COMMANDS
        self.name = name
        passed = {} if lifeline is None else {LIFELINE_VARIABLE: str(lifeline.pass_on)}
        self.lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._on_line = on_line
        super().__init__(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.DEVNULL if is_command else subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if is_command else subprocess.DEVNULL,
            environment={PARENT_VARIABLE: str(os.getpid()), "PYTHONUNBUFFERED": "1", **passed},
            keep=() if lifeline is None else (lifeline.pass_on,),
        )
        if lifeline is not None:
            lifeline.passed()
        assert self.process.stdout is not None
        self._reader = OwnedThread(f"output-{name}", self._read, self.process.stdout)

    @property
    def last_line(self) -> str:
        """Its last line of output, without the name of the program."""
        last = next((line for line in reversed(self.lines) if line.strip()), "it printed nothing")
        return last.removeprefix("robrain: ")

    def end(self, timeout_s: float = END_S) -> None:
        """As a process group, and read its last lines."""
        super().end(timeout_s)
        self._reader.close(KILLED_S)

    def _read(self, stream: IO[bytes]) -> None:
        with stream:
            for output in stream:
                line = output.decode(errors="replace").rstrip("\r\n")
                self.lines.append(line)
                if self._on_line is not None:
                    self._on_line(line)


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
            child.ask_to_end()
        for child in reversed(self.all):
            child.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


DASHBOARD_READY = "dashboard: "
START_TIMEOUT_S = 120.0
"""Limit for a process that hangs; an end is detected at once, and imports may be slow on a busy machine."""
POLL_S = 0.05


class StartingPage:
    """A dashboard's process from its start until its page is served.

    Args:
        children: owns the process.
        arguments: the command line after `robrain`.
        on_served: called with the page's address as soon as it is served, on a thread of the child's own.

    """

    def __init__(
        self, children: Children, arguments: Sequence[str], on_served: Callable[[str], None] | None = None
    ) -> None:
        self._url = ""
        self._on_served = on_served
        self._begun_s = time.monotonic()
        self._child = children.start("dashboard", arguments, self._record)

    @property
    def url(self) -> str:
        """The page's address; empty until it is served.

        Raises:
            ChildFailed: it did not start; the text gives the reason.

        """
        if self._url:
            return self._url
        if self._child.status is not None or time.monotonic() > self._begun_s + START_TIMEOUT_S:
            self._child.ask_to_end()
            self._child.end()
            raise ChildFailed(f"the dashboard did not start: {self._child.last_line}")
        return ""

    def _record(self, line: str) -> None:
        if line.startswith(DASHBOARD_READY) and not self._url:
            self._url = line.removeprefix(DASHBOARD_READY)
            if self._on_served is not None:
                self._on_served(self._url)


def continue_with_recording(children: Children, url: str, recording: Path) -> None:
    """Show a recording on a dashboard's page after its team has ended; open browsers reconnect by themselves.

    Args:
        children: owns the dashboard's process, and nothing else by now: it is stopped for another one.
        url: the page's address, which does not change.
        recording: an MCAP file.

    Raises:
        ChildFailed: it did not start; the text gives the reason.

    """
    children.stop()
    page = StartingPage(children, ["replay", str(recording), "--port", str(urlsplit(url).port)])
    while not page.url:
        time.sleep(POLL_S)


_FORWARDER = "serial forwarder of "


def forwarder_line(robot: str, address: str) -> str:
    """The line of output that reports one forwarder.

    >>> forwarder_line("r1", "127.0.0.1:9002")
    'serial forwarder of r1: 127.0.0.1:9002'
    """
    return f"{_FORWARDER}{robot}: {address}"


def read_addresses(lines: Iterable[str]) -> dict[str, str]:
    """The forwarders' addresses in lines of output.

    >>> read_addresses(["arena: depot", "serial forwarder of r1: 127.0.0.1:9002"])
    {'r1': '127.0.0.1:9002'}
    """
    found = (line.removeprefix(_FORWARDER).partition(": ") for line in lines if line.startswith(_FORWARDER))
    return {robot: address for robot, _, address in found}
