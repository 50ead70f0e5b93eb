"""Area gate: reserved zones and doors on a path, which the robot enters once it may."""

from collections.abc import Callable
from typing import NamedTuple

import msgspec

from robrain.agent.environment import Environment
from robrain.algorithms.navigation.reservations import ReservedArea
from robrain.algorithms.navigation.right_of_way import STEP_M
from robrain.algorithms.numeric.kernel_array import Floats
from robrain.plugins.skill.mapper.mapper import MapCells
from robrain.plugins.unit.teammates import TeammatesInterface
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition, DoorState
from robrain.protocol.model.claim import ZoneNames
from robrain.protocol.model.ranges import Name

REQUEST_M = 3.0
"""Length of path before an area at which the robot requests it (chosen): 5 s at 0.6 m/s, as an answer takes 0.5 s."""
OUTSIDE_M = 0.15
"""Distance between a robot that waits, or has left, and an area."""
TOUCH_M = 0.03
"""A robot this near to an area is in it."""
DOOR_FRESH_NS = to_ns(5.0)
"""An older state of a door does not count: robots wait before it."""


DOOR_PATIENCE_S = 60.0
"""Wait before a door after which the path counts as blocked (chosen: doors report a failure earlier)."""


class Crossing(NamedTuple):
    """An area on a path."""

    area: ReservedArea
    first: int
    """The first position in it, or too near to it to wait there."""
    is_there: bool
    """Whether the robot is in it already."""
    is_entered: bool
    """Whether the path leads into it; otherwise the robot is leaving it."""


class AreaWait(msgspec.Struct, frozen=True):
    """The area before which a robot waits."""

    at: Name
    """Name of the door, or of the first zone of the area."""
    robots: list[str] = []
    """Robots for which it waits, those that are there first; none before a door."""


class AreaGate:
    """Requests areas for one travel.

    Args:
        env: the behavior's environment.
        teammates: of the robot; they hold its requests.
        view: the map as it is now.
        radius_m: of the robot.

    """

    def __init__(
        self, env: Environment, teammates: TeammatesInterface, view: Callable[[], MapCells], radius_m: float
    ) -> None:
        self._clock, self._teammates, self._view = env.clock, teammates, view
        self._touch_m, self._outside_m = radius_m + TOUCH_M, radius_m + OUTSIDE_M
        self._inbox = Inbox()
        env.wire.subscribe(self._inbox, DOOR_STATE)
        self._doors: dict[str, tuple[DoorState, int]] = {}
        """The last state of each door, and when it arrived."""
        self._granted: set[ZoneNames] = set()
        self.is_in_use = False
        """Whether the robot has requested areas."""
        self._since_ns = 0
        """Time since which it waits where it waits now."""
        self.waited_at = ""
        """The door before which the robot last waited."""
        self.wait: AreaWait | None = None
        """Where the robot waits now; None if it may go."""

    @property
    def has_waited_too_long(self) -> bool:
        """Whether a door has not opened for `DOOR_PATIENCE_S`."""
        is_at_door = self.wait is not None and not self.wait.robots
        return is_at_door and self._clock.now_ns() - self._since_ns > to_ns(DOOR_PATIENCE_S)

    @property
    def shut_door(self) -> str:
        """The door before which the robot last waited, if it does not open; empty if there is none."""
        is_usable = any(self.waited_at in area.doors for area in self._view().areas)
        return "" if is_usable and not self.has_waited_too_long else self.waited_at

    def limit(self, ahead: Floats) -> int:
        """Request the areas on a path, release all others, and return how many of its positions (N, 2) are open."""
        last, self.wait = self.wait, None
        if not self._view().areas and not self.is_in_use:
            return len(ahead)
        crossed = self._crossed(ahead)
        waits = self._teammates.reserve([(one.area, one.is_there) for one in crossed])
        self.is_in_use = bool(crossed)
        self._granted = {names for names, robots in waits.items() if not robots}
        for crossing in crossed:
            self.wait = self._wait_of(crossing, waits[crossing.area.names])
            if self.wait is not None:
                is_same_door = last is not None and last.at == self.wait.at and not (last.robots or self.wait.robots)
                self._since_ns = self._since_ns if is_same_door else self._clock.now_ns()
                self.waited_at = self.waited_at if self.wait.robots else self.wait.at
                return max(1, crossing.first)
        return len(ahead)

    def opening_s(self, positions: Floats) -> float:
        """Time that the doors on a path (N, 2) take to open, those at its begin excepted."""
        found_s = 0.0
        for area in self._view().areas:
            if area.doors and area.may_meet(positions, self._touch_m):
                distance_m = area.distance_m(positions)
                if distance_m.min() < self._touch_m < distance_m[0]:
                    found_s += max(self._door(door)[1] for door in area.doors)
        return found_s

    def wanted(self, here: Floats) -> ReservedArea | None:
        """The area at a position (1, 2) that an idle robot is to leave: a doorway, or one for which another waits."""
        areas = (one.area for one in self._crossed(here))
        return next((area for area in areas if area.doors or self._teammates.is_wanted(area)), None)

    def _crossed(self, ahead: Floats) -> list[Crossing]:
        """Areas on the path, in its order."""
        found = []
        ahead = ahead[: round(REQUEST_M / STEP_M)]
        for area in self._view().areas:
            if not area.may_meet(ahead, self._outside_m):
                continue
            distance_m = area.distance_m(ahead)
            is_entered = bool(distance_m.min() < self._touch_m)
            if is_entered or (area.names in self._granted and distance_m[0] < self._outside_m):
                first = int((distance_m < self._outside_m).argmax())
                found.append(Crossing(area, first, bool(distance_m[0] < self._touch_m), is_entered))
        return sorted(found, key=lambda crossing: (crossing.first, crossing.area.names))

    def _wait_of(self, crossing: Crossing, robots: list[str]) -> AreaWait | None:
        area = crossing.area
        if robots:
            return AreaWait(area.names[0], robots)
        if crossing.is_there or not crossing.is_entered:
            return None
        for door in area.doors:
            if not self._door(door)[0]:
                return AreaWait(door)
        return None

    def _door(self, door: str) -> tuple[bool, float]:
        """Whether a door is open, and the time that it usually takes to open; 0 if that is unknown."""
        now_ns = self._clock.now_ns()
        for received in self._inbox.drain():
            self._doors[received.message.door] = received.message, now_ns
        state, received_ns = self._doors.get(door, (None, 0))
        if state is None:
            return False, 0.0
        return state.position is DoorPosition.OPEN and now_ns - received_ns <= DOOR_FRESH_NS, state.opening_s
