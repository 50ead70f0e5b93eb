"""Zenoh's access rules, from the table of topics: all is denied except the rights of a member's role for each row.

Zenoh compares by inclusion: a rule for `robot/r1/**` does not cover a query to `robot/*/who`. A message *to* a member
is allowed for its whole team where the router sends it only to subscribers. A message *from* a member is allowed row by
row. `**` does not cover `@adv`, under which lossless topics keep their samples.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.access.permissions import AccessAction, own_names, roles
from robrain.protocol.access.signing import is_signed, signed
from robrain.protocol.keys import ROOT
from robrain.protocol.messages.team.arena_messages import ARENA_CAN
from robrain.protocol.table.topics import HOST_VERB, all_rows
from robrain.protocol.topic import Delivery, Topic, WireKey

ADVANCED = "@adv/**"
"""Keys under which publishers of lossless topics keep samples, announce themselves and number their messages."""
PUTS = ("put", "delete")
MESSAGES = (
    *PUTS, "query", "reply", "declare_subscriber", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
)  # fmt: skip
"""All that Zenoh has rules for."""


def ruled_rows() -> tuple[WireKey, ...]:
    """All rows that rules are made from. Verbs from other distributions have no row."""
    return (*all_rows(), HOST_VERB)


def access_control(members: Iterable[Member], router: Member | None = None) -> dict[str, Any]:
    """The `access_control` part of a Zenoh router's configuration: default deny, and the rules of each member.

    Members that are not named, as those whose certificates are revoked, may connect and do nothing. Other routers pass
    on what their members say: each router judges those that connect to it.

    Args:
        members: those that may take part, routers included.
        router: the one that the rules are for; None is any.

    """
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    subjects: list[dict[str, Any]] = []
    for one in sorted(set(members) - {router}):
        own = rules_of(one) if one.role is not MemberRole.ROUTER else _rules_of_router(one)
        rules += own
        subjects.append({"id": one.common_name, "cert_common_names": [one.common_name]})
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [one.common_name]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def rules_of(member: Member) -> list[dict[str, Any]]:
    """The rules for one member."""
    puts, receives = _keys(member, AccessAction.PUT), _keys(member, AccessAction.SUBSCRIBE)
    asks, answers = _keys(member, AccessAction.ASK), _keys(member, AccessAction.ANSWER)
    announces, watches = _keys(member, AccessAction.ANNOUNCE), _keys(member, AccessAction.WATCH)
    kept = _kept(member, AccessAction.PUT)
    keeps = [f"{key}/{ADVANCED}" for key in kept]
    catches_up = [f"{key}/{ADVANCED}" for key in _kept(member, AccessAction.SUBSCRIBE)]
    bus = _bus_of(member)
    team = [f"{ROOT}/{member.team}/**", f"{ROOT}/{member.team}/**/{ADVANCED}"]
    parts = (
        ("ingress", PUTS, (*puts, *keeps)),
        ("ingress", ("declare_subscriber",), (*receives, *catches_up)),
        ("ingress", ("query",), (*asks, *catches_up, *bus)),
        ("ingress", ("declare_queryable",), (*answers, *keeps, *bus)),
        ("ingress", ("reply",), (*answers, *keeps, *kept, *bus)),
        ("ingress", ("liveliness_token",), (*announces, *keeps)),
        ("ingress", ("liveliness_query", "declare_liveliness_subscriber"), (*watches, *catches_up)),
        ("egress", PUTS, (*receives, *catches_up)),
        ("egress", ("reply",), (*asks, *receives, *catches_up, *bus)),
        ("egress", ("declare_subscriber", "declare_queryable", "query", "liveliness_token"), team),
        ("egress", ("liveliness_query", "declare_liveliness_subscriber"), team),
    )
    return [_rule(member, flow, messages, keys) for flow, messages, keys in parts if keys]


def _rules_of_router(router: Member) -> list[dict[str, Any]]:
    """It carries all messages of all teams of its CA, in both directions."""
    return [_rule(router, flow, MESSAGES, (f"{ROOT}/**", f"{ROOT}/**/{ADVANCED}")) for flow in ("ingress", "egress")]


def _rule(member: Member, flow: str, messages: Sequence[str], keys: Iterable[str]) -> dict[str, Any]:
    return {
        "id": f"{member.common_name} {flow} {' '.join(messages)}",
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": sorted(set(keys)),
    }


def key_of(member: Member, action: AccessAction, row: WireKey) -> str | None:
    """The key expression under which a member may do something with a row; None if it may not."""
    if member.role not in roles(action, row):
        return None
    names = dict.fromkeys(own_names(action, row, member.role), member.name)
    key = row.selector(member.team, **names)
    if not is_signed(row):
        return key
    return signed(key, member if action in (AccessAction.PUT, AccessAction.ASK) else None)


def _keys(member: Member, action: AccessAction) -> list[str]:
    return [key for row in ruled_rows() if (key := key_of(member, action, row)) is not None]


def _kept(member: Member, action: AccessAction) -> list[str]:
    """Keys of lossless topics, whose kept samples are sent again as replies under the topic's own key."""
    rows = [row for row in ruled_rows() if isinstance(row, Topic) and row.delivery is Delivery.LOSSLESS]
    return [key for row in rows if (key := key_of(member, action, row)) is not None]


def _bus_of(member: Member) -> list[str]:
    """Nodes of a simulated CAN bus look for each other by a query."""
    key = key_of(member, AccessAction.PUT, ARENA_CAN)
    return [] if key is None else [key]
