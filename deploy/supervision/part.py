"""A part of a team that runs as a process: its command, its restarts, and its use of resources."""

import os
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from robrain.protocol.backoff import backoff_s
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegativeInt, Positive
from robrain.protocol.workers import END_S, how_it_ended

LONGEST_CHECK_S = 0.5
"""Longer times between two calls of `next_step` count as so much silence."""
WAITED_SHARE = 0.2
"""Share of the time waited for a core that counts as silence (chosen). A loop that never ends is killed within five
times `hang_s`, even on a busy machine.
"""
QUIET_S = 0.5
"""Silence from which it is worth looking whether a process waits for a core: longer than any usual period."""
HUB, ARENA, COORDINATOR = "hub", "arena", "coordinator"
STAND_BY, RECORDER, DASHBOARD = "stand-by", "recorder", "dashboard"
STOCK_PARTS = (HUB, ARENA, COORDINATOR, STAND_BY, RECORDER, DASHBOARD)
"""Parts that are no robots."""
PROC = Path("/proc")
PERIOD_S = 1.0
"""Time over which CPU is averaged, at least."""
MEGABYTE = 1024 * 1024


class RestartPolicy(Checked, frozen=True, kw_only=True):
    """Conditions of a process's restarts and of their end."""

    first_delay_s: Positive = 0.2
    """From the first failure to the next start."""
    factor: Annotated[float, Meta(ge=1)] = 2.0
    """Of the delay, for each further failure within `within_s`."""
    longest_delay_s: Positive = 10.0
    limit: NotNegativeInt = 5
    """Failures within `within_s` after which a process is started again; with one more it is given up."""
    within_s: Positive = 60.0
    hang_s: Positive = 5.0
    """Silence of the main loop after which a process is killed, once it has been ready."""
    start_s: Positive = 120.0
    """Time from the start to readiness after which a process is killed."""

    def delay_s(self, failures: int) -> float:
        """Delay from the last of this number of failures to the next start."""
        return backoff_s(failures, self.first_delay_s, self.longest_delay_s, self.factor)


class Phase(StrEnum):
    """Phase of a process."""

    WAITING = "waiting"
    """It does not run, and will be started."""
    STARTING = "starting"
    UP = "up"
    KILLED = "killed"
    """It hung and was killed; its end is awaited."""
    GIVEN_UP = "given up"


class RestartStep(StrEnum):
    """Next step of the supervisor for a process."""

    NOTHING = "nothing"
    START = "start"
    KILL = "kill"


class Cause(StrEnum):
    """Cause of a process's failure."""

    ENDED = "ended"
    SILENT = "silent"
    SLOW_START = "slow_start"


class PartEventKind(StrEnum):
    """Kind of a part's event."""

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
    """Reason for its failure."""
    status: int | None = None
    """Exit status of its process; negative for a signal."""
    silent_s: float = 0.0
    """Duration of its main loop's silence, or of its start, when it was killed. It includes the share `WAITED_SHARE` of
    the time that the process waited for a core.
    """
    again_in_s: float | None = None
    """Until it is started again."""
    away_s: float | None = None
    """From the notice of the failure until it was ready again."""
    last_line: str = ""
    """The last line that it printed."""

    @property
    def is_news(self) -> bool:
        """Whether it is shown to people: a failure, or the return from one."""
        return self.kind not in (PartEventKind.STARTED, PartEventKind.UP)

    @property
    def words(self) -> str:
        """In one line."""
        match self.kind:
            case PartEventKind.STARTED:
                return f"{self.part} is process {self.pid}"
            case PartEventKind.UP:
                return f"{self.part} is up"
            case PartEventKind.UP_AGAIN:
                return f"{self.part} is up again after {self.away_s or 0.0:.1f} s"
            case PartEventKind.GIVEN_UP:
                return f"{self.part} {self._failure} and is given up: it has failed too often"
        return f"{self.part} {self._failure}; it is started again in {self.again_in_s or 0.0:.1f} s"

    @property
    def _failure(self) -> str:
        if self.cause is Cause.SILENT:
            return f"was silent for {self.silent_s:.1f} s and was killed"
        if self.cause is Cause.SLOW_START:
            return f"was not ready after {self.silent_s:.0f} s and was killed"
        status = self.status or 0
        if status < 0:
            return how_it_ended(status)
        last_line = f" ({self.last_line.removeprefix('robrain: ')})" if self.last_line else ""
        return f"ended with status {status}{last_line}"


class Restarts:
    """The state of one process.

    Args:
        part: its name.
        policy: conditions of its restarts.

    """

    def __init__(self, part: str, policy: RestartPolicy) -> None:
        self.part, self.policy = part, policy
        self.phase = Phase.WAITING
        self.starts = 0
        """Number of its starts."""
        self.was_ready = False
        """Whether it has ever been ready."""
        self._start_s = float("-inf")
        self._silent_s = 0.0
        self._checked_s: float | None = None
        self._cause = Cause.ENDED
        self._failures: deque[float] = deque()

    @property
    def restarts(self) -> int:
        """Number of its restarts."""
        return max(self.starts - 1, 0)

    @property
    def is_quiet(self) -> bool:
        """Whether it runs and has been silent, or starting, for a while."""
        return self.phase in (Phase.STARTING, Phase.UP) and self._silent_s >= QUIET_S

    def started(self) -> None:
        """Record that it was started, as `next_step` requested."""
        self.phase, self.starts = Phase.STARTING, self.starts + 1
        self._silent_s, self._cause = 0.0, Cause.ENDED

    def beat(self) -> None:
        """Record that its main loop runs."""
        if self.phase is Phase.UP:
            self._silent_s = 0.0

    def ready(self) -> None:
        """It does its work."""
        if self.phase is Phase.STARTING:
            self.phase, self.was_ready, self._silent_s = Phase.UP, True, 0.0

    def ended(self, now_s: float, status: int, last_line: str = "") -> PartEvent:
        """It has ended, or could not be started; returns the event."""
        self._failures.append(now_s)
        while self._failures[0] <= now_s - self.policy.within_s:
            self._failures.popleft()
        delay_s: float | None = None
        self.phase, kind = Phase.GIVEN_UP, PartEventKind.GIVEN_UP
        if len(self._failures) <= self.policy.limit:
            delay_s = self.policy.delay_s(len(self._failures))
            self.phase, kind, self._start_s = Phase.WAITING, PartEventKind.FAILED, now_s + delay_s
        return PartEvent(
            part=self.part,
            kind=kind,
            cause=self._cause,
            status=status,
            silent_s=self._silent_s,
            again_in_s=delay_s,
            last_line=last_line,
        )

    def next_step(self, now_s: float, waited_s: float = 0.0) -> RestartStep:
        """Next step; call it a few times a second.

        Args:
            now_s: the time, of a clock that only goes forward.
            waited_s: for how much of the time since the last call the process waited for a core.

        """
        before_s, self._checked_s = self._checked_s, now_s
        if self.phase is Phase.WAITING:
            return RestartStep.START if now_s >= self._start_s else RestartStep.NOTHING
        if self.phase not in (Phase.STARTING, Phase.UP):
            return RestartStep.NOTHING
        if before_s is not None:
            passed_s = min(max(now_s - before_s, 0.0), LONGEST_CHECK_S)
            self._silent_s += passed_s - (1.0 - WAITED_SHARE) * min(max(waited_s, 0.0), passed_s)
        is_up = self.phase is Phase.UP
        if self._silent_s < (self.policy.hang_s if is_up else self.policy.start_s):
            return RestartStep.NOTHING
        self._cause, self.phase = Cause.SILENT if is_up else Cause.SLOW_START, Phase.KILLED
        return RestartStep.KILL


POLICY = RestartPolicy()
HUB_POLICY = RestartPolicy(first_delay_s=0.1, hang_s=3.0)
"""All others wait for the hub, whose loop only beats."""


class Part(NamedTuple):
    """Command of a process, and its supervision."""

    name: str
    arguments: Callable[[int], list[str]]
    """The command line after `robrain` for a start: the first is number 1."""
    policy: RestartPolicy = POLICY
    is_vital: bool = False
    """Whether the team ends when it is given up."""
    must_start: bool = False
    """Whether a refusal at its first start (exit status 2) is an error of the user who started the team."""
    stop_s: float = END_S
    """Time for its end when the team stops, before it is killed."""
    on_line: Callable[[str], None] | None = None
    """Called with each line that it prints, on a separate thread."""


class MemberStatus(msgspec.Struct, frozen=True, omit_defaults=True):
    """A member of a team, as `robrain top --json` prints it. Unknown values are omitted."""

    name: str
    words: str = ""
    """How it is."""
    host: str | None = None
    pid: int | None = None
    version: str | None = None
    cpu_share: float | None = None
    """Of one core."""
    memory_mb: float | None = None
    messages: str | None = None
    """Rate of its messages."""
    phase: Phase = Phase.UP
    """Of a process that `robrain up` supervises."""
    restarts: int | None = None


class Figures(NamedTuple):
    """Resources that a process uses."""

    cpu_share: float | None
    """Of one core, over the last second; None if unknown."""
    memory_mb: float | None
    """Resident, MiB; None if unknown."""


UNKNOWN_FIGURES = Figures(None, None)


class ProcessFigures:
    """Follows one process.

    Args:
        pid: its process id.
        proc: directory in which Linux lists processes.

    """

    def __init__(self, pid: int, proc: Path = PROC) -> None:
        self._folder = proc / str(pid)
        self._before: tuple[float, float] | None = None
        self._last = UNKNOWN_FIGURES

    def at(self, now_s: float) -> Figures:
        """Current use of resources; the last figures if they are less than a second old.

        Args:
            now_s: a clock that only goes forward, s.

        """
        if self._before is not None and now_s - self._before[0] < PERIOD_S:
            return self._last
        try:
            cpu_s, memory_mb = _read(self._folder)
        except (OSError, ValueError, IndexError):
            self._before, self._last = None, UNKNOWN_FIGURES
            return UNKNOWN_FIGURES
        share = None if self._before is None else max(cpu_s - self._before[1], 0.0) / (now_s - self._before[0])
        self._before, self._last = (now_s, cpu_s), Figures(share, memory_mb)
        return self._last


def commands_beside(pid: int) -> list[tuple[int, list[str]]]:
    """The `robrain` processes with the same parent as a process: process ids and arguments.

    Args:
        pid: id of the process.

    """
    found = []
    with suppress(OSError, ValueError, IndexError):
        parent = _parent(PROC / str(pid))
        for folder in PROC.iterdir():
            with suppress(OSError, ValueError, IndexError):  # it may end meanwhile
                if folder.name.isdigit() and _parent(folder) == parent:
                    words = (folder / "cmdline").read_text().rstrip("\0").split("\0")
                    program = [Path(word).name in ("robrain", "robrain.cli") for word in words].index(True)
                    found.append((int(folder.name), words[program + 1 :]))
    return found


def _parent(folder: Path) -> int:
    return int((folder / "stat").read_text().rpartition(")")[2].split()[1])


class CoreWait:
    """Time for which a process could not run because other processes had the cores.

    Args:
        pid: its process id.
        proc: directory in which Linux lists processes.

    """

    def __init__(self, pid: int, proc: Path = PROC) -> None:
        self._tasks = proc / str(pid) / "task"
        self._before: dict[str, int] | None = None

    def since_last_s(self) -> float:
        """Longest wait of a thread since the last call, in seconds; 0 in the first call, or if unknown.

        All threads count: the main thread may need the interpreter's lock while its holder waits for a core.
        """
        before, self._before = self._before, self._read_ns()
        if before is None:
            return 0.0
        return max((waited - before.get(thread, waited) for thread, waited in self._before.items()), default=0) / 1e9

    def forget(self) -> None:
        """Let the next call be the first again."""
        self._before = None

    def _read_ns(self) -> dict[str, int]:
        waited: dict[str, int] = {}
        with suppress(OSError):
            for thread in self._tasks.iterdir():
                with suppress(OSError, ValueError, IndexError):
                    # Time on a core, time waited for one, both ns, and number of turns: proc/schedstat of the kernel.
                    waited[thread.name] = int((thread / "schedstat").read_text().split()[1])
        return waited


def _read(folder: Path) -> tuple[float, float]:
    """CPU seconds since the process began, and resident MiB."""
    # The name, in brackets, may hold blanks; utime and stime are fields 14 and 15 of proc_pid_stat(5).
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])
    pages = int((folder / "statm").read_text().split()[1])
    return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE
