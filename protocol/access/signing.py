"""How the messages and orders of one component travel: in a secured team under keys that name it, else as they are."""

from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

from robrain.protocol.access.member import Member, member
from robrain.protocol.access.permissions import AccessAction, roles
from robrain.protocol.codec import BadPayload
from robrain.protocol.errors import BadName, CallError, ErrorCode
from robrain.protocol.keys import ROOT
from robrain.protocol.refusals import RefusalCode, Refusals
from robrain.protocol.table.topics import HOST_VERB
from robrain.protocol.topic import Query, Role, Topic, WireKey

AS = "as"
"""Chunk behind the team's name that begins a signed key."""
SIGNED_KEYS = 4096
"""Signed keys that are remembered in parts."""
OF_THE_ROBOT_ITSELF = frozenset({"robot_foreign_call"})
"""Queries that a robot's host asks of the robot's own processes: only they may use these keys."""


class SignedKey(NamedTuple):
    """A signed key in parts."""

    asker: Member
    key: str
    """The same key without its signature."""


def is_signed(row: WireKey) -> bool:
    """Whether the keys of a row need a signature, because their pattern does not name the sender."""
    if isinstance(row, Query):
        return not row.reads_only and row.name not in OF_THE_ROBOT_ITSELF
    if not isinstance(row, Topic):
        return False
    return (row.by is Role.OPERATOR and not row.fields) or (row.by is Role.ROBOT and "robot" not in row.pattern)


def signed(key: str, asker: Member | None = None) -> str:
    """A key, or key expression, as `asker` sends under it; as an unnamed sender if None.

    >>> signed("robrain/blue/halt")
    'robrain/blue/as/*/*/halt'
    """
    root, team, rest = key.split("/", 2)
    who = "*/*" if asker is None else f"{asker.role}/{asker.name}"
    return f"{root}/{team}/{AS}/{who}/{rest}"


@lru_cache(maxsize=SIGNED_KEYS)
def read_signed(key: str) -> SignedKey | None:
    """The parts of a signed key; None if it is not one."""
    parts = key.split("/", 5)
    if len(parts) != 6 or parts[0] != ROOT or parts[2] != AS:
        return None
    try:
        asker = member(parts[3], parts[1], parts[4])
    except BadName:
        return None
    return SignedKey(asker, f"{ROOT}/{parts[1]}/{parts[5]}")


def sender_field(row: Topic[Any] | Query[Any, Any]) -> str:
    """The field of a message, or request, that names its sender; empty if none does."""
    kind = row.message if isinstance(row, Topic) else row.request
    fields: tuple[str, ...] = getattr(kind, "__struct_fields__", ())
    return next((field for field in ("by", "via") if field in fields), "")


VERBS = {AccessAction.PUT: "publish", AccessAction.ASK: "ask"}
ROBOT_FIELD = "via"
"""Where a robot names itself: by its name alone, which is also that of the robot everywhere else."""


def vouch_message(topic: Topic[Any], key: str, payload: bytes, refusals: Refusals) -> tuple[str, bytes] | None:
    """The plain key and payload of a message under a signed key, its sender named as the key does.

    None, and counted as refused, if it names another, does not decode, or is of a role that does not publish this.
    """
    found = read_signed(key)
    if found is None:
        refusals.record(topic.name, key, RefusalCode.WRONG_NAME, "its key does not say who sends it")
        return None
    why = refusal_of(AccessAction.PUT, topic, found.asker)
    if why:
        refusals.record(topic.name, key, RefusalCode.WRONG_NAME, why)
        return None
    field = sender_field(topic)
    try:
        message = topic.payloads.read(payload)
    except BadPayload as error:
        code = RefusalCode.TOO_LARGE if error.is_too_large else RefusalCode.MALFORMED
        refusals.record(topic.name, key, code, str(error))
        return None
    claimed = getattr(message, field) if field else ""
    if not _is(claimed, found.asker):
        refusals.record(topic.name, key, RefusalCode.WRONG_NAME, f"its key says {found.asker}, its payload {claimed}")
        return None
    known = named(field, found.asker)
    if not field or claimed == known:
        return found.key, payload
    return found.key, msgspec.json.encode(msgspec.structs.replace(message, **{field: known}))


def refusal_of(action: AccessAction, row: Topic[Any] | Query[Any, Any], member: Member) -> str:
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
    # Each of the host's verbs has its own row, whose rights the host itself checks.
    why = "" if query is HOST_VERB else refusal_of(AccessAction.ASK, query, asker)
    if why:
        refusals.record(query.name, key, RefusalCode.WRONG_NAME, why)
        raise CallError(ErrorCode.FORBIDDEN, why)
    field = sender_field(query)
    claimed = getattr(asked, field, "") if field else ""
    if not _is(claimed, asker):
        why = f"its key says {asker}, its request {claimed}"
        refusals.record(query.name, key, RefusalCode.WRONG_NAME, why)
        raise CallError(ErrorCode.FORBIDDEN, why)
    return in_own_name(query, asked, asker)


def message_in_own_name(row: Topic[Any] | Query[Any, Any], message: Any, member: Member) -> Any:
    """A message or request as a member may send it.

    Raises:
        CallError: it may not; the router would drop it in silence.

    """
    why = refusal_of(AccessAction.PUT if isinstance(row, Topic) else AccessAction.ASK, row, member)
    if why:
        raise CallError(ErrorCode.FORBIDDEN, why)
    return in_own_name(row, message, member)


def in_own_name(row: Topic[Any] | Query[Any, Any], message: Any, member: Member) -> Any:
    """A message or request with its sender's full name in place of the program's own name for itself."""
    field = sender_field(row)
    if not field or not isinstance(message, msgspec.Struct):
        return message
    return msgspec.structs.replace(message, **{field: named(field, member)})


def named(field: str, member: Member) -> str:
    """Name of a member in a field."""
    return member.name if field == ROBOT_FIELD else str(member)


def _is(claimed: str, member: Member) -> bool:
    return claimed in ("", member.name, str(member))


class Signing:
    """Signs the keys of one component.

    Args:
        member: member that its session's certificate names; None where the team is not secured.

    """

    def __init__(self, member: Member | None) -> None:
        self._member = member

    def covers(self, row: WireKey) -> bool:
        """Whether a row's keys contain the sender."""
        return self._member is not None and is_signed(row)

    def own(self, row: WireKey, key: str) -> str:
        """The key under which this component sends."""
        return signed(key, self._member) if self.covers(row) else key

    def of_all(self, row: WireKey, selector: str) -> str:
        """The keys under which it receives messages and requests of any sender."""
        return signed(selector) if self.covers(row) else selector

    def body(self, topic: Query[Any, Any], request: Any) -> bytes | None:
        """A request, encoded, in the member's own name.

        Raises:
            CallError: the router would not let this member ask it.

        """
        if self._member is not None and is_signed(topic):
            request = message_in_own_name(topic, request, self._member)
        return None if request is None else topic.requests.write(request)
