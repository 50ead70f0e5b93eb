"""Two nodes on sessions of their own, over TCP on loopback."""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
import zenoh

from robrain.protocol.ros2 import ros_graph, ros_node
from robrain.protocol.ros2.attachment import Attachment
from robrain.protocol.ros2.definitions import Nothing, TriggerResponse
from robrain.protocol.ros2.errors import BadRosName, NoReply
from robrain.protocol.ros2.message_classes import String
from robrain.protocol.ros2.message_types import LASER_SCAN, OCCUPANCY_GRID, STRING, TRIGGER, MessageType, ServiceType
from robrain.protocol.ros2.qos import LATCHED, RELIABLE, Qos
from robrain.protocol.ros2.ros_graph import RosGraph
from robrain.protocol.ros2.ros_node import RosNode
from robrain.protocol.ros2.ros_service import WAITING_MAX
from robrain.protocol.ros2.tokens import EntityKind
from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import until

SHORT = MessageType(STRING.name, String, max_bytes=64)


class Two(NamedTuple):
    """Two nodes, and what one of them knows of the other."""

    one: RosNode
    other: RosNode
    graph: RosGraph
    """Of the other node's session."""
    session: zenoh.Session
    """Of the one node."""

    def knows(self, *, publishers: int = 0, subscriptions: int = 0, servers: int = 0) -> None:
        """Wait until the other node's session knows of so many endpoints."""
        wanted = {
            EntityKind.PUBLISHER: publishers,
            EntityKind.SUBSCRIPTION: subscriptions,
            EntityKind.SERVER: servers,
        }
        until(lambda: all(len(self.graph.entities(kind)) >= count for kind, count in wanted.items()))


@pytest.fixture
def sessions() -> Iterator[list[zenoh.Session]]:
    """Of each test its own: a token that goes while somebody asks for all may be told, and never be taken back."""
    router = open_session(mode="router", listen=("tcp/127.0.0.1:0",))
    opened = [open_session(connect=listening_at(router)) for _ in range(2)]
    yield opened
    for session in (*opened, router):
        session.close()


@pytest.fixture
def two(sessions) -> Iterator[Two]:
    clock = itertools.count(1_000)
    one = RosNode(sessions[0], "one", namespace="/r1", now_ns=lambda: next(clock))
    other = RosNode(sessions[1], "other", now_ns=lambda: next(clock))
    graph = RosGraph(sessions[1])
    yield Two(one, other, graph, sessions[0])
    graph.close()
    other.close()
    one.close()


def taken(subscription) -> list:
    """What a subscription brings first."""
    return until(subscription.take, "no message came")


def test_a_message_arrives_with_its_sender_number_and_time(two):
    publisher = two.one.advertise("scan", LASER_SCAN)
    heard = two.other.subscribe("/r1/scan", LASER_SCAN)
    two.knows(publishers=1, subscriptions=1)
    messages = []
    while not messages:  # the publisher's session learns of the subscription in its own time
        publisher.publish(LASER_SCAN.blank(ranges=np.arange(3, dtype=np.float32)))
        messages = heard.take()
    first = messages[0]
    assert first.message.ranges.tolist() == [0.0, 1.0, 2.0]
    assert (first.gid, first.number >= 1, first.stamp_ns >= 1_000) == (publisher.entity.gid, True, True)


def test_a_late_subscription_gets_the_last_latched_message(two):
    publisher = two.one.advertise("/map", OCCUPANCY_GRID, LATCHED)
    for value in (1, 2):
        publisher.publish(OCCUPANCY_GRID.blank(data=np.full(4, value, np.int8)))
    late = two.other.subscribe("/map", OCCUPANCY_GRID, LATCHED)
    assert [each.message.data.tolist() for each in taken(late)] == [[2, 2, 2, 2]]


def test_a_latched_message_is_not_brought_to_a_volatile_subscription(two):
    two.one.advertise("/map", OCCUPANCY_GRID, LATCHED).publish(OCCUPANCY_GRID.blank())
    assert taken(two.other.subscribe("/map", OCCUPANCY_GRID, LATCHED))  # the put itself has arrived
    volatile = two.other.subscribe("/map", OCCUPANCY_GRID, RELIABLE)
    assert taken(two.other.subscribe("/map", OCCUPANCY_GRID, LATCHED))
    assert volatile.take() == []


def test_a_subscription_holds_its_depth_and_counts_what_it_drops(two):
    heard = two.one.subscribe("/talk", STRING, Qos(depth=3))
    publisher = two.one.advertise("/talk", STRING)
    for number in range(10):
        publisher.publish(String(str(number)))
    until(lambda: heard.dropped == 7)
    assert [each.message.data for each in heard.take()] == ["7", "8", "9"]


def test_a_subscription_holds_so_many_bytes_whatever_its_depth(two, monkeypatch):
    monkeypatch.setattr(ros_node, "INBOX_BYTES_MAX", 100)
    heard = two.one.subscribe("/talk", STRING, Qos(depth=10))
    publisher = two.one.advertise("/talk", STRING)
    for text in ("a" * 40, "b" * 40, "c" * 40):
        publisher.publish(String(text))
    until(lambda: heard.dropped == 1)
    assert [each.message.data[0] for each in heard.take()] == ["b", "c"]


def test_what_is_no_message_is_refused_and_counted(two):
    heard = two.one.subscribe("/talk", SHORT)
    key, sender = heard.entity.key, Attachment(1, 1, bytes(16)).pack()
    good = STRING.encode(String("on"))
    two.session.put(key, good)
    two.session.put(key, good, attachment=b"robrain")
    two.session.put(key, b"\0\1\0\0\xff\xff\xff\xff", attachment=sender)
    two.session.put(key, b"", attachment=sender)
    two.session.put(key, STRING.encode(String("x" * 64)), attachment=sender)
    two.session.put(key, good, attachment=sender)
    messages: list = []
    until(lambda: messages.extend(heard.take()) or messages)
    assert [each.message.data for each in messages] == ["on"]
    assert heard.reasons == {"no_sender": 2, "malformed": 2, "too_large": 1}


def test_a_service_is_answered_and_the_answer_finds_its_request(two):
    server = two.one.serve("/halt", TRIGGER)
    client = two.other.client("/halt", TRIGGER)
    two.knows(servers=1)
    calls = [client.ask(Nothing()) for _ in range(3)]
    waiting: list = []
    until(lambda: waiting.extend(server.requests()) or len(waiting) == 3)
    assert [request.sender.number for request in waiting] == [1, 2, 3]
    for request in reversed(waiting):  # in any order
        request.reply(TriggerResponse(True, f"to {request.sender.number}"))
    assert [call.wait().message for call in calls] == ["to 1", "to 2", "to 3"]


def test_a_response_can_be_polled_for(two):
    server = two.one.serve("/halt", TRIGGER)
    client = two.other.client("/halt", TRIGGER)
    two.knows(servers=1)
    call = client.ask(Nothing())
    request = until(server.requests)[0]
    assert call.poll() is None
    request.reply(TriggerResponse(False, "no"))
    assert until(call.poll) == TriggerResponse(False, "no")


def test_a_refused_request_raises_with_the_reason(two):
    server = two.one.serve("/halt", TRIGGER)
    client = two.other.client("/halt", TRIGGER)
    two.knows(servers=1)
    call = client.ask(Nothing())
    until(server.requests)[0].refuse("not now")
    with pytest.raises(NoReply, match="/halt: refused: not now"):
        call.wait()


def test_a_request_nobody_answers_raises(two):
    client = two.other.client("/nobody", TRIGGER)
    with pytest.raises(NoReply, match="/nobody: no server"):
        client.ask(Nothing(), timeout_s=0.2).wait()


def test_requests_beyond_those_that_may_wait_are_refused_and_counted(two):
    server = two.one.serve("/halt", TRIGGER)
    client = two.one.client("/halt", TRIGGER)
    calls = [client.ask(Nothing()) for _ in range(WAITING_MAX + 1)]
    with pytest.raises(NoReply, match="requests wait already"):
        calls[-1].wait()
    assert (server.dropped, len(server.requests())) == (1, WAITING_MAX)


def test_a_response_to_another_request_is_passed_over(two):
    client = two.one.client("/halt", TRIGGER)

    def answer(query):
        with query:
            for number, words in ((7, "to another"), (1, "to this")):
                attachment = Attachment(number, 0, client.entity.gid).pack()
                payload = TRIGGER.response.encode(TriggerResponse(True, words))
                query.reply(client.entity.key, payload, attachment=attachment)

    queryable = two.session.declare_queryable(client.entity.key, answer, complete=True)
    assert client.ask(Nothing()).wait().message == "to this"
    queryable.undeclare()


def test_a_request_beyond_its_bound_is_refused_at_once(two):
    small = ServiceType(TRIGGER.name, MessageType(TRIGGER.request.name, Nothing, max_bytes=16), TRIGGER.response)
    server = two.one.serve("/halt", small)
    asked = two.session.get(server.entity.key, payload=b"\0\1\0\0" + bytes(100))
    assert [reply.err is not None for reply in asked] == [True]
    assert server.refused == 1


def test_what_is_no_request_is_refused_and_counted(two):
    server = two.one.serve("/halt", TRIGGER)
    key, sender = server.entity.key, Attachment(1, 1, bytes(16)).pack()
    asked = [
        two.session.get(key, payload=b"\0\1\0\0\0"),
        two.session.get(key, attachment=sender),
        two.session.get(key, payload=b"robrain", attachment=sender),
    ]
    until(lambda: server.requests() or server.refused == len(asked))
    assert [reply.err is not None for replies in asked for reply in replies] == [True] * 3


def test_a_closed_service_refuses_what_waits(two):
    server = two.one.serve("/halt", TRIGGER)
    call = two.one.client("/halt", TRIGGER).ask(Nothing())
    server.close()
    with pytest.raises(NoReply, match="the service ends"):
        call.wait()


def test_nodes_topics_and_services_are_known_by_their_tokens(two):
    two.one.advertise("scan", LASER_SCAN)
    two.one.serve("~/halt", TRIGGER)
    two.other.subscribe("/r1/scan", LASER_SCAN)
    two.knows(publishers=1, subscriptions=1, servers=1)
    assert two.graph.nodes() == ["/other", "/r1/one"]
    assert two.graph.topics() == {"/r1/scan": [LASER_SCAN.name]}
    assert two.graph.services() == {"/r1/one/halt": [TRIGGER.name]}
    two.one.close()
    until(lambda: two.graph.nodes() == ["/other"])
    assert [each.kind for each in two.graph.endpoints("/r1/scan")] == [EntityKind.SUBSCRIPTION]


def test_nodes_of_another_domain_are_not_known(two, sessions):
    elsewhere = RosNode(sessions[0], "elsewhere", domain=7, now_ns=lambda: 0)
    graph = RosGraph(sessions[1], 7)
    until(lambda: graph.nodes() == ["/elsewhere"])
    assert "/elsewhere" not in two.graph.nodes()
    graph.close()
    elsewhere.close()


def test_who_has_another_type_on_a_topic_is_found(two):
    mine = two.other.subscribe("/map", OCCUPANCY_GRID, LATCHED)
    two.one.advertise("/map", STRING)
    two.one.advertise("/map", OCCUPANCY_GRID)
    two.knows(publishers=2)
    assert [each.type_name for each in two.graph.unheard(mine.entity)] == [STRING.name]


def test_tokens_that_cannot_be_read_are_counted(two):
    token = two.session.liveliness().declare_token("@ros2_lv/0/1f/0/0/XX/%/%/node")
    until(lambda: two.graph.refused == 1)
    token.undeclare()


def test_tokens_beyond_those_that_are_followed_are_counted(two, monkeypatch):
    until(lambda: len(two.graph.nodes()) == 2)
    monkeypatch.setattr(ros_graph, "ENTITIES_MAX", 3)
    for topic in ("/a", "/b"):
        two.one.advertise(topic, STRING)
    until(lambda: two.graph.dropped == 1)
    assert len(two.graph.topics()) == 1


def test_a_name_against_the_rules_declares_nothing(two):
    with pytest.raises(BadRosName):
        two.one.advertise("1st scan", LASER_SCAN)
    with pytest.raises(BadRosName):
        RosNode(two.session, "a/b", now_ns=lambda: 0)
