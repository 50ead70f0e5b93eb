"""Tries what a router lets a member do: what it does not allow it drops in silence.

A second session with the same certificate hears what the first one says. Nobody else is disturbed: the token is one of
a claim that nobody has, the question is read-only, and the message is a record in the robot's log.
"""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

import msgspec
import zenoh

from robrain.protocol.access.identity import Identity
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.access.signing import signed
from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.messages.robots.plugin_messages import LogRecord
from robrain.protocol.table.topic import JSON, Query, Token
from robrain.protocol.table.topics import (
    COORDINATOR_CLAIM,
    COORDINATOR_WHO,
    REPLAY_CONTROL,
    ROBOT_CLAIM,
    ROBOT_LOG,
    ROBOT_WHO,
)
from robrain.protocol.wire.session import open_session

TRIES = "tries"
"""Stage of the claim that a trial announces; nobody takes it for a real one."""
TRIED = msgspec.json.encode(CallError(ErrorCode.BUSY, "this process only tries whether it may answer").reply())
PATIENCE_S = 2.0
LOOK_S = 0.05


class Right(StrEnum):
    """What is tried."""

    ANNOUNCE = "announce itself"
    ANSWER = "answer"
    PUBLISH = "publish"


class MissingRight(NamedTuple):
    """What a router does not allow."""

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
    key, heard = ROBOT_LOG.key(robot.team, robot=robot.name), threading.Event()
    record = LogRecord(robot=robot.name, level="debug", source=TRIES, text=f"{robot} tries what it may")
    payload = ROBOT_LOG.payloads.write(msgspec.structs.replace(record, stamp_ns=LiveClock().now_ns()))
    held = other.declare_subscriber(key, lambda _: heard.set())
    try:
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            session.put(key, payload)  # again, until the subscription has spread
            if heard.wait(LOOK_S):
                return True
        return False
    finally:
        held.undeclare()


def _until(is_so: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if is_so():
            return True
        time.sleep(LOOK_S)
    return False
