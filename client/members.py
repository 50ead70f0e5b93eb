"""The members of a team: who is present, the errors that list them, and the last states that they have sent."""

import time
from collections.abc import Callable

import msgspec

from robrain.client.transport import Transport
from robrain.protocol.errors import NobodyThere
from robrain.protocol.keys import check_name
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_STATE, RobotState
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_STATE, TeamState
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import wrong_team

GATHER_S = 0.5
"""How long to look again for missing members: a token may take this long to reach its hub."""
ASK_AGAIN_S = 0.1
WAIT_S = 2.0
"""Time limit for a first message, live."""
POLL_S = 0.02


class TeamFound(msgspec.Struct, frozen=True, kw_only=True):
    """The present members of a team."""

    team: str
    coordinator: bool
    robots: list[str]
    """Names, sorted."""


def team_found(wire: Endpoint) -> TeamFound:
    """The present members of the endpoint's team."""
    until_s = time.monotonic() + GATHER_S
    while True:
        robots = sorted(names["robot"] for names in wire.present(ROBOT_ALIVE))
        found = TeamFound(team=wire.team, coordinator=bool(wire.present(COORDINATOR_ALIVE)), robots=robots)
        is_complete = (found.robots and found.coordinator) or wire.drive is Drive.LOCKSTEP
        if is_complete or time.monotonic() > until_s:
            return found
        time.sleep(ASK_AGAIN_S)


def no_robot(wire: Endpoint, robot: str, what: str) -> NobodyThere:
    """The error for a robot that did not answer `what`; it lists the robots present, or else the teams."""
    found = team_found(wire)
    if robot in found.robots:
        return NobodyThere(
            f"{robot} does not answer {what}: it may still be starting, or its robrain is older than this one"
        )
    text = f"no robot {robot} in team {wire.team}"
    if not found.robots and not found.coordinator:
        return wrong_team(text, wire)
    return NobodyThere(f"{text}; there are: {', '.join(found.robots) or 'none'}")


class LastStates:
    """Keeps the last states. Live it listens from the first question on: a large team's states are much traffic.

    Args:
        transport: to the team.
        wire: the client's endpoint.

    """

    def __init__(self, transport: Transport, wire: Endpoint) -> None:
        self._transport = transport
        self._wire = wire
        self._robots: dict[str, RobotState] = {}
        self._team: TeamState | None = None
        self._inbox: Inbox | None = None
        if transport.drive is Drive.LOCKSTEP:
            self._receive()

    def robot(self, name: str) -> RobotState:
        """The last state of a robot (NobodyThere if none came)."""
        check_name("robot", name)
        self._receive_until(lambda: name in self._robots)
        if name not in self._robots:
            if name in team_found(self._wire).robots:
                raise NobodyThere(f"{name} has sent no state yet: let some time pass")
            raise no_robot(self._wire, name, "states")
        return self._robots[name]

    def team(self) -> TeamState:
        """The last summary of the coordinator (NobodyThere if none came)."""
        self._receive_until(lambda: self._team is not None)
        if self._team is None:
            raise wrong_team(f"no coordinator of team {self._wire.team} has sent a summary yet", self._wire)
        return self._team

    def _receive_until(self, is_there: Callable[[], bool]) -> None:
        self._receive()
        ends_s = self._transport.elapsed_s() + WAIT_S
        while self._transport.drive is Drive.LIVE and not is_there() and self._transport.elapsed_s() < ends_s:
            self._transport.pass_time(POLL_S)
            self._receive()

    def _receive(self) -> None:
        if self._inbox is None:
            self._inbox = Inbox()
            self._wire.subscribe(self._inbox, ROBOT_STATE)
            self._wire.subscribe(self._inbox, COORDINATOR_STATE)
        for received in self._inbox.drain():
            message = received.message
            if isinstance(message, RobotState):
                self._robots[message.robot] = message
            else:
                self._team = message
