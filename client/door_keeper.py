"""Door keeper: opens a door while robots request it, and reports its position. One for each door of a team."""

from typing import Protocol

import msgspec

from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.door_messages import DOOR_STATE, DoorPosition, DoorState
from robrain.protocol.model.ranges import cut
from robrain.protocol.wire.endpoint import Endpoint

HOLD_NS = to_ns(10.0)
"""A robot that is silent for longer no longer holds a door (chosen: a cut link is often back by then)."""
POLL_NS, PUBLISH_NS = to_ns(0.2), to_ns(1.0)
"""Periods in which the controller is asked, and the state is published."""


class DoorUnavailable(Exception):
    """A door's controller does not answer; the text is the cause."""


class DoorDriver(Protocol):
    """A door's controller. Each method may raise DoorUnavailable."""

    def open(self) -> None:
        """Order the door to open; repeated five times a second."""

    def close(self) -> None:
        """Order the door to close, or permit it to; repeated in the same way."""

    def state(self) -> bool:
        """Whether a robot can pass."""


class DoorKeeper:
    """Opens one door for robots that request it.

    A door that is not open in time has failed. It is then ordered to open until it does, so that robots use it again.

    Args:
        door: the name of its zone.
        driver: its controller.
        wire: receives the robots' states, and publishes the door's.
        opening_s: time that it usually takes to open.
        timeout_s: time after which it has failed.

    """

    def __init__(
        self, door: str, driver: DoorDriver, wire: Endpoint, *, opening_s: float, timeout_s: float = 20.0
    ) -> None:
        self._driver, self._clock = driver, wire.clock
        self._timeout_s, self._timeout_ns = timeout_s, to_ns(timeout_s)
        self._inbox = Inbox()
        wire.subscribe(self._inbox, ROBOT_STATE)
        self._publisher = wire.publisher(DOOR_STATE, door=door)
        self.state = DoorState(door=door, position=DoorPosition.CLOSED, opening_s=opening_s)
        self._requested: dict[str, int] = {}
        """When each robot that requests it last did."""
        self._since_ns: int | None = None
        """Time since which it has been ordered to open; None while it has not."""
        self._poll_ns = self._publish_ns = 0

    def step(self) -> None:
        """Receive requests, order the door, and report it."""
        now_ns = self._clock.now_ns()
        if now_ns < self._poll_ns:
            return
        self._poll_ns = now_ns + POLL_NS
        has_failed = self.state.position is DoorPosition.FAILED
        opens = self._is_requested(now_ns) or has_failed
        self._since_ns = (self._since_ns or now_ns) if opens else None
        position, why = DoorPosition.OPEN, ""
        try:
            if opens:
                self._driver.open()
            else:
                self._driver.close()
            if not self._driver.state():
                is_late = now_ns - (self._since_ns or now_ns) > self._timeout_ns
                position = DoorPosition.FAILED if has_failed or is_late else DoorPosition.CLOSED
                why = f"it was not open after {self._timeout_s:g} s" if position is DoorPosition.FAILED else ""
        except DoorUnavailable as error:
            position, why = DoorPosition.FAILED, str(error)
        if position is not self.state.position or now_ns >= self._publish_ns:
            self._publish_ns = now_ns + PUBLISH_NS
            self.state = msgspec.structs.replace(self.state, position=position, why=cut(why))
            self._publisher.put(self.state)

    def _is_requested(self, now_ns: int) -> bool:
        for received in self._inbox.drain():
            state = received.message
            own = [one for one in state.reservations or () if one.robot == state.robot and one.has]
            if any(self.state.door in one.zones for one in own):
                self._requested[state.robot] = now_ns
            else:
                self._requested.pop(state.robot, None)
        self._requested = {name: at_ns for name, at_ns in self._requested.items() if now_ns - at_ns <= HOLD_NS}
        return bool(self._requested)
