"""`robrain status`: which members of a team are present."""

from robrain.client.members import TeamFound, team_found
from robrain.deploy.live_process import client_session, live_endpoint, tell
from robrain.protocol.wire.hub import team_endpoints, wrong_team


def status_of(connect: str | None, team: str) -> TeamFound:
    """The members of a team that are present.

    Raises:
        NobodyThere: nobody is; the text lists the teams that have members present.

    """
    with client_session(connect) as session, live_endpoint(session, team) as wire:
        found = team_found(wire)
        if not found.robots and not found.coordinator:
            raise wrong_team(f"nobody of team {team} is at {', '.join(team_endpoints(connect))}", session)
    return found


def show_status(found: TeamFound) -> None:
    """Print which members of a team are present."""
    tell(f"team {found.team}: coordinator {'up' if found.coordinator else 'not there'}")
    for name in found.robots:
        tell(f"  {name} up")
