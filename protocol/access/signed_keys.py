"""Keys that say who asks: in a secured team, orders travel under `robrain/TEAM/as/ROLE/NAME/…`.

The router's rules let each certificate use its own `as/ROLE/NAME` alone, so a receiver reads from the key who gives an
order. Messages that name their sender in their key already, and questions that change nothing, travel under
their plain keys (docs/decisions/0051-who-asks-is-in-the-key.md).
"""

from functools import lru_cache
from typing import Any, NamedTuple

from robrain.protocol.access.member import Member, member
from robrain.protocol.errors import BadName
from robrain.protocol.keys import ROOT
from robrain.protocol.table.topic import Query, Role, Topic, WireKey

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
    """Whether a row's keys must say who sends, because nothing else in them does."""
    if isinstance(row, Query):
        return not row.reads_only and row.name not in OF_THE_ROBOT_ITSELF
    if not isinstance(row, Topic):
        return False
    return (row.by is Role.OPERATOR and not row.fields) or (row.by is Role.ROBOT and "robot" not in row.pattern)


def signed(key: str, asker: Member | None = None) -> str:
    """A key, or key expression, as `asker` sends under it; as anybody does if None.

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
