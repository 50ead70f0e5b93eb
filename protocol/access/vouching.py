"""What a receiver in a secured team does with the sender's name in a message: the key says who it is.

A name in the message is a claim: it is completed to the member's full name, or the message is refused if it is another.
"""

from typing import Any

import msgspec

from robrain.protocol.access.member import Member
from robrain.protocol.access.permissions import AccessAction, roles
from robrain.protocol.access.signed_keys import read_signed, sender_field
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.refusals import RefusalCode, Refusals
from robrain.protocol.table.host_queries import HOST_VERB
from robrain.protocol.table.topic import Query, Topic

VERBS = {AccessAction.PUT: "publish", AccessAction.ASK: "ask", AccessAction.HEAR: "hear", AccessAction.ANSWER: "answer"}
ROBOT_FIELD = "via"
"""Where a robot names itself: by its name alone, which is also that of the robot everywhere else."""


def vouch_message(topic: Topic[Any], key: str, payload: bytes, refusals: Refusals) -> tuple[str, bytes] | None:
    """The plain key and payload of a message under a signed key, its sender named as the key does.

    None, and counted as refused, if it names another, does not decode, or is of a role that does not publish this.
    """
    found = read_signed(key)
    if found is None:
        refusals.note(topic.name, key, RefusalCode.WRONG_NAME, "its key does not say who sends it")
        return None
    why = why_not(AccessAction.PUT, topic, found.asker)
    if why:
        refusals.note(topic.name, key, RefusalCode.WRONG_NAME, why)
        return None
    field = sender_field(topic)
    try:
        message = topic.payloads.read(payload)
    except BadPayload as error:
        code = RefusalCode.TOO_LARGE if error.is_too_large else RefusalCode.MALFORMED
        refusals.note(topic.name, key, code, str(error))
        return None
    claimed = getattr(message, field) if field else ""
    if not _is(claimed, found.asker):
        refusals.note(topic.name, key, RefusalCode.WRONG_NAME, f"its key says {found.asker}, its payload {claimed}")
        return None
    known = named(field, found.asker)
    if not field or claimed == known:
        return found.key, payload
    return found.key, msgspec.json.encode(msgspec.structs.replace(message, **{field: known}))


def why_not(action: AccessAction, row: Topic[Any] | Query[Any, Any], member: Member) -> str:
    """Why a member may not do something with a row, in words; empty if it may."""
    allowed = roles(action, row)
    if member.role in allowed:
        return ""
    may = ", ".join(sorted(allowed)) or "nobody"
    return f"{member} may not {VERBS[action]} {row.name}: {may} may"


def vouch_request(query: Query[Any, Any], key: str, asked: Any, asker: Member, refusals: Refusals) -> Any:
    """A request, its asker named as the key does.

    Raises:
        CallError: it names another, or the role may not ask this (counted as refused).

    """
    # Of the host's verbs each has a row of its own, whose rights the host itself checks.
    why = "" if query is HOST_VERB else why_not(AccessAction.ASK, query, asker)
    if why:
        refusals.note(query.name, key, RefusalCode.WRONG_NAME, why)
        raise CallError(ErrorCode.FORBIDDEN, why)
    field = sender_field(query)
    claimed = getattr(asked, field, "") if field else ""
    if not _is(claimed, asker):
        why = f"its key says {asker}, its request {claimed}"
        refusals.note(query.name, key, RefusalCode.WRONG_NAME, why)
        raise CallError(ErrorCode.FORBIDDEN, why)
    return in_own_name(query, asked, asker)


def message_in_own_name(topic: Topic[Any], message: Any, member: Member) -> Any:
    """A message as a member may send it.

    Raises:
        CallError: it may not; the router would drop it in silence.

    """
    why = why_not(AccessAction.PUT, topic, member)
    if why:
        raise CallError(ErrorCode.FORBIDDEN, why)
    return in_own_name(topic, message, member)


def in_own_name(row: Topic[Any] | Query[Any, Any], message: Any, member: Member) -> Any:
    """A message or request with its sender's full name in place of what the program calls itself."""
    field = sender_field(row)
    if not field or not isinstance(message, msgspec.Struct):
        return message
    return msgspec.structs.replace(message, **{field: named(field, member)})


def named(field: str, member: Member) -> str:
    """What a member is called in a field."""
    return member.name if field == ROBOT_FIELD else str(member)


def _is(claimed: str, member: Member) -> bool:
    return claimed in ("", member.name, str(member))
