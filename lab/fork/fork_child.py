"""Forks of a recording in a child process, for the page that replays it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from robrain.dashboard.panels.what_if import ForkState
from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.children import Child, Children, StartingPage
from robrain.lab.fork.fork_result import ForkResult, fork_name, repeatable
from robrain.protocol.clock import to_seconds
from robrain.recording.errors import RecordingError
from robrain.recording.reader.reading import recording_info
from robrain.recording.reader.two_runs import TwoRuns


class ForkProgress(msgspec.Struct, frozen=True):
    """A line of `robrain fork --json --progress` while it runs."""

    now_s: float
    """Simulated time so far."""


class ForkLine(msgspec.Struct, frozen=True):
    """Any line of it; the last one has the fork."""

    progress: ForkProgress | None = None
    fork: ForkResult | None = None
    runs: TwoRuns | None = None


def decode_line(line: str) -> ForkLine | None:
    """A line of output; None if it is another text."""

    def path(kind: type, value: Any) -> Any:
        return Path(value) if issubclass(kind, Path) else value

    try:
        return msgspec.json.decode(line, type=ForkLine, dec_hook=path)
    except msgspec.DecodeError:
        return None


class ForkChild:
    """Runs `robrain fork` on one recording, one at a time, and serves the replay of its output.

    Args:
        recording: an MCAP file.

    """

    def __init__(self, recording: Path) -> None:
        self._recording = recording
        self._children = Children()
        self._child: Child | None = None
        self._page: StartingPage | None = None
        self._output = recording
        self._last: ForkLine | None = None
        self._now_s = self._at_s = self._until_s = 0.0
        self._failure = ""
        self.refusal = ""
        """Reason why the recording cannot be run again; empty if it can."""
        try:
            repeatable(recording)
            info = recording_info(recording)
            self._until_s = to_seconds(info.start_ns) + info.duration_s
        except RecordingError as error:
            self.refusal = str(error)

    @property
    def state(self) -> ForkState:
        """The last fork, as it is now."""
        child, last = self._child, self._last
        is_running = child is not None and child.status is None
        if child is not None and not is_running and not self._failure and (last is None or last.fork is None):
            child.end()  # until its last line is read
            last = self._last
            if last is None or last.fork is None:
                self._failure = child.last_line
        fork = last.fork if last is not None and not is_running else None
        return ForkState(
            is_running=is_running,
            at_s=self._at_s,
            now_s=self._now_s,
            until_s=self._until_s,
            failure=self._failure,
            before="" if fork is None else _before(fork),
            file="" if fork is None else self._output.name,
            url="" if fork is None else self._url(),
            runs=None if last is None or fork is None else last.runs,
        )

    def start(self, at_s: float, without: Sequence[str], task: str) -> None:
        """Start a fork; an earlier one that still runs is stopped."""
        self.stop()
        self._children.stop()
        self._children, self._page = Children(), None
        self._last, self._failure, self._now_s, self._at_s = None, "", 0.0, at_s
        self._output = _free_name(fork_name(self._recording, at_s))
        words = ["fork", str(self._recording), "--at", f"{at_s:.2f}", "--output", str(self._output)]
        for robot in without:
            words += ["--without", robot]
        words += ["--task", task] if task else []
        self._child = self._children.start("fork", [*words, "--json", "--progress"], self._receive)

    def stop(self) -> None:
        """Stop a fork that runs."""
        child = self._child
        if child is not None and child.status is None:
            child.ask_to_end()
            child.end()
            self._failure = "stopped"

    def close(self) -> None:
        """Stop everything."""
        self._children.stop()

    def _receive(self, line: str) -> None:
        read = decode_line(line)
        if read is None:
            return
        if read.progress is not None:
            self._now_s = read.progress.now_s
        else:
            self._last = read

    def _url(self) -> str:
        if self._page is None:
            self._page = StartingPage(self._children, ["replay", str(self._output), "--port", "0"])
        try:
            return self._page.url
        except ChildFailed:
            return ""


def _before(fork: ForkResult) -> str:
    if fork.same_before:
        return f"equal, {fork.messages_before} messages"
    where = "" if fork.difference is None else f", first on {fork.difference.key} at {fork.difference.time_s:.2f} s"
    return f"NOT equal after {fork.messages_before} messages{where}"


def _free_name(path: Path) -> Path:
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free
