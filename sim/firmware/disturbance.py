"""Late frames, late scans and paused agents, drawn from the seed: `[disturbance]` of a scenario.

Pauses begin by a Poisson process; their durations are uniform. Each robot has its own; times are by the run's clock.
"""

from collections import deque
from typing import Annotated, Generic, TypeVar

import can
import msgspec
import numpy as np
from msgspec import Meta

from robrain.plugins.device.mocdevice.frame_clock import StampedAt
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.messages.team.arena_messages import Scan
from robrain.protocol.model.checked import Checked

MOST_PER_MINUTE = 600.0
"""Limit of the pauses that begin in a minute."""
LONGEST_S = 60.0
"""Limit of a pause and of a delay."""
_RNG_OF_DISTURBANCE = 3
_CAN, _SCAN, _AGENT = range(3)

T = TypeVar("T")


def _check_span(name: str, span_s: tuple[float, float]) -> None:
    least_s, greatest_s = span_s
    if not 0 <= least_s <= greatest_s <= LONGEST_S:
        raise ValueError(f"expected {name} as [least, greatest] from 0 to {LONGEST_S:g} s, got {list(span_s)}")


class PauseSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Pauses at random times; the default is none. Raises ValueError for impossible values."""

    per_minute: Annotated[float, Meta(ge=0, le=MOST_PER_MINUTE)] = 0.0
    """Mean number of pauses that begin per minute outside pauses."""
    duration_s: tuple[float, float] = (0.2, 1.0)
    """Shortest and longest duration."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_span("duration_s", self.duration_s)

    @property
    def is_on(self) -> bool:
        """Whether anything is late by it."""
        return self.per_minute > 0


class DelaySpec(PauseSpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Delays of messages, which stay in order; messages that wait during a pause arrive together after it."""

    late_s: tuple[float, float] = (0.0, 0.0)
    """Least and greatest delay of a message outside pauses."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_span("late_s", self.late_s)

    @property
    def is_on(self) -> bool:
        """Whether anything is late by it."""
        return self.per_minute > 0 or self.late_s[1] > 0


class FrameDelaySpec(DelaySpec, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[disturbance.can]`: delays of frames from a robot's nodes; frames from its computer are never late."""

    stamped_at: StampedAt = StampedAt.ARRIVAL
    """Meaning of the frames' stamps, also in the robot's parameters; most adapters stamp on arrival."""


class DisturbanceSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[disturbance]` of each robot."""

    can: FrameDelaySpec = FrameDelaySpec()
    scan: DelaySpec = DelaySpec()
    """Delays of scans; their stamps are the times of measurement."""
    agent: PauseSpec = PauseSpec()
    """Pauses in which an agent runs no step; lockstep only."""

    @property
    def is_on(self) -> bool:
        """Whether anything is late."""
        return self.can.is_on or self.scan.is_on or self.agent.is_on


class Pauses:
    """Pauses at random times.

    Args:
        spec: how often and how long.
        rng: draws them.

    """

    def __init__(self, spec: PauseSpec, rng: np.random.Generator) -> None:
        self._spec = spec
        self._rng = rng
        self._begins_ns = self._ends_ns = -1

    def covers(self, now_ns: int) -> bool:
        """Whether there is a pause at this time; times must not decrease from call to call."""
        if self._spec.per_minute <= 0:
            return False
        if self._ends_ns < 0:
            self._draw(now_ns)
        while now_ns >= self._ends_ns:
            self._draw(self._ends_ns)
        return now_ns >= self._begins_ns

    def _draw(self, after_ns: int) -> None:
        self._begins_ns = after_ns + to_ns(float(self._rng.exponential(60.0 / self._spec.per_minute)))
        self._ends_ns = self._begins_ns + max(1, to_ns(float(self._rng.uniform(*self._spec.duration_s))))


class DelayLine(Generic[T]):
    """A queue of things that arrive late, in order.

    Args:
        spec: delays.
        rng: draws the delays.
        clock: the run's clock.

    """

    def __init__(self, spec: DelaySpec, rng: np.random.Generator, clock: Clock) -> None:
        pauses_rng, self._rng = rng.spawn(2)
        self._late_s = spec.late_s
        self._pauses = Pauses(spec, pauses_rng)
        self._clock = clock
        self._waiting: deque[tuple[int, int, T]] = deque()
        self._last_due_ns = 0

    def put(self, thing: T) -> None:
        """Send a thing now."""
        now_ns = self._clock.now_ns()
        late_s = float(self._rng.uniform(*self._late_s)) if self._late_s[1] > 0 else 0.0
        self._last_due_ns = max(self._last_due_ns, now_ns + to_ns(late_s))
        self._waiting.append((self._last_due_ns, now_ns, thing))

    def arrivals(self) -> list[tuple[int, T]]:
        """Remove and return the things that have arrived, each with the time at which it was sent."""
        now_ns = self._clock.now_ns()
        arrived = []
        if not self._pauses.covers(now_ns):
            while self._waiting and self._waiting[0][0] <= now_ns:
                _, sent_ns, thing = self._waiting.popleft()
                arrived.append((sent_ns, thing))
        return arrived


class Disturbance:
    """The disturbances of one run.

    Args:
        spec: parameters.
        seed: the run's seed.

    """

    def __init__(self, spec: DisturbanceSpec, seed: int) -> None:
        self.spec = spec
        self._seed = seed

    def frames(self, robot: int, clock: Clock) -> DelayLine[can.Message] | None:
        """Delays of the frames from a robot's nodes, by the robot's index; None if they are never late."""
        spec = self.spec.can
        return DelayLine(spec, self._rng(_CAN, robot), clock) if spec.is_on else None

    def scans(self, robot: int, clock: Clock) -> DelayLine[Scan] | None:
        """Delays of its scans; None if they are never late."""
        spec = self.spec.scan
        return DelayLine(spec, self._rng(_SCAN, robot), clock) if spec.is_on else None

    def steps(self, robot: int) -> Pauses | None:
        """Pauses of its agent; None if there are none."""
        spec = self.spec.agent
        return Pauses(spec, self._rng(_AGENT, robot)) if spec.is_on else None

    def _rng(self, kind: int, robot: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, _RNG_OF_DISTURBANCE, kind, robot])
