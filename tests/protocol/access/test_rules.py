"""The generated rules against what is written down here by hand: every row, in every role, in every action."""

import itertools
from typing import Any

import pytest

from robrain.protocol.access.member import MEMBERS, Member, MemberRole
from robrain.protocol.access.permissions import AccessAction
from robrain.protocol.access.rules import access_control, ruled_rows
from robrain.protocol.topic import Delivery, Query, Token, Topic, WireKey
from tests.protocol.access.zenoh_rules import allows

TEAM = "blue"
OWN, OTHER = "me", "another"
MEMBERS_OF_TEAM = {role: Member(role, TEAM, OWN) for role in MEMBERS}
RULES = access_control([*MEMBERS_OF_TEAM.values(), Member(MemberRole.ROBOT, TEAM, OTHER)])
C, OP, V, REC, D, ROB, A = (
    MemberRole.COORDINATOR,
    MemberRole.OPERATOR,
    MemberRole.VIEWER,
    MemberRole.RECORDER,
    MemberRole.DASHBOARD,
    MemberRole.ROBOT,
    MemberRole.ARENA,
)
EVERYBODY = {C, OP, V, REC, D, ROB, A}
ORDERS: dict[str, set[MemberRole]] = {
    "halt": {OP, D},
    "mote_reading": {ROB, A},
    "robot_call": {OP, C},
    "robot_offer": {C},
    "robot_withdraw": {C},
    "robot_submit": {OP, D},
    "robot_cancel": {OP},
    "robot_witness": {C},
    "task_submit": {OP, D},
    "task_cancel": {OP, D},
    "task_change": {OP, D},
    "coordinator_objective": {OP},
    "coordinator_backup": {OP},
    "coordinator_lead": {OP},
    "coordinator_remove_robot": {OP},
    "coordinator_zones_change": {OP},
    "coordinator_rules_change": {OP},
    "mission_start": {OP},
    "mission_cancel": {OP},
    "coordinator_hold_robot": {OP},
    "coordinator_rename_robot": {OP},
    "coordinator_release_robot": {OP},
    "replay_control": {OP},
    "host_load": {OP},
    "host_unload": {OP},
    "host_reload": {OP},
    "host_command": {OP},
    "host_hold": {OP},
    "host_release": {OP},
    "host_halt": {OP, D},
    "host_resume": {OP},
    "host_verb": {OP},
}
"""Rows that travel under signed keys, and who may send them."""
SECRET = {"coordinator_journal", "coordinator_stand_by", "coordinator_copy"}
"""For coordinators alone."""
OF_ITS_OWN = {"robot_foreign_info", "robot_foreign_call"}
"""Between a robot's host and its own processes."""
MESSAGES = {
    AccessAction.PUT: ("put",),
    AccessAction.SUBSCRIBE: ("declare_subscriber",),
    AccessAction.ASK: ("query",),
    AccessAction.ANSWER: ("declare_queryable", "reply"),
    AccessAction.ANNOUNCE: ("liveliness_token",),
    AccessAction.WATCH: ("liveliness_query", "declare_liveliness_subscriber"),
}
EACH_ROW = pytest.mark.parametrize("row", ruled_rows(), ids=lambda row: str(row.name))


def _key(row: WireKey, own: str, asker: Member | None) -> str:
    names = {field: own if field in ("robot", "recorder") else f"some_{field}" for field in row.fields}
    key = row.key(TEAM, **names)
    if row.name not in ORDERS:
        return key
    root, team, rest = key.split("/", 2)
    return f"{root}/{team}/as/{asker.role if asker else '*'}/{asker.name if asker else '*'}/{rest}"


def _may_speak(row: WireKey) -> set[MemberRole]:
    """Who may publish, answer or announce it."""
    if row.name in ("halt", "mote_reading"):
        return ORDERS[row.name]
    if row.name in ("arena_can", "arena_radio_tx", "arena_serial_tx"):
        return {A, ROB}
    if row.name == "door_state":
        return {OP, A}
    if row.name == "robot_map":
        return {ROB, C}
    if row.name == "replay_control":
        return {OP}
    return {"robot": {ROB}, "coordinator": {C}, "operator": {REC}, "arena": {A}}[row.by]


def _may_listen(row: WireKey) -> set[MemberRole]:
    """Who may hear, ask or watch it."""
    if row.name in SECRET:
        return {C}
    if isinstance(row, Query):
        if row.name in OF_ITS_OWN:
            return {ROB}
        return {ROB, OP} if row.by == "arena" else ORDERS.get(row.name, EVERYBODY)
    return EVERYBODY - {ROB} if row.name == "arena_truth" else EVERYBODY


def _actions(row: WireKey) -> tuple[AccessAction, AccessAction]:
    if isinstance(row, Topic):
        return AccessAction.PUT, AccessAction.SUBSCRIBE
    return (
        (AccessAction.ANSWER, AccessAction.ASK)
        if isinstance(row, Query)
        else (AccessAction.ANNOUNCE, AccessAction.WATCH)
    )


def _allowed(member: Member, action: AccessAction, key: str) -> set[bool]:
    return {allows(RULES, member.common_name, "ingress", message, key) for message in MESSAGES[action]}


@EACH_ROW
def test_role_speaks_under_its_own_name_where_it_may_and_nowhere_else(row: WireKey) -> None:
    for role in MEMBERS:
        member, action = MEMBERS_OF_TEAM[role], _actions(row)[0]
        asker = member if isinstance(row, Topic) else None  # who answers hears whoever asks
        may = role in _may_speak(row)
        assert _allowed(member, action, _key(row, OWN, asker)) == {may}
        is_named = (role is ROB and "robot" in row.fields) or (role is REC and "recorder" in row.fields)
        assert _allowed(member, action, _key(row, OTHER, asker)) == {may and not is_named}
        if row.name in ORDERS and isinstance(row, Topic):
            assert _allowed(member, action, _key(row, OWN, Member(role, TEAM, OTHER))) == {False}
            assert _allowed(member, action, row.key(TEAM, **dict.fromkeys(row.fields, OWN))) == {False}


@EACH_ROW
def test_role_hears_and_asks_in_its_own_name_what_it_may(row: WireKey) -> None:
    for role in MEMBERS:
        member, action = MEMBERS_OF_TEAM[role], _actions(row)[1]
        asker = member if isinstance(row, Query) else None
        may = role in _may_listen(row)
        assert _allowed(member, action, _key(row, OWN, asker)) == {may}
        is_private = role is ROB and (row.by == "arena" or row.name in OF_ITS_OWN) and "robot" in row.fields
        assert _allowed(member, action, _key(row, OTHER, asker)) == {may and not is_private}
        if row.name in ORDERS and isinstance(row, Query):
            for name in ("*", OTHER):
                assert _allowed(member, action, _key(row, OWN, asker).replace(f"/{OWN}/", f"/{name}/", 1)) == {False}
            assert _allowed(member, action, row.key(TEAM, **dict.fromkeys(row.fields, OWN))) == {False}


@EACH_ROW
def test_no_row_of_another_team_is_allowed(row: WireKey) -> None:
    for role in MEMBERS:
        for asker in (None, MEMBERS_OF_TEAM[role]):
            key = _key(row, OWN, asker).replace(f"/{TEAM}/", "/green/", 1)
            wild = _key(row, OWN, asker).replace(f"/{TEAM}/", "/*/", 1)
            assert not any(
                _allowed(MEMBERS_OF_TEAM[role], action, each) == {True}
                for action in AccessAction
                for each in (key, wild)
            )


@pytest.mark.parametrize("role", MEMBERS)
@pytest.mark.parametrize(
    "key", ["**", f"robrain/{TEAM}/**", f"robrain/{TEAM}/robot/**", "@/**", f"robrain/{TEAM}/as/**", "robrain/*/halt"]
)
def test_no_role_may_do_anything_with_wildcards_over_rows(role: MemberRole, key: str) -> None:
    for messages in MESSAGES.values():
        for message in messages:
            assert not allows(RULES, MEMBERS_OF_TEAM[role].common_name, "ingress", message, key)


@pytest.mark.parametrize("row", [row for row in ruled_rows() if isinstance(row, Topic)], ids=lambda row: str(row.name))
def test_kept_samples_reach_those_who_may_hear_the_topic_and_no_others(row: Topic[Any]) -> None:
    for role, member in MEMBERS_OF_TEAM.items():
        hears = role in _may_listen(row) and row.delivery is Delivery.LOSSLESS
        kept = f"{_key(row, OWN, None)}/@adv/pub/1f/2/_"
        for message in ("query", "declare_subscriber", "declare_liveliness_subscriber"):
            assert allows(RULES, member.common_name, "ingress", message, kept) == hears
        speaks = role in _may_speak(row) and row.delivery is Delivery.LOSSLESS
        kept = f"{_key(row, OWN, member)}/@adv/pub/1f/2/_"
        for message in ("put", "declare_queryable", "reply", "liveliness_token"):
            assert allows(RULES, member.common_name, "ingress", message, kept) == speaks


@EACH_ROW
def test_messages_and_replies_are_sent_to_those_alone_who_may_have_them(row: WireKey) -> None:
    for role in MEMBERS:
        member, key = MEMBERS_OF_TEAM[role], _key(row, OWN, MEMBERS_OF_TEAM[role])
        message = "put" if isinstance(row, Topic) else "reply"
        if not isinstance(row, Token):
            assert allows(RULES, member.common_name, "egress", message, key) == (role in _may_listen(row))


def test_who_is_not_named_may_do_nothing() -> None:
    for row, action in itertools.product(ruled_rows(), AccessAction):
        assert _allowed(Member(ROB, TEAM, "revoked"), action, _key(row, OWN, None)) == {False}


def test_router_has_no_rules_of_its_own_and_carries_everything_of_other_routers() -> None:
    site, hall = (Member(MemberRole.ROUTER, TEAM, name) for name in ("site", "hall"))
    assert access_control([site], site)["subjects"] == []
    rules = access_control([site, hall], site)
    assert {subject["id"] for subject in rules["subjects"]} == {hall.common_name}
    messages = itertools.chain.from_iterable(MESSAGES.values())
    for row, message, flow in itertools.product(ruled_rows(), messages, ("ingress", "egress")):
        key = _key(row, OWN, MEMBERS_OF_TEAM[OP])
        assert allows(rules, hall.common_name, flow, message, key)
        assert allows(rules, hall.common_name, flow, message, f"{key}/@adv/pub/1/1/_")
        assert not allows(rules, hall.common_name, flow, message, "other/key")
        assert not allows(rules, hall.common_name, flow, message, "@/1/router")
