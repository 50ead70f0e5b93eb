"""When a process is started, killed, started again or given up: a pure state machine of one process.

It knows no process and no clock: its owner reports what happened, and asks it with the time what to do next. Time in
which the owner itself stood still is no evidence against the process, as the whole machine may have been suspended; nor
is most of the time in which the process waited for a core, on a machine that has more to do than it can.
"""

from collections import deque
from enum import StrEnum
from typing import NamedTuple

import msgspec

from robrain.protocol.model.ranges import check_not_negative, check_positive

LONGEST_LOOK_S = 0.5
"""Longer times between two calls of `next_step` count as so much silence."""
WAITED_SHARE = 0.2
"""Share of the time waited for a core that counts as silence (chosen): a loop that never ends is killed within five
times `hang_s`, however busy the machine is."""
QUIET_S = 0.5
"""Silence from which it is worth looking whether a process waits for a core: longer than any usual period."""


class RestartPolicy(msgspec.Struct, frozen=True, kw_only=True):
    """When a process is started again, and when no more."""

    first_delay_s: float = 0.2
    """From the first failure to the next start."""
    factor: float = 2.0
    """Of the delay, for each further failure within `within_s`."""
    longest_delay_s: float = 10.0
    limit: int = 5
    """Failures within `within_s` after which a process is started again; with one more it is given up."""
    within_s: float = 60.0
    hang_s: float = 5.0
    """Silence of the main loop after which a process is killed, once it has been ready."""
    start_s: float = 120.0
    """Time from the start to readiness after which a process is killed."""

    def __post_init__(self) -> None:
        check_positive(self, "first_delay_s", "longest_delay_s", "within_s", "hang_s", "start_s")
        if not self.factor >= 1.0:
            raise ValueError(f"expected factor >= 1, got {self.factor:g}")
        check_not_negative(self, "limit")

    def delay_s(self, failures: int) -> float:
        """From the last of so many failures to the next start."""
        return min(self.first_delay_s * self.factor ** min(failures - 1, 64), self.longest_delay_s)


class Phase(StrEnum):
    """How a process is."""

    WAITING = "waiting"
    """It does not run, and will be started."""
    STARTING = "starting"
    UP = "up"
    KILLED = "killed"
    """It hung and was killed; its end is awaited."""
    GIVEN_UP = "given up"


class RestartStep(StrEnum):
    """What is to be done with a process now."""

    NOTHING = "nothing"
    START = "start"
    KILL = "kill"


class Cause(StrEnum):
    """Why a process failed."""

    ENDED = "ended"
    SILENT = "silent"
    SLOW_START = "slow_start"


class ProcessFailure(NamedTuple):
    """One failure of a process."""

    at_s: float
    cause: Cause
    status: int
    """Exit status; negative for a signal."""
    silent_s: float
    """How long its main loop had been silent, or how long it had been starting; of the time that it waited for a core,
    `WAITED_SHARE` is in it."""
    delay_s: float | None
    """Until the next start; None if it is given up."""


class Restarts:
    """The state of one process.

    Args:
        policy: when it is started again.

    """

    def __init__(self, policy: RestartPolicy) -> None:
        self.policy = policy
        self.phase = Phase.WAITING
        self.starts = 0
        """How often it was started."""
        self.was_ready = False
        """Whether it has ever been ready."""
        self._start_s = float("-inf")
        self._silent_s = 0.0
        self._checked_s: float | None = None
        self._cause = Cause.ENDED
        self._failures: deque[float] = deque()

    @property
    def restarts(self) -> int:
        """How often it was started again."""
        return max(self.starts - 1, 0)

    @property
    def is_quiet(self) -> bool:
        """Whether it runs and has been silent, or starting, for a while."""
        return self.phase in (Phase.STARTING, Phase.UP) and self._silent_s >= QUIET_S

    def started(self) -> None:
        """It was started, as `next_step` said."""
        self.phase, self.starts = Phase.STARTING, self.starts + 1
        self._silent_s, self._cause = 0.0, Cause.ENDED

    def beat(self) -> None:
        """Its main loop goes on."""
        if self.phase is Phase.UP:
            self._silent_s = 0.0

    def ready(self) -> None:
        """It does its work."""
        if self.phase is Phase.STARTING:
            self.phase, self.was_ready, self._silent_s = Phase.UP, True, 0.0

    def ended(self, now_s: float, status: int) -> ProcessFailure:
        """It has ended, or could not be started."""
        self._failures.append(now_s)
        while self._failures[0] <= now_s - self.policy.within_s:
            self._failures.popleft()
        delay_s: float | None = None
        if len(self._failures) > self.policy.limit:
            self.phase = Phase.GIVEN_UP
        else:
            delay_s = self.policy.delay_s(len(self._failures))
            self.phase, self._start_s = Phase.WAITING, now_s + delay_s
        return ProcessFailure(now_s, self._cause, status, self._silent_s, delay_s)

    def next_step(self, now_s: float, waited_s: float = 0.0) -> RestartStep:
        """What to do now; has to be asked a few times a second.

        Args:
            now_s: the time, of a clock that only goes forward.
            waited_s: for how much of the time since the last call the process waited for a core.

        """
        looked_s, self._checked_s = self._checked_s, now_s
        if self.phase is Phase.WAITING:
            return RestartStep.START if now_s >= self._start_s else RestartStep.NOTHING
        if self.phase not in (Phase.STARTING, Phase.UP):
            return RestartStep.NOTHING
        if looked_s is not None:
            look_s = min(max(now_s - looked_s, 0.0), LONGEST_LOOK_S)
            self._silent_s += look_s - (1.0 - WAITED_SHARE) * min(max(waited_s, 0.0), look_s)
        is_up = self.phase is Phase.UP
        if self._silent_s < (self.policy.hang_s if is_up else self.policy.start_s):
            return RestartStep.NOTHING
        self._cause, self.phase = Cause.SILENT if is_up else Cause.SLOW_START, Phase.KILLED
        return RestartStep.KILL
