"""Two nodes on sessions of their own, over TCP on loopback."""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
import zenoh

from robrain.protocol.ros2 import ros_node
from robrain.protocol.ros2.message_types import (
    LASER_SCAN,
    OCCUPANCY_GRID,
    STRING,
    TRIGGER,
    MessageType,
    Nothing,
    ServiceType,
    String,
    TriggerResponse,
)
from robrain.protocol.ros2.qos import LATCHED, Qos
from robrain.protocol.ros2.ros_node import WAITING_MAX, Attachment, EntityKind, RosNode
from robrain.protocol.wire.session import listening_at, open_session
from tests.protocol.ros2.other_node import NoReply, ask, response, tokens
from tests.waiting import until

SHORT = MessageType(STRING.name, String, max_bytes=64)


class Two(NamedTuple):
    """Two nodes, and their sessions."""

    one: RosNode
    other: RosNode
    session: zenoh.Session
    far: zenoh.Session
    """Of the other node."""

    def knows(self, *kinds: EntityKind) -> None:
        """Wait until the other node's session knows of an entity of each kind."""
        until(lambda: all(tokens(self.far, kind) for kind in kinds))


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
    yield Two(one, other, *sessions)
    other.close()
    one.close()


def taken(subscription) -> list:
    """What a subscription brings first."""
    return until(subscription.read, "no message came")


def test_a_message_arrives_with_its_sender_number_and_time(two):
    publisher = two.one.advertise("scan", LASER_SCAN)
    heard = two.other.subscribe("/r1/scan", LASER_SCAN)
    two.knows(EntityKind.PUBLISHER, EntityKind.SUBSCRIPTION)
    messages = []
    while not messages:  # the publisher's session learns of the subscription in its own time
        publisher.publish(LASER_SCAN.blank(ranges=np.arange(3, dtype=np.float32)))
        messages = heard.read()
    first = messages[0]
    assert first.message.ranges.tolist() == [0.0, 1.0, 2.0]
    assert (first.gid, first.number >= 1, first.stamp_ns >= 1_000) == (publisher.entity.gid, True, True)


def test_a_late_subscription_gets_the_last_latched_message(two):
    publisher = two.one.advertise("/map", OCCUPANCY_GRID, LATCHED)
    for value in (1, 2):
        publisher.publish(OCCUPANCY_GRID.blank(data=np.full(4, value, np.int8)))
    late = two.other.subscribe("/map", OCCUPANCY_GRID, LATCHED)
    assert [each.message.data.tolist() for each in taken(late)] == [[2, 2, 2, 2]]


def test_a_subscription_holds_its_depth_and_counts_what_it_drops(two):
    heard = two.one.subscribe("/talk", STRING, Qos(depth=3))
    publisher = two.one.advertise("/talk", STRING)
    for number in range(10):
        publisher.publish(String(str(number)))
    until(lambda: heard.dropped == 7)
    assert [each.message.data for each in heard.read()] == ["7", "8", "9"]


def test_a_subscription_holds_so_many_bytes_whatever_its_depth(two, monkeypatch):
    monkeypatch.setattr(ros_node, "INBOX_BYTES_MAX", 100)
    heard = two.one.subscribe("/talk", STRING, Qos(depth=10))
    publisher = two.one.advertise("/talk", STRING)
    for text in ("a" * 40, "b" * 40, "c" * 40):
        publisher.publish(String(text))
    until(lambda: heard.dropped == 1)
    assert [each.message.data[0] for each in heard.read()] == ["b", "c"]


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
    until(lambda: messages.extend(heard.read()) or messages)
    assert [each.message.data for each in messages] == ["on"]
    assert heard.reasons == {"no_sender": 2, "malformed": 2, "too_large": 1}


def test_a_service_is_answered_and_the_answer_finds_its_request(two):
    server = two.one.serve("/halt", TRIGGER)
    two.knows(EntityKind.SERVER)
    calls = {number: ask(two.far, "/halt", TRIGGER, Nothing(), number) for number in (1, 2, 3)}
    waiting: list = []
    until(lambda: waiting.extend(server.requests()) or len(waiting) == 3)
    for request in reversed(waiting):  # in any order
        request.reply(TriggerResponse(True, f"to {request.sender.number}"))
    assert [response(call, TRIGGER, number).message for number, call in calls.items()] == ["to 1", "to 2", "to 3"]


def test_requests_beyond_those_that_may_wait_are_refused_and_counted(two):
    server = two.one.serve("/halt", TRIGGER)
    calls = [ask(two.session, "/halt", TRIGGER, Nothing()) for _ in range(WAITING_MAX + 1)]
    with pytest.raises(NoReply, match="requests wait already"):
        response(calls[-1], TRIGGER)
    assert (server.dropped, len(server.requests())) == (1, WAITING_MAX)


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
    call = ask(two.session, "/halt", TRIGGER, Nothing())
    server.close()
    with pytest.raises(NoReply, match="the service ends"):
        response(call, TRIGGER)


def test_a_node_and_its_parts_are_present_in_their_domain_until_it_ends(two, sessions):
    elsewhere = RosNode(sessions[0], "elsewhere", domain=7, now_ns=lambda: 0)
    two.one.advertise("scan", LASER_SCAN)
    two.one.serve("~/halt", TRIGGER)
    two.knows(EntityKind.PUBLISHER, EntityKind.SERVER)
    assert sorted(token.rpartition("NN/%/")[2] for token in tokens(two.far, EntityKind.NODE)) == ["%/other", "%r1/one"]
    assert [token.split("/")[9] for token in tokens(two.far, EntityKind.SERVER)] == ["%r1%one%halt"]
    assert len(tokens(two.far, domain=7)) == 1
    elsewhere.close()
    two.one.close()
    until(lambda: [token.rpartition("/")[2] for token in tokens(two.far)] == ["other"])
