from itertools import combinations
from types import NoneType

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from robrain.protocol.access.member import MemberRole
from robrain.protocol.access.permissions import AccessAction, own_names, roles
from robrain.protocol.access.rules import ruled_rows
from robrain.protocol.codec import BadPayload
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.team.team_messages import HALT
from robrain.protocol.table.topics import TOPICS, all_rows, topic_of
from robrain.protocol.topic import Query, Role, Topic
from tests.installed_distributions import as_new, install, new_topics  # noqa: F401 - fixtures

NAMES = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.\-]{0,62}", fullmatch=True)
QUERIES = [row for row in all_rows() if isinstance(row, Query)]


@st.composite
def keys(draw):
    topic = draw(st.sampled_from(all_rows()))
    return topic, draw(NAMES), {field: draw(NAMES) for field in topic.fields}


def test_no_key_belongs_to_two_topics():
    selectors = {topic.name: zenoh.KeyExpr(topic.selector("t")) for topic in all_rows()}
    clashes = [pair for pair in combinations(selectors, 2) if selectors[pair[0]].intersects(selectors[pair[1]])]
    assert clashes == []


@pytest.mark.slow
@given(keys())
def test_parsing_a_key_gives_back_what_it_was_built_from(drawn):
    topic, team, names = drawn
    key = topic.key(team, **names)
    assert topic.parse(key) == {"team": team, **names}
    assert topic_of(key) == ((topic, {"team": team, **names}) if isinstance(topic, Topic) else None)


@pytest.mark.slow
@given(keys())
def test_every_selector_includes_its_keys(drawn):
    topic, team, names = drawn
    key = topic.key(team, **names)
    assert zenoh.KeyExpr(topic.selector(team)).includes(zenoh.KeyExpr(key))
    assert topic.selector(team, **names) == key
    for field in names:
        assert zenoh.KeyExpr(topic.selector(team, **{field: names[field]})).includes(zenoh.KeyExpr(key))


@pytest.mark.parametrize(
    "key",
    [
        "robrain/t/robot/r1",  # a chunk too few
        "robrain/t/robot/r1/state/more",  # a chunk too many
        "other/t/robot/r1/state",  # another project's root
        "robrain/t/robot/r1/mood",  # no such topic
        "",  # nothing
    ],
)
def test_foreign_keys_belong_to_no_topic(key):
    assert topic_of(key) is None


def test_a_key_takes_exactly_the_names_of_its_pattern():
    with pytest.raises(KeyError, match="robot_call takes"):
        ROBOT_CALL.key("t", robot="r1", plugin="driver")
    with pytest.raises(KeyError, match="halt takes"):
        HALT.key("t", robot="r1")
    with pytest.raises(KeyError, match="halt takes"):
        HALT.selector("t", robot="r1")


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query.name)
def test_every_query_bounds_what_is_asked_and_replied(query):
    assert 0 < query.timeout_s <= 60.0
    for codec in (query.requests, query.payloads):
        assert 0 < codec.max_bytes <= 2**26
        with pytest.raises(BadPayload, match="expected at most"):
            codec.read(b" " * (codec.max_bytes + 1))


@pytest.mark.parametrize("query", QUERIES, ids=lambda query: query.name)
@pytest.mark.parametrize("payload", [b"{", b"\xff", b"7", b"[" * 5000])
def test_a_request_or_reply_that_is_none_is_refused_in_words(query, payload):
    for codec in (query.requests, query.payloads):
        if codec.kind in (bytes, NoneType):
            assert codec.read(payload) == (payload if codec.kind is bytes else None)
            continue
        with pytest.raises(BadPayload, match=r"^expected a"):
            codec.read(payload)


OTHERS = """
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.topic import Role, Topic

ROWS = (
    Topic("robot/{robot}/state/more", "its name is taken", RobotState, alias="robot_state"),
    Topic("robot/{any}/path", "its keys are taken", RobotState, alias="way"),
    Topic("patrol/{robot}/state", "a row without an owner", RobotState),
    ROBOT_STATE,
    Topic("patrol/{robot}/mood", "good", RobotState, role=Role.ROBOT),
)
"""


@pytest.mark.usefixtures("new_topics")
def test_rows_of_other_distributions_are_added_unless_name_or_keys_are_taken(monkeypatch, install, caplog):  # noqa: F811
    stock = len(all_rows())
    all_rows.cache_clear()
    as_new(TOPICS, monkeypatch)
    install("patrol", {"patrol": "patrol_rows:ROWS"}, {"patrol_rows.py": OTHERS}, TOPICS.group)
    assert len(all_rows()) == stock + 1
    topic, names = topic_of("robrain/t/patrol/r1/mood")
    assert (topic.by, names) == (Role.ROBOT, {"team": "t", "robot": "r1"})
    assert roles(AccessAction.PUT, topic) == {MemberRole.ROBOT}
    assert own_names(AccessAction.PUT, topic, MemberRole.ROBOT) == ("robot",)
    assert topic in ruled_rows()
    for text in (
        "topics patrol: robot/{robot}/state/more is left out: robot/{robot}/state has the name robot_state",
        "topics patrol: robot/{any}/path is left out: robot/{robot}/path has the same keys",
        "topics patrol: patrol/{robot}/state is left out: expected its role, as patrol/ has no owner",
    ):
        assert text in caplog.messages
