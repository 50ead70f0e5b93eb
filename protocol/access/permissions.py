"""Rights of each role for each row of the table of topics. Routers' rules and receivers' checks follow it."""

from collections.abc import Set as AbstractSet
from enum import StrEnum

from robrain.protocol.access.member import MEMBERS, MemberRole
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP
from robrain.protocol.messages.motes.mote_messages import MOTE_READING
from robrain.protocol.messages.robots.host_messages import HOST_HALT
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_FOREIGN_CALL, ROBOT_FOREIGN_INFO
from robrain.protocol.messages.robots.witness_messages import ROBOT_WITNESS
from robrain.protocol.messages.tasks.consensus_messages import ROBOT_SUBMIT
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER, ROBOT_WITHDRAW
from robrain.protocol.messages.tasks.task_messages import TASK_CANCEL, TASK_CHANGE, TASK_SUBMIT
from robrain.protocol.messages.team.arena_messages import ARENA_CAN, ARENA_RADIO_TX, ARENA_SERIAL_TX, ARENA_TRUTH
from robrain.protocol.messages.team.door_messages import DOOR_STATE
from robrain.protocol.messages.team.recorder_messages import REPLAY_CONTROL
from robrain.protocol.messages.team.standing_messages import COORDINATOR_COPY, COORDINATOR_JOURNAL, COORDINATOR_STAND_BY
from robrain.protocol.messages.team.team_messages import HALT
from robrain.protocol.topic import Query, Role, Token, Topic, WireKey

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
    DOOR_STATE.name: _OPERATOR | _ARENA,
    ARENA_CAN.name: _ARENA | _ROBOT,
    ARENA_RADIO_TX.name: _ARENA | _ROBOT,
    ARENA_SERIAL_TX.name: _ARENA | _ROBOT,  # the arena opens pseudo terminals
    ROBOT_MAP.name: _ROBOT | _COORDINATOR,  # the known floor
    MOTE_READING.name: _ARENA | _ROBOT,  # simulated gateways are parts of the arena
}
SUBSCRIBES: dict[str, Roles] = {
    ARENA_TRUTH.name: ALL - _ROBOT,
    COORDINATOR_JOURNAL.name: _COORDINATOR,
    COORDINATOR_STAND_BY.name: _COORDINATOR,
}
ASKS: dict[str, Roles] = {
    HOST_HALT.name: _DESK,
    ROBOT_CALL.name: _OPERATOR | _COORDINATOR,
    ROBOT_OFFER.name: _COORDINATOR,
    ROBOT_WITHDRAW.name: _COORDINATOR,
    ROBOT_SUBMIT.name: _DESK,
    ROBOT_FOREIGN_CALL.name: _ROBOT,
    ROBOT_FOREIGN_INFO.name: _ROBOT,
    ROBOT_WITNESS.name: _COORDINATOR,
    TASK_SUBMIT.name: _DESK,
    TASK_CANCEL.name: _DESK,
    TASK_CHANGE.name: _DESK,
    COORDINATOR_COPY.name: _COORDINATOR,
}
"""Roles that ask a query. Else operators ask the queries that change something, and all ask those that only read."""
ANSWERS: dict[str, Roles] = {REPLAY_CONTROL.name: _OPERATOR}


def roles(action: AccessAction, row: WireKey) -> Roles:
    """The roles that may do an action with a row; none where the row is of another kind."""
    speakers = SPEAKERS[row.by]
    match row, action:
        case Topic(), AccessAction.PUT:
            return PUTS.get(row.name, speakers)
        case Topic(), AccessAction.SUBSCRIBE:
            return SUBSCRIBES.get(row.name, ALL)
        case Query(), AccessAction.ANSWER:
            return ANSWERS.get(row.name, speakers)
        case Query(), AccessAction.ASK:
            asks = ASKS.get(row.name, ALL if row.reads_only else _OPERATOR)
            return (_ROBOT | _OPERATOR) & asks if row.by is Role.ARENA else asks
        case Token(), AccessAction.ANNOUNCE:
            return speakers
        case Token(), AccessAction.WATCH:
            return ALL
    return NOBODY


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
