"""The base of all judges of invariants: their input and their rulings."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

from robrain.protocol.clock import to_seconds
from robrain.protocol.model.geometry import Point2D
from robrain.recording.invariants.findings import (
    AnyFinding,
    Breach,
    Invariant,
    InvariantState,
    MissingEvidence,
    Ruling,
    breach_text,
    missing_text,
)

KEPT_BREACHES = 10
"""Breaches of an invariant that are kept one by one; the rest is counted."""

Handler = Callable[[Any, int], None]
"""Receives a message and the time at which it was recorded, in ns."""


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


NOWHERE = Surroundings()
"""The place is unknown."""


class InvariantJudge:
    """Judges one invariant, message by message, with memory that does not grow with the length of the run.

    Args:
        surroundings: of the run.
        start_ns: the run's clock at its start.

    """

    invariant: ClassVar[Invariant]

    def __init__(self, surroundings: Surroundings, start_ns: int) -> None:
        self.surroundings = surroundings
        self.cases = 0
        """Number of cases judged so far."""
        self.missing: MissingEvidence | None = None
        """Evidence without which it cannot be judged in full."""
        self._start_ns = start_ns
        self._broken = 0
        self._breaches: list[Breach] = []

    def handlers(self) -> Mapping[type, Handler]:
        """Handlers by type of message."""
        raise NotImplementedError

    def lacks(self) -> MissingEvidence | None:
        """Evidence that is missing at the end of the run; None if the invariant could be judged."""
        return self.missing

    def ruling(self) -> Ruling:
        """Verdict on the invariant, when the run has ended."""
        missing = self.lacks()
        standing = (
            InvariantState.BROKEN if self._broken else InvariantState.NOT_JUDGED if missing else InvariantState.KEPT
        )
        return Ruling(
            invariant=self.invariant,
            standing=standing,
            cases=self.cases,
            broken=self._broken,
            breaches=self._breaches,
            missing=missing,
            why=missing_text(missing) if missing is not None else "",
        )

    def break_(self, time_ns: int, finding: AnyFinding) -> None:
        """Note a breach."""
        self._broken += 1
        if len(self._breaches) < KEPT_BREACHES:
            time_s = self.time_s(time_ns)
            self._breaches.append(Breach(time_s=time_s, finding=finding, text=breach_text(time_s, finding)))

    def time_s(self, time_ns: int) -> float:
        """Time since the start of the run."""
        return round(to_seconds(time_ns - self._start_ns), 3)
