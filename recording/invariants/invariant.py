"""The invariants of a run, the verdicts on them, and the base of their judges."""

from collections.abc import Callable
from enum import StrEnum
from typing import Any, ClassVar, NamedTuple, Self

import msgspec

from robrain.protocol.clock import to_seconds
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskEvent
from robrain.protocol.messages.team.arena_messages import ArenaTruth
from robrain.protocol.messages.team.team_messages import Halt, TeamState
from robrain.protocol.messages.team.zone_messages import Zones
from robrain.protocol.model.geometry import Point2D

KEPT_BREACHES = 10
"""Breaches of an invariant that are kept one by one; the rest is counted."""


class Invariant(StrEnum):
    """A condition that every run must satisfy."""

    words: str
    """The condition in words."""
    case: str
    """The noun of a case, perhaps with another word."""

    def __new__(cls, value: str, words: str, case: str) -> Self:
        """Make the invariant, its name on the wire first."""
        member = str.__new__(cls, value)
        member._value_, member.words, member.case = value, words, case
        return member

    TASK_KEPT = "task_kept", "no task is lost", "task"
    """No accepted task is lost."""
    TASK_AT_ONE = "task_at_one", "no task is at two robots", "task"
    """No task is at two robots for longer than a lease."""
    TASK_ONCE = "task_once", "no task is done twice", "task done"
    """No task is done twice."""
    NOT_STRANDED = "not_stranded", "no robot is stranded", "robot"
    """No robot is without energy away from a charger."""
    WALLS = "walls", "no wall is crossed", "pose"
    """No robot's footprint is inside a wall."""
    HALTS = "halts", "halts are obeyed", "halt"
    """Halts are obeyed."""
    ENERGY = "energy", "energy balances", "robot"
    """Energy balances: delivered energy never falls, and charge rises at chargers only."""
    MUTUAL_WAIT = "mutual_wait", "no two robots are stuck", "robot"
    """No two robots wait for each other for long."""
    ZONES = "zones", "zones are obeyed", "zone"
    """Zones are obeyed."""


class InvariantState(StrEnum):
    """Verdict on an invariant at the end of a run."""

    KEPT = "kept"
    BROKEN = "broken"
    NOT_JUDGED = "not_judged"


class MissingEvidence(StrEnum):
    """Reason why an invariant could not be judged: missing data in the messages."""

    words: str
    """The reason in words; `it` is the recording."""

    def __new__(cls, value: str, words: str) -> Self:
        """Make the reason, its name in files first."""
        member = str.__new__(cls, value)
        member._value_, member.words = value, words
        return member

    BATTERIES = "batteries", "no robot reports a battery"
    EVENTS = "events", "changes of tasks are missing in it"
    FLOOR = "floor", "the floor plan is not known"
    RADIUS = "radius", "no robot reports its radius"
    ROBOTS = "robots", "no robot reports its state"
    SIMULATOR = "simulator", "the floor plan needs the simulator: pip install 'robrain[sim]'"
    START = "start", "it begins in the middle of a run"
    SUMMARIES = "summaries", "it has no summaries of the coordinator"
    TASKS = "tasks", "it has no changes of tasks"
    TRUTH = "truth", "it has no ground truth"
    ZONES = "zones", "it has no zones"


class Breach(msgspec.Struct, frozen=True, kw_only=True):
    """A breach of an invariant; times are seconds since the run's first message."""

    time_s: float
    finding: dict[str, Any]
    """Its `code`, and the values of its sentence: robot or task, figures."""
    text: str
    """In one sentence; no decision depends on it."""


class Ruling(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict on one invariant."""

    invariant: Invariant
    state: InvariantState
    cases: int = 0
    """Number of judged tasks, poses, robots or halts."""
    broken: int = 0
    """Number of breaches."""
    breaches: list[Breach] = []
    """The first ones."""
    missing: MissingEvidence | None = None
    """Reason why it was not judged, or not in full."""
    reason: str = ""
    """The same in words."""

    @property
    def more(self) -> int:
        """Breaches that are not listed."""
        return self.broken - len(self.breaches)

    @property
    def cases_text(self) -> str:
        """Amount that was judged, such as `12 tasks`."""
        noun, *more = self.invariant.case.split()
        return " ".join((str(self.cases), noun if self.cases == 1 else f"{noun}s", *more))


class FloorCharger(NamedTuple):
    """A charger on the floor."""

    place: Point2D
    """Arena frame."""
    reach_m: float
    """Greatest distance at which it charges a robot's centre."""


class Surroundings(NamedTuple):
    """Facts about the place of a run that its messages do not contain."""

    clearance_m: Callable[[float, float], float] | None = None
    """Distance from a place (x, y), arena frame, to the nearest wall, 0 inside one; None if the floor is not known."""
    chargers: tuple[FloorCharger, ...] | None = None
    """Every charger; None if they are not known."""
    no_floor: MissingEvidence = MissingEvidence.FLOOR
    """Reason why there is no floor, if there is none."""

    def charger_distance_m(self, place: Point2D) -> float | None:
        """Distance to the nearest charger; None if chargers are not known or there are none."""
        return min((place.distance_m(charger.place) for charger in self.chargers or ()), default=None)

    def is_at_charger(self, place: Point2D, slack_m: float) -> bool:
        """Whether a known charger is within its reach and a slack."""
        return any(place.distance_m(at) <= reach_m + slack_m for at, reach_m in self.chargers or ())


UNKNOWN_SURROUNDINGS = Surroundings()
"""The place is unknown."""


class InvariantJudge:
    """Judges one invariant, message by message, with memory that does not grow with the length of the run.

    Args:
        surroundings: of the run.
        start_ns: the run's clock at its start.

    """

    invariant: ClassVar[Invariant]
    evidence: ClassVar[MissingEvidence]
    """Missing evidence if there was no case."""

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        self.surroundings = surroundings
        self.cases = 0
        """Number of cases judged so far."""
        self._start_ns = start_ns
        self._broken = 0
        self._breaches: list[Breach] = []

    def handle_state(self, state: RobotState, time_ns: int) -> None:
        """A robot's state; `time_ns` is the time at which a message was recorded."""

    def handle_event(self, event: TaskEvent, time_ns: int) -> None:
        """A change of a task."""

    def handle_summary(self, summary: TeamState, time_ns: int) -> None:
        """A summary of the coordinator."""

    def handle_halt(self, halt: Halt, time_ns: int) -> None:
        """A halt of the team, or its end."""

    def handle_truth(self, truth: ArenaTruth, time_ns: int) -> None:
        """The ground truth."""

    def handle_zones(self, zones: Zones, time_ns: int) -> None:
        """The zones that hold from now on."""

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing at the end of the run; None if the invariant could be judged."""
        return None if self.cases else self.evidence

    def ruling(self) -> Ruling:
        """Verdict on the invariant, when the run has ended."""
        missing = self.lacks()
        state = InvariantState.BROKEN if self._broken else InvariantState.NOT_JUDGED if missing else InvariantState.KEPT
        return Ruling(
            invariant=self.invariant,
            state=state,
            cases=self.cases,
            broken=self._broken,
            breaches=self._breaches,
            missing=missing,
            reason=missing.words if missing is not None else "",
        )

    def break_(self, time_ns: int, code: str, text: str, values: dict[str, Any]) -> None:
        """Record a breach: its kind, its sentence without the time, and the values in it."""
        self._broken += 1
        if len(self._breaches) < KEPT_BREACHES:
            time_s = self.time_s(time_ns)
            text = f"at {time_s:g} s {text}"
            self._breaches.append(Breach(time_s=time_s, finding={"code": code, **values}, text=text))

    def time_s(self, time_ns: int) -> float:
        """Time since the start of the run."""
        return round(to_seconds(time_ns - self._start_ns), 3)
