"""Where to find a team: at the endpoints given, or else at this machine's hub."""

import os

import zenoh

from robrain.protocol.access.identity import Connection, connection_of
from robrain.protocol.access.member import MemberRole
from robrain.protocol.errors import NobodyThere
from robrain.protocol.table.topics import COORDINATOR_ALIVE, ROBOT_ALIVE
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.session import check_endpoint, unknown_host
from robrain.protocol.wire.trial import missing_rights

CONNECT_VARIABLE = "ROBRAIN_CONNECT"
"""Environment variable with the team's endpoints, used without `--connect`."""
HUB_VARIABLE = "ROBRAIN_HUB"
"""Environment variable with the endpoint of this machine's hub if not DEFAULT_HUB: for a second user, or a test."""
DEFAULT_HUB = "tcp/127.0.0.1:7447"
"""Zenoh's default port, on loopback only."""
TEAMS_TIMEOUT_S = 2.0


def hub_endpoint() -> str:
    """The endpoint where `robrain up` listens if it can, and where commands look for a team on this machine.

    Raises:
        WireError: ROBRAIN_HUB is set to something that is not an endpoint.

    """
    return check_endpoint(os.environ.get(HUB_VARIABLE) or DEFAULT_HUB)


def given_endpoints(connect: str | None) -> list[str]:
    """The endpoints in `--connect`, or else in ROBRAIN_CONNECT, separated by commas; empty if neither is given.

    Raises:
        WireError: one of them is not an endpoint.

    """
    text = connect if connect is not None else os.environ.get(CONNECT_VARIABLE, "")
    return [check_endpoint(part.strip()) for part in text.split(",") if part.strip()]


def team_endpoints(connect: str | None = None) -> list[str]:
    """Where to look for a team: the endpoints given, or else this machine's hub (WireError as above)."""
    return given_endpoints(connect) or [hub_endpoint()]


def nobody_answers(endpoints: list[str]) -> str:
    """The error text for endpoints where nothing listens.

    >>> nobody_answers(["tcp/10.0.0.5:7447"])
    'nobody answers at tcp/10.0.0.5:7447: is `robrain up` or a Zenoh router running there?'
    """
    where = ", ".join(endpoints)
    if unknown := [host for host in map(unknown_host, endpoints) if host]:
        return f"nobody answers at {where}: the host {unknown[0]} is unknown; check its name or give its address"
    if endpoints == [hub_endpoint()]:
        return (
            f"nobody answers at {where}, the hub of this machine: `robrain up` starts a team; for one elsewhere "
            f"give --connect tcp/HOST:PORT or set {CONNECT_VARIABLE}"
        )
    return f"nobody answers at {where}: is `robrain up` or a Zenoh router running there?"


def teams_there(wire: Endpoint) -> list[str]:
    """Names of the teams with a robot or coordinator that can be reached, sorted."""
    topics = (ROBOT_ALIVE, COORDINATOR_ALIVE)
    found = [wire.present(topic, every_team=True, timeout_s=TEAMS_TIMEOUT_S) for topic in topics]
    return sorted({names["team"] for tokens in found for names in tokens})


def wrong_team(what: str, wire: Endpoint) -> NobodyThere:
    """The error for a team with no member there; it names the teams that are there.

    Args:
        what: who is missing, such as `no robot of team blue is there`.
        wire: where to look for other teams.

    """
    try:
        teams = teams_there(wire)
    except zenoh.ZError:  # the hub has gone meanwhile: no teams to name
        teams = []
    connection = connection_of(wire.session)
    if not teams and connection is not None:
        return NobodyThere(f"{what}; {_doubt(wire, connection)}")
    if teams:
        return NobodyThere(f"{what}; there {'is team' if len(teams) == 1 else 'are the teams'} {', '.join(teams)}")
    return NobodyThere(f"{what}; `robrain up` brings a team up")


def _doubt(wire: Endpoint, connection: Connection) -> str:
    """Why a member of a secured team may see nobody."""
    member, where = connection.identity.member, ", ".join(connection.connect)
    old = "is revoked, or the router's members.json is older than it"
    if missing_rights(wire.session, connection.connect, connection.identity).is_all:
        return f"the router at {where} lets {member} do nothing: the certificate {old}"
    if member.role is MemberRole.OPERATOR:
        return "`robrain up` brings a team up"
    return f"if the team is up, the certificate of {member} {old}"
