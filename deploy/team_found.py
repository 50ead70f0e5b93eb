"""Which members of a team are present, for `robrain status` and for errors that list them."""

import time

import msgspec

from robrain.deploy.live_process import client_session, live_endpoint, tell
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import NobodyThere
from robrain.protocol.wire.hub import team_endpoints, wrong_team
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.refusals import Refusal
from robrain.protocol.wire.safe_text import safe_text
from robrain.protocol.wire.topic import Token
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, COORDINATOR_STATE, ROBOT_ALIVE, ROBOT_STATE

GATHER_S = 0.5
"""How long to look again for missing members: a token may take this long to reach its hub."""
STATE_S = 1.0
"""How long to wait for the states of the members."""
POLL_S = 0.02
COORDINATOR = "coordinator"
ASK_AGAIN_S = 0.1
ANSWER_TIMEOUT_S = 10.0
"""Time limit for a hub's answer, which is immediate unless its machine is overloaded."""


class TeamFound(msgspec.Struct, frozen=True, kw_only=True):
    """Who of a team is there."""

    team: str
    coordinator: bool
    robots: list[str]
    refused: dict[str, list[Refusal]] = {}
    """What the coordinator and the robots have refused, by `coordinator` and the robots' names."""


def status_of(connect: str | None, team: str) -> TeamFound:
    """The members of a team that are present.

    Raises:
        NobodyThere: nobody is; the text lists the teams that have members present.

    """
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        inbox = Inbox()
        wire.subscribe(inbox, ROBOT_STATE)
        wire.subscribe(inbox, COORDINATOR_STATE)
        found = team_found(wire)
        if not found.robots and not found.coordinator:
            raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", session)
        return msgspec.structs.replace(found, refused=_refused(inbox, len(found.robots) + found.coordinator))


def _refused(inbox: Inbox, members: int) -> dict[str, list[Refusal]]:
    """What members have refused, as far as they publish their state within `STATE_S`."""
    told: dict[str, list[Refusal]] = {}
    until_s = time.monotonic() + STATE_S
    while len(told) < members and time.monotonic() < until_s:
        for received in inbox.drain():
            refused = received.message.refused
            told[received.names.get("robot", COORDINATOR)] = refused if isinstance(refused, list) else []
        time.sleep(POLL_S)
    return {name: refused for name, refused in sorted(told.items()) if refused}


def team_found(wire: Endpoint) -> TeamFound:
    """The present members of the endpoint's team."""
    until_s = time.monotonic() + GATHER_S
    while True:
        robots = sorted(names["robot"] for names in _tokens(wire, ROBOT_ALIVE))
        found = TeamFound(team=wire.team, coordinator=bool(_tokens(wire, COORDINATOR_ALIVE)), robots=robots)
        if (found.robots and found.coordinator) or time.monotonic() > until_s:
            return found
        time.sleep(ASK_AGAIN_S)


def _tokens(wire: Endpoint, topic: Token) -> list[dict[str, str]]:
    """The names in all of a topic's tokens that the hub has now."""
    replies = wire.session.liveliness().get(topic.selector(wire.team), timeout=ANSWER_TIMEOUT_S)
    found = [topic.parse(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
    return [names for names in found if names is not None]


def no_robot(wire: Endpoint, robot: str, what: str) -> NobodyThere:
    """The error for a robot that did not answer `what`; it lists the robots present, or else the teams."""
    found = team_found(wire)
    if robot in found.robots:
        return NobodyThere(f"{robot} does not answer {what}: is its robrain older than this one?")
    text = f"no robot {robot} in team {wire.team}"
    if not found.robots and not found.coordinator:
        return wrong_team(text, wire.session)
    return NobodyThere(f"{text}; there are: {', '.join(found.robots) or 'none'}")


def show_status(found: TeamFound) -> None:
    """Print which members of a team are present."""
    tell(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    for name in found.robots:
        tell(f"  {name} up")
    for name, refused in found.refused.items():
        for one in refused:
            tell(f"  {name} refused {safe_text(one.words)}")
