"""Which members of a team are present, and the errors that list them."""

import time

import msgspec

from robrain.protocol.errors import NobodyThere
from robrain.protocol.table.topics import COORDINATOR_ALIVE, ROBOT_ALIVE
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.hub import wrong_team

GATHER_S = 0.5
"""How long to look again for missing members: a token may take this long to reach its hub."""
ASK_AGAIN_S = 0.1


class TeamFound(msgspec.Struct, frozen=True, kw_only=True):
    """The members of a team that are present."""

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
        return NobodyThere(f"{robot} does not answer {what}: is its robrain older than this one?")
    text = f"no robot {robot} in team {wire.team}"
    if not found.robots and not found.coordinator:
        return wrong_team(text, wire)
    return NobodyThere(f"{text}; there are: {', '.join(found.robots) or 'none'}")
