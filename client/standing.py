"""The last states that robots and coordinator have sent."""

from collections.abc import Callable

from robrain.client.members import no_robot, team_found
from robrain.client.transport import Transport
from robrain.protocol.errors import NobodyThere
from robrain.protocol.keys import check_name
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import RobotState
from robrain.protocol.messages.team.team_messages import TeamState
from robrain.protocol.table.topics import COORDINATOR_STATE, ROBOT_STATE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import wrong_team

WAIT_S = 2.0
"""How long a first message is waited for, live."""
POLL_S = 0.02


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
            self._listen()

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

    def _listen(self) -> Inbox:
        inbox = self._inbox = Inbox()
        self._wire.subscribe(inbox, ROBOT_STATE)
        self._wire.subscribe(inbox, COORDINATOR_STATE)
        return inbox

    def _receive(self) -> None:
        inbox = self._inbox if self._inbox is not None else self._listen()
        for received in inbox.drain():
            message = received.message
            if isinstance(message, RobotState):
                self._robots[message.robot] = message
            else:
                self._team = message
