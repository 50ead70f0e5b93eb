"""Where to find a team: at the endpoints given, or else at this machine's hub."""

import os
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

import msgspec
import zenoh

from robrain.protocol.access.identity import Connection, Identity, connection_of
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.access.signing import signed
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.robots.plugin_messages import ROBOT_LOG, ROBOT_WHO, LogRecord
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE, ROBOT_CLAIM
from robrain.protocol.messages.team.recorder_messages import REPLAY_CONTROL
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE, COORDINATOR_CLAIM, COORDINATOR_WHO
from robrain.protocol.topic import JSON, Query, Token
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.session import check_endpoint, open_session, unknown_host

TRIES = "tries"
"""Stage of the claim that a trial announces; no participant confuses it with a real one."""
TRIED = msgspec.json.encode(CallError(ErrorCode.BUSY, "this process only tries whether it may answer").reply())
PATIENCE_S = 2.0
POLL_S = 0.05


class Right(StrEnum):
    """Action that is tried."""

    ANNOUNCE = "announce itself"
    ANSWER = "answer"
    PUBLISH = "publish"


class MissingRight(NamedTuple):
    """Actions that a router does not allow."""

    denied: tuple[Right, ...]
    tried: int = 0

    def __bool__(self) -> bool:
        return bool(self.denied)

    @property
    def is_all(self) -> bool:
        """Whether nothing is allowed that was tried."""
        return bool(self.denied) and len(self.denied) == self.tried


def missing_rights(session: zenoh.Session, connect: Sequence[str], identity: Identity) -> MissingRight:
    """Which rights a robot, coordinator or operator lacks.

    Args:
        session: its own.
        connect: where it is connected.
        identity: its certificate.

    Raises:
        NobodyThere: the router has gone meanwhile.

    """
    rows = _rows(identity.member)
    if rows is None:
        return MissingRight(())
    with closing(open_session(connect=connect, identity=identity)) as other:
        trials = _trials(session, other, *rows)
        if identity.member.role is MemberRole.ROBOT:
            trials.append((Right.PUBLISH, partial(_publishes, session, other, identity.member)))
        denied = [right for right, is_allowed in trials if not is_allowed()]
    return MissingRight(tuple(denied), len(trials))


def _rows(member: Member) -> tuple[str, str] | None:
    """Keys of a token and of a question that a member may announce and answer; an operator has no token."""
    names = {"robot": member.name} if member.role is MemberRole.ROBOT else {}
    if member.role is MemberRole.OPERATOR:
        return "", signed(REPLAY_CONTROL.key(member.team), member)
    rows: dict[MemberRole, tuple[Token, Query[Any, Any]]] = {
        MemberRole.ROBOT: (ROBOT_CLAIM, ROBOT_WHO),
        MemberRole.COORDINATOR: (COORDINATOR_CLAIM, COORDINATOR_WHO),
    }
    if member.role not in rows:
        return None
    token, who = rows[member.role]
    return token.key(member.team, **names, stage=TRIES, process=TRIES), who.key(member.team, **names)


def _trials(
    session: zenoh.Session, other: zenoh.Session, token: str, question: str
) -> list[tuple[Right, Callable[[], bool]]]:
    def announces() -> bool:
        held = session.liveliness().declare_token(token)
        try:
            return _until(lambda: any(reply.ok is not None for reply in other.liveliness().get(token, timeout=1.0)))
        finally:
            held.undeclare()

    def answers() -> bool:
        def answer(query: zenoh.Query) -> None:
            query.reply_err(TRIED, encoding=JSON)
            query.drop()

        def is_own(reply: zenoh.Reply) -> bool:  # a process that has the name may answer as well
            return reply.err is not None and reply.err.payload.to_bytes() == TRIED

        held = session.declare_queryable(question, zenoh.handlers.Callback(answer, indirect=False))
        try:
            return _until(lambda: any(map(is_own, other.get(question, timeout=1.0))))
        finally:
            held.undeclare()

    return [*([(Right.ANNOUNCE, announces)] if token else []), (Right.ANSWER, answers)]


def _publishes(session: zenoh.Session, other: zenoh.Session, robot: Member) -> bool:
    key, arrived = ROBOT_LOG.key(robot.team, robot=robot.name), threading.Event()
    record = LogRecord(robot=robot.name, level="debug", source=TRIES, text=f"{robot} tries what it may")
    payload = ROBOT_LOG.payloads.write(msgspec.structs.replace(record, stamp_ns=LiveClock().now_ns()))
    held = other.declare_subscriber(key, lambda _: arrived.set())
    try:
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            session.put(key, payload)  # again, until the subscription has spread
            if arrived.wait(POLL_S):
                return True
        return False
    finally:
        held.undeclare()


def _until(is_so: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if is_so():
            return True
        time.sleep(POLL_S)
    return False


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
        what: missing participant, such as `no robot of team blue is there`.
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
    """Why a member of a secured team may see no participant."""
    member, where = connection.identity.member, ", ".join(connection.connect)
    old = "is revoked, or the router's members.json is older than it"
    if missing_rights(wire.session, connection.connect, connection.identity).is_all:
        return f"the router at {where} lets {member} do nothing: the certificate {old}"
    if member.role is MemberRole.OPERATOR:
        return "`robrain up` brings a team up"
    return f"if the team is up, the certificate of {member} {old}"
