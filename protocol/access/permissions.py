"""Rights of each role for each row of the table of topics. Routers' rules and receivers' checks follow it."""

from collections.abc import Set as AbstractSet
from enum import StrEnum

from robrain.protocol.access.member import MEMBERS, MemberRole
from robrain.protocol.table.host_queries import HOST_HALT, HOST_QUERIES, HOST_VERB
from robrain.protocol.table.topic import Query, Role, Topic, WireKey
from robrain.protocol.table.topics import (
    ARENA_CAN,
    ARENA_RADIO_TX,
    ARENA_SERIAL_TX,
    ARENA_TRUTH,
    COORDINATOR_BACKUP,
    COORDINATOR_LEAD,
    COORDINATOR_OBJECTIVE,
    COORDINATOR_REMOVE_ROBOT,
    HALT,
    MOTE_READING,
    REPLAY_CONTROL,
    ROBOT_CALL,
    ROBOT_CANCEL,
    ROBOT_FOREIGN_CALL,
    ROBOT_FOREIGN_INFO,
    ROBOT_OFFER,
    ROBOT_SUBMIT,
    ROBOT_WITHDRAW,
    STANDBY_ROWS,
    TASK_CANCEL,
    TASK_SUBMIT,
)

HOST = HOST_VERB.pattern.removesuffix("{verb}")
Roles = AbstractSet[MemberRole]


class AccessAction(StrEnum):
    """Permissions of a member for a row's keys."""

    PUT = "put"
    SUBSCRIBE = "subscribe"
    ASK = "ask"
    ANSWER = "answer"
    ANNOUNCE = "announce"
    """Holds a liveliness token."""
    WATCH = "watch"
    """Sees the holders of tokens."""


_COORDINATOR = frozenset({MemberRole.COORDINATOR})
_OPERATOR = frozenset({MemberRole.OPERATOR})
_ROBOT = frozenset({MemberRole.ROBOT})
_ARENA = frozenset({MemberRole.ARENA})
_DESK = frozenset({MemberRole.OPERATOR, MemberRole.DASHBOARD})
ALL = frozenset(MEMBERS)
NOBODY: Roles = frozenset()
SPEAKERS: dict[Role, Roles] = {
    Role.ROBOT: _ROBOT,
    Role.COORDINATOR: _COORDINATOR,
    Role.OPERATOR: frozenset({MemberRole.RECORDER}),
    Role.ARENA: _ARENA,
}
"""Roles that publish, answer and announce rows, unless a row names others."""
PUTS: dict[str, Roles] = {
    HALT.name: _DESK,
    ARENA_CAN.name: _ARENA | _ROBOT,
    ARENA_RADIO_TX.name: _ARENA | _ROBOT,
    ARENA_SERIAL_TX.name: _ARENA | _ROBOT,  # the arena opens pseudo terminals
    MOTE_READING.name: _ARENA | _ROBOT,  # simulated gateways are parts of the arena
}
SUBSCRIBES: dict[str, Roles] = {ARENA_TRUTH.name: ALL - _ROBOT, **{row.name: _COORDINATOR for row in STANDBY_ROWS}}
ASKS: dict[str, Roles] = {
    **{row.name: _OPERATOR for row in (HOST_VERB, *HOST_QUERIES)},
    HOST_HALT.name: _DESK,
    ROBOT_CALL.name: _OPERATOR | _COORDINATOR,
    ROBOT_OFFER.name: _COORDINATOR,
    ROBOT_WITHDRAW.name: _COORDINATOR,
    ROBOT_SUBMIT.name: _DESK,
    ROBOT_CANCEL.name: _OPERATOR,
    ROBOT_FOREIGN_CALL.name: _ROBOT,
    ROBOT_FOREIGN_INFO.name: _ROBOT,
    TASK_SUBMIT.name: _DESK,
    TASK_CANCEL.name: _DESK,
    COORDINATOR_OBJECTIVE.name: _OPERATOR,
    REPLAY_CONTROL.name: _OPERATOR,
    **{row.name: _COORDINATOR for row in STANDBY_ROWS if isinstance(row, Query)},
    COORDINATOR_BACKUP.name: _OPERATOR,
    COORDINATOR_LEAD.name: _OPERATOR,
    COORDINATOR_REMOVE_ROBOT.name: _OPERATOR,
}
"""Roles that ask the restricted queries."""
ANSWERS: dict[str, Roles] = {REPLAY_CONTROL.name: _OPERATOR}


def roles(action: AccessAction, row: WireKey) -> Roles:
    """The roles that may do an action with a row; none where the row is of another kind."""
    if isinstance(row, Topic):
        return _of_topic(action, row)
    if isinstance(row, Query):
        return _of_query(action, row)
    return {AccessAction.ANNOUNCE: SPEAKERS[row.by], AccessAction.WATCH: ALL}.get(action, NOBODY)


def _of_topic(action: AccessAction, row: Topic[object]) -> Roles:
    if action is AccessAction.PUT:
        return PUTS.get(row.name, SPEAKERS[row.by])
    if action is not AccessAction.SUBSCRIBE:
        return NOBODY
    return SUBSCRIBES.get(row.name, ALL)


def _of_query(action: AccessAction, row: Query[object, object]) -> Roles:
    if action is AccessAction.ANSWER:
        return ANSWERS.get(row.name, SPEAKERS[row.by])
    if action is not AccessAction.ASK:
        return NOBODY
    others = _OPERATOR if row.pattern.startswith(HOST) else NOBODY  # also verbs that other distributions bring
    asks = ASKS.get(row.name, ALL if row.reads_only else others)
    return (_ROBOT | _OPERATOR) & asks if row.by is Role.ARENA else asks


def own_names(action: AccessAction, row: WireKey, role: MemberRole) -> tuple[str, ...]:
    """The fields of a row's key that must be the member's own name.

    A robot speaks and answers under its own name alone. Of its simulated hardware, and of plugins in separate
    processes, it also receives and asks only its own.
    """
    speaks = action in (AccessAction.PUT, AccessAction.ANSWER, AccessAction.ANNOUNCE)
    if role is MemberRole.RECORDER and speaks:
        return tuple(field for field in row.fields if field == "recorder")
    is_private = row.by is Role.ARENA or row in (ROBOT_FOREIGN_CALL, ROBOT_FOREIGN_INFO)
    if role is MemberRole.ROBOT and (speaks or is_private):
        return tuple(field for field in row.fields if field == "robot")
    return ()
