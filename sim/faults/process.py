"""A process of a run, which may die, hang, be slow or misread the time; and the disk of a coordinator's journal.

The disk outlives the coordinator, and may be full. The journal is the product's, on SQLite in memory; the next
coordinator finds everything that a killed one had committed.
"""

import logging
import sqlite3
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

from robrain.coordinator.journal.journal import Journal
from robrain.protocol.clock import Clock, to_ns
from robrain.protocol.errors import RobrainError
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.refusals import Refusals
from robrain.sim.faults.fault_spec import FaultKind, FaultSpec

logger = logging.getLogger(__name__)

RESTART_NS = to_ns(1.0)
"""Pause before a failed start is repeated."""


class SkewedClock:
    """The run's clock, and a difference.

    Args:
        clock: the run's clock.
        skew_ns: lead of its clock.

    """

    def __init__(self, clock: Clock, skew_ns: int) -> None:
        self._skew_ns = skew_ns
        self._clock = clock

    def now_ns(self) -> int:
        """See Clock; never below 0."""
        return max(0, self._clock.now_ns() + self._skew_ns)


class Component(Protocol):
    """Program of a process."""

    refusals: Refusals

    def step(self) -> None:
        """Do the work that is due."""

    def close(self) -> None:
        """End, as a process does that is asked to."""


class Process:
    """One process.

    Args:
        name: the component's name on the exchange.
        clock: the run's clock.
        exchange: of the run.
        start: makes the component; called at the start and at each restart.
        end: called with a component that was killed, once its messages are no longer delivered.

    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        exchange: Exchange,
        start: "Callable[[Process], Component]",
        end: Callable[[Any], None],
    ) -> None:
        self.name = name
        self.clock: Clock = clock
        self.component: Component | None = None
        """The running component; None while the process is dead."""
        self.starts = 0
        """Number of times that it was started."""
        self._exchange = exchange
        self._start = start
        self._end = end
        self._faults: dict[int, FaultSpec] = {}
        self.is_hanging = self._is_slow = False
        self.sound: Component | None = None
        """The component while it runs without a fault, which then steps without further checks."""
        self._true_clock = clock
        self._step_ns = 0
        self._start_ns = 0

    @property
    def is_awake(self) -> bool:
        """Whether it runs, and does not hang."""
        return self.component is not None and not self.is_hanging

    @property
    def period_s(self) -> float:
        """Time between two of its steps, if it is slow; else 0."""
        return max((fault.period_s or 0.0 for fault in self._faults.values()), default=0.0)

    def start(self) -> None:
        """Start it, if it is dead and no fault keeps it so; a failed start is repeated, as by a supervisor."""
        if self.component is not None or self._has(FaultKind.KILL):
            return
        self.starts += 1
        # As live processes do, it reads the machine's wall clock once.
        skews_s = (each.skew_s or 0.0 for each in self._faults.values())
        skew_ns = to_ns(sum(skews_s))
        self.clock = SkewedClock(self._true_clock, skew_ns) if skew_ns else self._true_clock
        try:
            self.component = self._start(self)
            self.sound = None if self._faults else self.component
        except RobrainError as error:
            self._exchange.drop(self.name)
            self._start_ns = self._true_clock.now_ns() + RESTART_NS
            logger.warning("%s cannot start: %s", self.name, error)

    def set(self, number: int, fault: FaultSpec, *, begins: bool) -> None:
        """A fault of the process begins or ends."""
        if begins:
            self._faults[number] = fault
        else:
            del self._faults[number]
        if fault.kind is FaultKind.KILL:
            if begins:
                self._kill()
            else:
                self.start()
        self.is_hanging, self._is_slow = self._has(FaultKind.HANG), self._has(FaultKind.SLOW)
        self.sound = None if self._faults else self.component
        if self.component is not None and (self.is_hanging or self._is_slow):
            self._exchange.sleep(self.name)
        else:
            self._exchange.wake(self.name)

    def step(self, now_ns: int) -> None:
        """Run its step, if it can and is not too slow."""
        if self.component is None and now_ns >= self._start_ns:
            self.start()
        component, exchange = self.component, self._exchange
        if component is None or self.is_hanging or (self._is_slow and now_ns < self._step_ns):
            return
        if self._is_slow:
            self._step_ns = now_ns + to_ns(self.period_s)
            exchange.wake(self.name)
        component.step()
        if self._is_slow:
            exchange.sleep(self.name)

    def close(self) -> None:
        """End it."""
        if self.component is not None:
            self.component.close()
            self.component = self.sound = None

    def _kill(self) -> None:
        component, self.component = self.component, None
        self._exchange.drop(self.name)
        if component is not None:
            self._end(component)

    def _has(self, kind: FaultKind) -> bool:
        return any(fault.kind is kind for fault in self._faults.values())


class JournalDisk:
    """Holds the journal between two lives of a coordinator.

    Args:
        name: base of its journals' names, with a number.

    """

    def __init__(self, name: str = "disk") -> None:
        self.is_full = False
        """Whether writes fail."""
        self._kept = sqlite3.connect(":memory:")
        self._connection: sqlite3.Connection | None = None
        self._name, self._names = name, 0

    def open(self) -> Journal:
        """The journal as the last coordinator left it."""
        disk = self

        class DiskConnection(_Connection):
            of: ClassVar[JournalDisk] = disk

        return Journal(factory=DiskConnection, new_name=self._new_name)

    def pull(self) -> None:
        """The coordinator is killed: its committed changes stay, and nothing is written any more."""
        if self._connection is not None:
            if self._connection.in_transaction:
                self._connection.rollback()
            self._connection.backup(self._kept)
            self._connection = None

    def _new_name(self) -> str:
        self._names += 1
        return f"{self._name}-{self._names}"

    def attach(self, connection: sqlite3.Connection) -> None:
        """A coordinator has opened it."""
        self._kept.backup(connection)
        self._connection = connection


class _Connection(sqlite3.Connection):
    of: ClassVar[JournalDisk]

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.of.attach(self)

    def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        """As SQLite's, unless the disk is full and this would write."""
        if self.of.is_full and statement.startswith(("INSERT", "UPDATE")):
            error = sqlite3.OperationalError("database or disk is full")
            error.sqlite_errorcode = sqlite3.SQLITE_FULL
            raise error
        return super().execute(statement, *values)
