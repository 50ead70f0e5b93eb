"""Supervises the processes of a team's parts, and restarts processes that end or hang."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Self

from robrain.deploy.errors import ChildFailed
from robrain.deploy.processes.children import Child
from robrain.deploy.processes.live_process import LifelineEnd
from robrain.deploy.supervision import guard
from robrain.deploy.supervision.part import (
    HUB,
    CoreWait,
    MemberStatus,
    Part,
    PartEvent,
    PartEventKind,
    Phase,
    ProcessFigures,
    Restarts,
    RestartStep,
)
from robrain.protocol.workers import END_S, ProcessGroup

BAD_INPUT = 2
"""Exit status of a process that refuses to start."""
NOT_STARTED = 127
"""Status of a process that the system could not start."""


class Supervised:
    """One part: its process, while it has one, and the state of its restarts."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self.restarts = Restarts(part.name, part.policy)
        self.child: Child | None = None
        self.figures: ProcessFigures | None = None
        self._core_wait: CoreWait | None = None
        self.last_lines: list[str] = []
        """Output of the process before this one."""
        self.failed_s: float | None = None
        """Time at which its current failure was detected."""
        self._lifeline: LifelineEnd | None = None

    @property
    def is_up(self) -> bool:
        """Whether it does its work."""
        return self.restarts.phase is Phase.UP

    def start(self) -> None:
        """Start its process (OSError if the system cannot)."""
        self.restarts.started()
        self._lifeline = LifelineEnd()
        try:
            words = self.part.arguments(self.restarts.starts)
            self.child = Child(self.part.name, words, self.part.on_line, self._lifeline)
        except OSError:
            self._lifeline.close()
            raise
        self.figures, self._core_wait = ProcessFigures(self.child.pid), CoreWait(self.child.pid)

    def read_lifeline(self) -> bool:
        """Read its process's lifeline; whether it is ready since this call."""
        if self._lifeline is None:
            return False
        pulse = self._lifeline.pulse()
        was_up = self.is_up
        if pulse.is_ready:
            self.restarts.ready()
        if pulse.beats:
            self.restarts.beat()
        return self.is_up and not was_up

    def next_step(self, now_s: float) -> RestartStep:
        """Next step for its process."""
        waited_s = 0.0
        if self._core_wait is not None:
            if self.restarts.is_quiet:
                waited_s = self._core_wait.since_last_s()
            else:
                self._core_wait.forget()
        return self.restarts.next_step(now_s, waited_s)

    def came_up(self, now_s: float) -> PartEvent:
        """Record that the part is up now, and return the event."""
        name, failed_s, self.failed_s = self.part.name, self.failed_s, None
        if failed_s is None:
            return PartEvent(part=name, kind=PartEventKind.UP)
        return PartEvent(part=name, kind=PartEventKind.UP_AGAIN, away_s=now_s - failed_s)

    def release(self) -> None:
        """Its process has ended: end its remaining children, and keep its last lines."""
        if self._lifeline is not None:
            self._lifeline.close()
            self._lifeline = None
        if self.child is not None:
            self.child.end(0.0)
            self.last_lines = list(self.child.lines)
        self.child = self.figures = self._core_wait = None

    def status(self, now_s: float, messages: str, words: str) -> MemberStatus:
        """How it is."""
        cpu_share, memory_mb = self.figures.at(now_s) if self.figures is not None else (None, None)
        return MemberStatus(
            self.part.name,
            words,
            pid=self.child.pid if self.child is not None else None,
            cpu_share=cpu_share,
            memory_mb=memory_mb,
            messages=messages,
            phase=self.restarts.phase,
            restarts=self.restarts.restarts,
        )


class Supervisor:
    """The parts of a team on one machine. Leaving the `with` block stops all of them, the hub last.

    Args:
        on_event: called for failures and returns.

    """

    def __init__(self, on_event: Callable[[PartEvent], None]) -> None:
        self.all: list[Supervised] = []
        self._on_event = on_event
        self._guard: ProcessGroup | None = None

    def add(self, parts: Sequence[Part]) -> None:
        """Supervise more parts, and start them."""
        self.all += map(Supervised, parts)
        self.update()

    def named(self, name: str) -> Supervised | None:
        """The part of a name; None if there is none."""
        return next((each for each in self.all if each.part.name == name), None)

    @property
    def given_up(self) -> list[str]:
        """Names of the parts that have failed too often."""
        return [each.part.name for each in self.all if each.restarts.phase is Phase.GIVEN_UP]

    @property
    def lost(self) -> str:
        """A part that was given up and without which there is no team; empty if there is none."""
        return next((e.part.name for e in self.all if e.part.is_vital and e.restarts.phase is Phase.GIVEN_UP), "")

    def update(self) -> None:
        """Detect events, and do everything that is due; to be called ten times a second.

        Raises:
            ChildFailed: a part that must start refused to; the text gives the reason.

        """
        for each in self.all:
            now_s = time.monotonic()
            if each.read_lifeline():
                self._on_event(each.came_up(now_s))
            if each.child is not None and (status := each.child.status) is not None:
                self._record_end(each, status, now_s)
            step = each.next_step(now_s)
            if step is RestartStep.KILL and each.child is not None:
                each.child.kill(0.0)
            elif step is RestartStep.START:
                self._start(each, now_s)

    def stop(self) -> None:
        """Ask all parts to stop, and wait for them; parts that others need stop last."""
        hubs = [each for each in self.all if each.part.name == HUB]
        for together in ([each for each in self.all if each not in hubs], hubs):
            for each in reversed(together):
                if each.child is not None:
                    each.child.ask_to_end()
            asked_s = time.monotonic()
            for each in reversed(together):
                if each.child is not None:
                    pid = each.child.pid
                    each.child.end(max(asked_s + each.part.stop_s - time.monotonic(), 0.0))
                    each.release()
                    self._send_to_guard(f"-{pid}")

    def __enter__(self) -> Self:
        self._guard = ProcessGroup([sys.executable, "-I", "-S", guard.__file__], stdin=subprocess.PIPE)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        if self._guard is not None:
            self._guard.end(guard.GRACE_S + END_S)

    def _start(self, each: Supervised, now_s: float) -> None:
        try:
            each.start()
        except OSError as error:
            each.last_lines = [f"cannot be started: {error.strerror}"]
            self._report_failure(each, NOT_STARTED, now_s)
            return
        if each.child is not None:
            self._send_to_guard(f"+{each.child.pid}")
            self._on_event(PartEvent(part=each.part.name, kind=PartEventKind.STARTED, pid=each.child.pid))

    def _record_end(self, each: Supervised, status: int, now_s: float) -> None:
        pid = each.child.pid if each.child is not None else 0
        each.release()
        self._send_to_guard(f"-{pid}")
        self._report_failure(each, status, now_s)

    def _report_failure(self, each: Supervised, status: int, now_s: float) -> None:
        last_line = next((line for line in reversed(each.last_lines) if line.strip()), "")
        is_first = each.restarts.starts == 1 and not each.restarts.was_ready
        if status == BAD_INPUT and is_first and each.part.must_start:
            text = last_line.removeprefix("robrain: ") or "it printed nothing"
            raise ChildFailed(f"the {each.part.name} did not start: {text}")
        event = each.restarts.ended(now_s, status, last_line)
        if each.failed_s is None:
            each.failed_s = now_s
        self._on_event(event)

    def _send_to_guard(self, line: str) -> None:
        if self._guard is not None and self._guard.process.stdin is not None:
            with suppress(OSError):
                os.write(self._guard.process.stdin.fileno(), f"{line}\n".encode())
