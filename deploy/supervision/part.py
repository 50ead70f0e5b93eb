"""A part of a team that runs as a process of its own, and what is told of it."""

import signal
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import msgspec

from robrain.deploy.processes.children import STOP_TIMEOUT_S
from robrain.deploy.supervision.restarts import Cause, Phase, ProcessFailure, RestartPolicy

HUB, ARENA, COORDINATOR = "hub", "arena", "coordinator"
STAND_BY, RECORDER, DASHBOARD = "stand-by", "recorder", "dashboard"
STOCK_PARTS = (HUB, ARENA, COORDINATOR, STAND_BY, RECORDER, DASHBOARD)
"""Parts that are no robots."""

POLICY = RestartPolicy()
HUB_POLICY = RestartPolicy(first_delay_s=0.1, hang_s=3.0)
"""All others wait for the hub, whose loop has nothing else to do than to beat."""


class Part(NamedTuple):
    """What is started, and how."""

    name: str
    arguments: Callable[[int], list[str]]
    """The command line after `robrain` for a start: the first is number 1."""
    policy: RestartPolicy = POLICY
    is_vital: bool = False
    """Whether the team ends when it is given up."""
    must_start: bool = False
    """Whether a refusal at its first start (exit status 2) is an error of whoever started the team."""
    stop_s: float = STOP_TIMEOUT_S
    """How long it is waited for when the team stops, before it is killed."""
    on_line: Callable[[str], None] | None = None
    """Called with each line that it prints, on a thread of its own."""


class PartEventKind(StrEnum):
    """What happened to a part."""

    STARTED = "started"
    """Its process was started."""
    UP = "up"
    """It does its work, for the first time."""
    FAILED = "failed"
    """It ended or hung, and is started again."""
    UP_AGAIN = "up_again"
    GIVEN_UP = "given_up"


class PartEvent(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="event", tag="part"):
    """A start of a part, its failure, or its return."""

    part: str
    kind: PartEventKind
    pid: int | None = None
    """Process id, of a start."""
    cause: Cause | None = None
    """Why it failed."""
    status: int | None = None
    """Exit status of its process; negative for a signal."""
    silent_s: float = 0.0
    """How long its main loop had been silent, or it had been starting, when it was killed."""
    again_in_s: float | None = None
    """Until it is started again."""
    away_s: float | None = None
    """From the notice of the failure until it was ready again."""
    said: str = ""
    """The last line that it printed."""

    @property
    def is_news(self) -> bool:
        """Whether it is shown to people: a failure, or the return from one."""
        return self.kind not in (PartEventKind.STARTED, PartEventKind.UP)

    @property
    def words(self) -> str:
        """In one line."""
        if self.kind is PartEventKind.STARTED:
            return f"{self.part} is process {self.pid}"
        if self.kind is PartEventKind.UP:
            return f"{self.part} is up"
        if self.kind is PartEventKind.UP_AGAIN:
            return f"{self.part} is up again after {self.away_s or 0.0:.1f} s"
        what = _what(self)
        if self.kind is PartEventKind.GIVEN_UP:
            return f"{self.part} {what} and is given up: it has failed too often"
        return f"{self.part} {what}; it is started again in {self.again_in_s or 0.0:.1f} s"


class PartView(NamedTuple):
    """A part at one moment, for display."""

    name: str
    phase: Phase
    pid: int | None
    cpu_share: float | None
    """Of one core; None if unknown."""
    memory_mb: float | None
    messages: str
    """Rate of its messages, in words; empty if unknown."""
    restarts: int | None
    """How often it was started again; None if unknown."""
    words: str = ""
    """What else is to be said of it."""


def failed(part: str, failure: ProcessFailure, said: str) -> PartEvent:
    """The event of a failure."""
    return PartEvent(
        part=part,
        kind=PartEventKind.GIVEN_UP if failure.delay_s is None else PartEventKind.FAILED,
        cause=failure.cause,
        status=failure.status,
        silent_s=failure.silent_s,
        again_in_s=failure.delay_s,
        said=said,
    )


def _what(event: PartEvent) -> str:
    if event.cause is Cause.SILENT:
        return f"was silent for {event.silent_s:.1f} s and was killed"
    if event.cause is Cause.SLOW_START:
        return f"was not ready after {event.silent_s:.0f} s and was killed"
    status = event.status or 0
    if status < 0:
        return f"was ended by {_signal_name(-status)}"
    said = f" ({event.said.removeprefix('robrain: ')})" if event.said else ""
    return f"ended with status {status}{said}"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
