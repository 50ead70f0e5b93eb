"""`robrain status`: which members of a team are present, and what they have refused."""

import time

import msgspec

from robrain.client.members import team_found
from robrain.deploy.processes.live_process import client_session, live_endpoint, tell
from robrain.protocol.wire.border.refusals import Refusal
from robrain.protocol.wire.hub import team_endpoints, wrong_team
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.motes.mote_field_messages import MoteFieldState
from robrain.protocol.wire.messages.team.team_messages import StandByStatus, TeamState
from robrain.protocol.wire.topics import COORDINATOR_STATE, ROBOT_STATE

STATE_S = 1.0
"""How long to wait for the states of the members."""
POLL_S = 0.02
COORDINATOR = "coordinator"


class TeamStatus(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The members of a team that are present."""

    team: str
    coordinator: bool
    robots: list[str]
    """Names, sorted."""
    refused: dict[str, list[Refusal]] = {}
    """What the coordinator and the robots have refused, by `coordinator` and the robots' names; absent if nothing."""
    mote_field: MoteFieldState | None = None
    """How the motes are doing; absent if the coordinator does nothing for them by itself."""
    stand_by: StandByStatus | None = None
    """The coordinator that stands by with a journal of its own; absent if there is none."""
    unwritable: str = ""
    """Why the coordinator takes no tasks: its journal cannot be written; absent if it can."""


def status_of(connect: str | None, team: str) -> TeamStatus:
    """The members of a team that are present.

    Raises:
        NobodyThere: no member is present; the text lists the teams that have members present.

    """
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        inbox = Inbox()
        wire.subscribe(inbox, ROBOT_STATE)
        wire.subscribe(inbox, COORDINATOR_STATE)
        found = team_found(wire)
        if not found.robots and not found.coordinator:
            raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", wire)
        refused, summary = _told(inbox, len(found.robots) + found.coordinator)
    return TeamStatus(
        team=team,
        coordinator=found.coordinator,
        robots=found.robots,
        refused=refused,
        mote_field=None if summary is None else summary.mote_field or None,
        stand_by=None if summary is None else summary.stand_by or None,
        unwritable="" if summary is None else summary.unwritable or "",
    )


def show_status(found: TeamStatus) -> None:
    """Print which members of a team are present."""
    tell(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    if found.unwritable:
        tell(f"  the coordinator takes no tasks: {found.unwritable}")
    if found.stand_by is not None:
        tell(f"  {found.stand_by.words}")
    for name in found.robots:
        tell(f"  {name} up")
    if found.mote_field is not None:
        tell(f"  {found.mote_field.words}")
    for name, refused in found.refused.items():
        for one in refused:
            tell(f"  {name} refused {one.words}")


def _told(inbox: Inbox, members: int) -> tuple[dict[str, list[Refusal]], TeamState | None]:
    """What members have refused, and the coordinator's summary, as far as they publish it within `STATE_S`."""
    told: dict[str, list[Refusal]] = {}
    summary: TeamState | None = None
    until_s = time.monotonic() + STATE_S
    while len(told) < members and time.monotonic() < until_s:
        for received in inbox.drain():
            refused = received.message.refused
            told[received.names.get("robot", COORDINATOR)] = refused if isinstance(refused, list) else []
            summary = received.message if isinstance(received.message, TeamState) else summary
        time.sleep(POLL_S)
    return {name: refused for name, refused in sorted(told.items()) if refused}, summary
