"""Links carry queries in the same way, whether by Zenoh or within a process."""

import threading

import pytest
import zenoh
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.exchange import Exchange
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.links.local_link import LocalLink
from robrain.protocol.links.receivers import Declared
from robrain.protocol.links.zenoh_link import ZenohLink
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.topic import JSON, Urgency

ERROR = CallError(ErrorCode.REFUSED, "no", "because")
CHUNKS = ["a", "b", "*", "**"]
CHUNK_LISTS = st.lists(st.sampled_from(CHUNKS), min_size=1, max_size=4)
SELECTORS = CHUNK_LISTS.map(lambda chunks: str(zenoh.KeyExpr.autocanonize("/".join(chunks))))
KEYS = st.lists(st.sampled_from(["a", "b"]), min_size=1, max_size=4).map("/".join)


@pytest.fixture(params=["joined", "alone"])
def link(request, lockstep_session):
    """A link; queries of one are answered at others, which a second one would show no better."""
    joined = request.param == "joined"
    link = ZenohLink(lockstep_session, Exchange()) if joined else LocalLink(Exchange(is_alone=True))
    yield link
    link.close()


def replies(key, *payloads):
    """Answers a query with some payloads, or errors."""

    def take(query):
        for payload in payloads:
            if payload is ERROR:
                query.reply_error(ERROR)
            else:
                query.reply(key, payload, JSON)
        query.end()

    return take


def ask(link, selector, payload=None, timeout_s=1.0):
    return link.ask(selector, payload, Urgency.DATA, timeout_s)


def told(replies):
    return [(answer.key, answer.payload) if not answer.is_error else "error" for answer in replies.answers]


def test_the_one_who_answers_is_asked_with_what_was_said(link):
    seen = []

    def take(query):
        seen.append((query.key, query.selector, query.by, query.payload))
        query.reply("a/b", query.payload[::-1], JSON)
        query.end()

    link.queryable("a/*", take, waits=False)
    assert told(ask(link, "a/b?by=ann", b"abc")) == [("a/b", b"cba")]
    assert told(ask(link, "a/b")) == [("a/b", b"")]
    assert seen == [("a/b", "a/b?by=ann", "ann", b"abc"), ("a/b", "a/b", "", b"")]


def test_where_nobody_answers_there_is_no_reply_and_no_wait(link):
    link.queryable("a/b", replies("a/b", b"1"), waits=False)
    asked = ask(link, "a/c", timeout_s=60.0)
    assert asked.in_time
    assert told(asked) == []


def test_a_key_expression_asks_all_that_it_holds(link):
    for key in ("a/b", "a/c", "b/b"):
        link.queryable(key, replies(key, key.encode()), waits=False)
    assert sorted(told(ask(link, "a/*"))) == [("a/b", b"a/b"), ("a/c", b"a/c")]
    assert sorted(told(ask(link, "*/b"))) == [("a/b", b"a/b"), ("b/b", b"b/b")]
    assert len(told(ask(link, "**"))) == 3


def test_an_error_comes_before_other_replies(link):
    link.queryable("a", replies("a", b"1"), waits=False)
    link.queryable("a", replies("a", ERROR), waits=False)
    link.queryable("a", replies("a", b"1"), waits=False)
    assert told(ask(link, "a")) == ["error", ("a", b"1")]


def test_what_is_undeclared_is_asked_no_more(link):
    link.queryable("a", replies("a", b"1"), waits=False)
    assert told(ask(link, "a")) == [("a", b"1")]
    link.declarations.pop().undeclare()
    assert told(ask(link, "a")) == []
    link.queryable("a", replies("a", b"2"), waits=False)
    assert told(ask(link, "a")) == [("a", b"2")]


def test_a_query_that_is_kept_is_waited_for(link):
    kept = []
    link.queryable("a", kept.append, waits=False)
    asked = ask(link, "a", timeout_s=0.05)
    assert not asked.in_time
    assert asked.from_outside
    kept.pop().end()

    link.queryable("b", lambda query: threading.Timer(0.05, replies("b", b"late"), [query]).start(), waits=False)
    asked = ask(link, "b", timeout_s=60.0)
    assert asked.in_time
    assert told(asked) == [("b", b"late")]


def test_a_query_that_is_forgotten_has_ended(link):
    link.queryable("a", lambda query: None, waits=False)
    asked = ask(link, "a", timeout_s=60.0)
    assert asked.in_time
    assert told(asked) == []


def test_puts_reach_the_inboxes_of_their_keys_until_they_are_undeclared():
    exchange = Exchange(is_alone=True)
    link, inboxes = LocalLink(exchange), [Inbox(), Inbox()]
    for inbox, names in zip(inboxes, ({"robot": "r1"}, {}), strict=True):
        link.subscribe(ROBOT_STATE.selector("t", **names), ROBOT_STATE, inbox, lambda *_: None, waits=False)
    key = ROBOT_STATE.key("t", robot="r1")
    exchange.deliver(exchange.infrastructure, ROBOT_STATE, key, b"{}")
    assert [len(inbox) for inbox in inboxes] == [1, 1]
    link.declarations[0].undeclare()
    for inbox in inboxes:
        inbox.drain_raw()
    exchange.deliver(exchange.infrastructure, ROBOT_STATE, key, b"{}")
    assert [len(inbox) for inbox in inboxes] == [0, 1]
    link.declarations[1].undeclare()
    exchange.deliver(exchange.infrastructure, ROBOT_STATE, key, b"{}")
    assert [len(inbox) for inbox in inboxes] == [0, 1]


@pytest.mark.slow
@settings(max_examples=40)
@given(st.lists(st.tuples(SELECTORS, st.booleans()), max_size=12), st.lists(KEYS, max_size=3))
def test_what_is_declared_is_reached_as_zenoh_matches_keys_in_the_order_of_declaration(steps, keys):
    declared: Declared[int] = Declared()
    there = {}
    for number, (selector, goes) in enumerate(steps):
        if goes and there:
            there.pop(min(there))[1].undeclare()
        there[number] = (selector, declared.add(selector, number))
        for key in (*keys, selector):
            asked = zenoh.KeyExpr(key)
            wanted = [each for each in sorted(there) if zenoh.KeyExpr(there[each][0]).intersects(asked)]
            assert declared.reached(key) == wanted
