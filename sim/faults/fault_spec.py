"""Faults: of a robot's hardware, of processes, of the wire and of the journal's disk; `[[faults]]` of a scenario.

Their times are fixed, after an event, or drawn from the seed.
"""

from collections.abc import Sequence
from enum import StrEnum
from heapq import heappop, heappush
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from robrain.protocol.clock import to_ns
from robrain.protocol.model.checked import Checked
from robrain.protocol.model.ranges import NotNegative, Share
from robrain.sim.errors import ScenarioError

COORDINATOR = "coordinator"
"""Names the coordinator where a fault may be of a robot or of the coordinator."""
LATEST_S = 60.0
"""Limit of the delay of a message."""
SKEW_MAX_S = 7 * 86_400.0


class FaultKind(StrEnum):
    """Kind of a fault."""

    CAN_CUT = "can_cut"
    """The CAN bus is cut: no frame passes, without an error."""
    CAN_SHORTED = "can_shorted"
    """The CAN bus is shorted: no frame passes, and the controllers go bus off."""
    MOTORS_FAIL = "motors_fail"
    """The motor controller's power stage fails, and its status reports it."""
    LIDAR_FREEZES = "lidar_freezes"
    """The lidar repeats its last turn."""
    BATTERY_LIES = "battery_lies"
    """The battery manager reports a full battery at rest."""
    MOTE_BASE_FLOODS = "mote_base_floods"
    """The base station delivers thousands of packets a second."""
    CARRIED_OFF = "carried_off"
    """The robot is picked up and put down at `place_m`; its wheels do not turn."""
    KILL = "kill"
    """The process is killed; at `until_s` another one is started."""
    HANG = "hang"
    """The process stands still; its token stays, messages wait, queries are not answered."""
    SLOW = "slow"
    """The process runs a step only every `period_s`."""
    CLOCK_SKEW = "clock_skew"
    """The machine's wall clock is `skew_s` ahead; processes that start meanwhile keep that offset."""
    DISK_FULL = "disk_full"
    """The coordinator's journal cannot be written."""
    DRAIN = "drain"
    """The battery's charge falls to `soc` at once."""
    LOSE = "lose"
    """A `share` of the messages, requests and replies from and to the component is lost."""
    DELAY = "delay"
    """Messages and requests from and to the component are late by `late_s`, in order."""
    REORDER = "reorder"
    """Messages and requests are late, each by its own random time, so that later ones overtake earlier ones."""
    PARTITION = "partition"
    """The component, with those in `side`, and all others do not receive each other's messages."""


HARDWARE = frozenset(
    (
        FaultKind.CAN_CUT,
        FaultKind.CAN_SHORTED,
        FaultKind.MOTORS_FAIL,
        FaultKind.LIDAR_FREEZES,
        FaultKind.BATTERY_LIES,
        FaultKind.MOTE_BASE_FLOODS,
        FaultKind.CARRIED_OFF,
    )
)
"""Faults of a robot's hardware, which its plugins must find out for themselves."""
PROCESS = frozenset((FaultKind.KILL, FaultKind.HANG, FaultKind.SLOW, FaultKind.CLOCK_SKEW))
"""Faults of a process: a robot's agent, or the coordinator."""
WIRE = frozenset((FaultKind.LOSE, FaultKind.DELAY, FaultKind.REORDER, FaultKind.PARTITION))
"""Faults of the wire."""
OF_ROBOTS = HARDWARE | {FaultKind.DRAIN}
"""Faults that the coordinator cannot have."""


class FaultMoment(StrEnum):
    """Event that a fault waits for."""

    TASK_ASSIGNED = "task_assigned"
    """The robot, or any robot for the coordinator, begins a task."""
    TASK_DONE = "task_done"
    """It has done a task."""
    DOCKED = "docked"
    """It has come to a charger."""
    TASK_ACCEPTED = "task_accepted"
    """The coordinator has acknowledged a task; for faults of any component."""


Side = Annotated[tuple[str, ...], Meta(max_length=1000)]

OPTIONS: dict[str, frozenset[FaultKind]] = {
    "period_s": frozenset((FaultKind.SLOW,)),
    "skew_s": frozenset((FaultKind.CLOCK_SKEW,)),
    "soc": frozenset((FaultKind.DRAIN,)),
    "share": frozenset((FaultKind.LOSE,)),
    "late_s": frozenset((FaultKind.DELAY, FaultKind.REORDER)),
    "place_m": frozenset((FaultKind.CARRIED_OFF,)),
}
"""Keys that these kinds require and others must not have."""


class FaultSpec(Checked, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """`[[faults]]`: a failure at a given time or event. Raises ValueError if its values are inconsistent."""

    robot: str
    """Name of the component, a robot such as `r1` or `coordinator`."""
    kind: FaultKind
    at_s: NotNegative
    """Simulated time at which it begins; with `on`, time after that event."""
    until_s: float | None = None
    """Simulated time at which it ends, counted like `at_s`; never if absent."""
    on: FaultMoment | None = None
    """Event after which it begins, once."""
    within_s: NotNegative = 0.0
    """Greatest delay of its beginning and end; the run's seed determines the delay, from 0 to this."""
    period_s: Annotated[float, Meta(gt=0, le=LATEST_S)] | None = None
    """`slow`: time between two steps."""
    skew_s: Annotated[float, Meta(ge=-SKEW_MAX_S, le=SKEW_MAX_S)] | None = None
    """`clock_skew`: how far the clock is ahead; negative if it is behind."""
    soc: Share | None = None
    """`drain`: the remaining state of charge, 0 to 1."""
    share: Annotated[float, Meta(gt=0, le=1)] | None = None
    """`lose`: share of lost messages, above 0 to 1."""
    late_s: tuple[float, float] | None = None
    """`delay`, `reorder`: least and greatest delay."""
    side: Side = ()
    """`partition`: components on the robot's side of the cut."""
    place_m: tuple[float, float] | None = None
    """`carried_off`: where the robot is put down, x and y in the arena frame."""
    yaw_rad: float = 0.0
    """`carried_off`: the robot's yaw there."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_times()
        for name, kinds in OPTIONS.items():
            if (self.kind in kinds) != (getattr(self, name) is not None):
                raise ValueError(f"expected {name} for {' and '.join(sorted(kinds))}, and for nothing else")
        if self.side and self.kind is not FaultKind.PARTITION:
            raise ValueError(f"expected side for {FaultKind.PARTITION} alone, got it for {self.kind}")
        if self.late_s is not None and not 0 <= self.late_s[0] <= self.late_s[1] <= LATEST_S:
            raise ValueError(f"expected late_s as [least, greatest] from 0 to {LATEST_S:g} s, got {list(self.late_s)}")
        if self.kind is FaultKind.DISK_FULL and self.robot != COORDINATOR:
            raise ValueError(f"expected robot = '{COORDINATOR}' for {FaultKind.DISK_FULL}, got {self.robot!r}")
        if self.kind in OF_ROBOTS and self.robot == COORDINATOR:
            raise ValueError(f"expected the name of a robot for {self.kind}, got {self.robot!r}")

    @property
    def is_plain(self) -> bool:
        """Whether it is of a robot's hardware, and at times that are set."""
        return self.kind in HARDWARE and self.on is None and not self.within_s

    def _check_times(self) -> None:
        if self.kind is FaultKind.DRAIN and self.until_s is not None:
            raise ValueError(f"expected no until_s for {self.kind}: it has no end")
        if self.kind is FaultKind.CARRIED_OFF and self.until_s is not None:
            raise ValueError(f"expected no until_s for {self.kind}: the robot stays where it is put down")
        if self.until_s is not None and not self.until_s > self.at_s:
            raise ValueError(f"expected until_s > at_s = {self.at_s:g}, got {self.until_s}")


def check_faults_alone(where: str, *, is_alone: bool) -> None:
    """Check that no other process joins a run with such faults: it could not be cut off from anybody.

    Raises:
        ScenarioError: one may; names `where`.

    """
    if not is_alone:
        raise ScenarioError(
            f"{where}: faults: expected a run that no other process can join, got one with a dashboard or a port to "
            "listen on: run it without them and look at its recording, or leave out faults that are not of hardware"
        )


def faults_refusal(faults: Sequence[FaultSpec], robots: Sequence[str]) -> str:
    """Reason why a run cannot have these faults, in one sentence; empty if it can."""
    for fault in faults:
        for name in (fault.robot, *fault.side):
            if name not in (*robots, COORDINATOR):
                there = f"r1 to r{len(robots)}"
                return f"no robot {name!r}; there are {there if fault.kind in OF_ROBOTS else f'{COORDINATOR}, {there}'}"
    return ""


_RNG_OF_FAULTS = 7


class FaultChange(NamedTuple):
    """A fault that begins or ends now."""

    number: int
    """Of the fault, in the order of the scenario."""
    fault: FaultSpec
    begins: bool


class FaultTimes:
    """Gives the faults that begin and end.

    Args:
        faults: of the scenario.
        seed: of the run.

    """

    def __init__(self, faults: Sequence[FaultSpec], seed: int) -> None:
        self._due: list[tuple[int, int, bool]] = []
        self._faults = tuple(faults)
        self._waiting: list[int] = []
        self._later_ns = [
            to_ns(float(np.random.default_rng([seed, _RNG_OF_FAULTS, number]).uniform(0.0, fault.within_s)))
            for number, fault in enumerate(faults)
        ]
        for number, fault in enumerate(faults):
            if fault.on is None:
                self._begin(number, 0)
            else:
                self._waiting.append(number)

    @property
    def is_over(self) -> bool:
        """Whether no fault begins or ends any more, unless a fault still waits for an event."""
        return not self._due

    def record(self, moment: FaultMoment, robot: str, now_ns: int) -> None:
        """An event has happened to a robot, or the coordinator."""
        for number in list(self._waiting):
            fault = self._faults[number]
            if fault.on is moment and (COORDINATOR in (fault.robot, robot) or fault.robot == robot):
                self._waiting.remove(number)
                self._begin(number, now_ns)

    def due(self, now_ns: int) -> list[FaultChange]:
        """Faults that begin or end by now and were not returned before, in order of time."""
        found = []
        while self._due and self._due[0][0] <= now_ns:
            _, number, begins = heappop(self._due)
            found.append(FaultChange(number, self._faults[number], begins))
        return found

    def _begin(self, number: int, from_ns: int) -> None:
        fault = self._faults[number]
        start_ns = from_ns + self._later_ns[number]
        heappush(self._due, (start_ns + to_ns(fault.at_s), number, True))
        if fault.until_s is not None:
            heappush(self._due, (start_ns + to_ns(fault.until_s), number, False))
