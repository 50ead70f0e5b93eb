"""A door keeper opens its door for robots that request it, and reports a door that does not open."""

import itertools

import pytest

from robrain.client.door_keeper import DoorKeeper, DoorUnavailable
from robrain.protocol.clock import VirtualClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition
from robrain.protocol.model.claim import Reservation
from robrain.protocol.wire.endpoint import Endpoint

OPEN, CLOSED, FAILED = DoorPosition.OPEN, DoorPosition.CLOSED, DoorPosition.FAILED


class Door:
    """A controller that opens at once, unless it is stuck or unreachable."""

    is_ordered = is_stuck = False
    trouble = ""

    def open(self) -> None:
        self._order(is_ordered=True)

    def close(self) -> None:
        self._order(is_ordered=False)

    def state(self) -> bool:
        return self.is_ordered and not self.is_stuck

    def _order(self, *, is_ordered: bool) -> None:
        if self.trouble:
            raise DoorUnavailable(self.trouble)
        self.is_ordered = is_ordered


class Gate:
    """A keeper with its door, and robots that request it."""

    def __init__(self, wire: Endpoint) -> None:
        self.door = Door()
        assert isinstance(wire.clock, VirtualClock)
        self._clock = wire.clock
        self.keeper = DoorKeeper("gate", self.door, wire, opening_s=2.0, timeout_s=8.0)
        self._states = {name: wire.publisher(ROBOT_STATE, robot=name) for name in ("r1", "r2")}
        self._last: DoorPosition | None = None
        self._inbox = Inbox(every=True)
        wire.subscribe(self._inbox, DOOR_STATE)

    def pass_s(self, seconds: float, *robots: str, has: bool = True, by: str = "") -> list[DoorPosition]:
        """Step, with requests of these robots; returns the changes of the published position."""
        for _ in range(round(seconds / 0.1)):
            self._clock.advance_to(self._clock.now_ns() + 100_000_000)
            for robot in robots:
                own = Reservation(robot=by or robot, zones=("gate",), since_ns=1, has=has)
                self._states[robot].put(RobotState(robot=robot, reservations=(own,)))
            self.keeper.step()
        positions = [self._last, *(received.message.position for received in self._inbox.drain())]
        self._last = positions[-1]
        return [one for before, one in itertools.pairwise(positions) if one is not before and one is not None]


@pytest.fixture
def gate(wire: Endpoint) -> Gate:
    return Gate(wire)


def test_a_door_is_open_while_any_robot_that_may_pass_requests_it(gate: Gate) -> None:
    assert gate.pass_s(2.0) == [CLOSED]
    assert gate.pass_s(2.0, "r1", "r2") == [OPEN]
    assert gate.pass_s(2.0, "r2") == []
    assert gate.pass_s(1.0, "r1", "r2", has=False) == [CLOSED]


def test_a_robot_that_waits_for_the_zone_or_reports_the_request_of_another_does_not_open_it(gate: Gate) -> None:
    assert gate.pass_s(2.0, "r1", has=False) == [CLOSED]
    assert gate.pass_s(2.0, "r1", by="r2") == []


def test_a_robot_that_falls_silent_holds_a_door_for_ten_seconds(gate: Gate) -> None:
    gate.pass_s(1.0, "r1")
    assert gate.pass_s(9.0) == []
    assert gate.pass_s(2.0) == [CLOSED]


def test_a_door_that_is_not_open_in_time_has_failed_until_it_opens(gate: Gate) -> None:
    gate.door.is_stuck = True
    assert gate.pass_s(7.0, "r1") == [CLOSED]
    assert gate.pass_s(2.0, "r1") == [FAILED]
    assert gate.keeper.state.why == "it was not open after 8 s"
    assert gate.pass_s(30.0) == []
    gate.door.is_stuck = False
    assert gate.pass_s(2.0) == [OPEN, CLOSED]
    assert gate.keeper.state.why == ""


def test_a_door_whose_controller_does_not_answer_has_failed_with_the_cause(gate: Gate) -> None:
    gate.pass_s(1.0)
    gate.door.trouble = "the controller cannot be reached"
    assert gate.pass_s(1.0) == [FAILED]
    assert gate.keeper.state.why == gate.door.trouble
    gate.door.trouble = ""
    assert gate.pass_s(2.0) == [OPEN, CLOSED]
