"""The live drive: a router on the loopback, and clients of it."""

import re
import threading
import time

import pytest
import zenoh

from robrain.protocol.clock import LiveClock
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links import zenoh_link
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_EVENT, ROBOT_PLUGINS, PluginEvent
from robrain.protocol.wire.endpoint import Drive, Endpoint, Serve
from robrain.protocol.wire.session import open_session
from robrain.protocol.workers import OwnedThread, close_threads
from tests.waiting import PATIENCE_S, until

EVENT = {"robot": "r1", "plugin": "driver", "event": "arrived"}


def ask(endpoint, topic, payload=None, **names):
    """Ask, and again as long as the queryable has not become known through the router."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return endpoint.ask(topic, payload, timeout_s=PATIENCE_S, **names)
        except NobodyThere:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.005)


def test_a_late_joiner_gets_what_was_said_losslessly_before(team):
    publisher = team.join().publisher(ROBOT_EVENT, **EVENT)
    for number in range(5):
        publisher.put(PluginEvent(robot="r1", plugin="driver", event="arrived", value=number))
    inbox = Inbox()
    team.join().subscribe(inbox, ROBOT_EVENT)
    until(lambda: len(inbox) >= 5)
    publisher.put(PluginEvent(robot="r1", plugin="driver", event="arrived", value=5))
    until(lambda: len(inbox) >= 6)
    received = inbox.drain()
    assert [item.message.value for item in received] == [0, 1, 2, 3, 4, 5]
    assert [item.message.seq for item in received] == [0, 1, 2, 3, 4, 5]
    assert all(item.message.stamp_ns > 0 for item in received)


@pytest.mark.parametrize("serve", [Serve.AT_ONCE, Serve.POOL, Serve.SHARED])
def test_errors_of_calls_carry_their_code_across_the_network(team, serve):
    def refuse(request):
        raise CallError(ErrorCode.BUSY, "mocdevice is held by driver", request.names["plugin"])

    robot, operator = team.join(), team.join()
    robot.answer(ROBOT_CALL, refuse, serve=serve, robot="r1")
    with pytest.raises(CallError, match="held by driver") as refused:
        ask(operator, ROBOT_CALL, robot="r1", plugin="mocdevice", function="stop")
    assert (refused.value.code, refused.value.detail) == (ErrorCode.BUSY, "mocdevice")


def test_the_pool_answers_several_at_a_time(team):
    robot, operator = team.join(), team.join()
    together = threading.Barrier(2, timeout=PATIENCE_S)
    robot.answer(ROBOT_CALL, lambda request: together.wait() >= 0, serve=Serve.POOL, robot="r1")
    replies = []

    def call(name: str) -> None:
        replies.append(ask(operator, ROBOT_CALL, robot="r1", plugin="p", function=name))

    close_threads([OwnedThread("asker", call, name) for name in ("a", "b")], PATIENCE_S)
    assert replies == [b"true", b"true"]


@pytest.fixture
def one_at_a_time(team):
    """A robot that answers one call at a time, and a first one that takes until it is let go."""
    robot = Endpoint(team.router, "t", LiveClock(), Drive.LIVE, workers=1)
    let_go, started = threading.Event(), threading.Event()

    def hold(request):
        if request.names["function"] == "first":
            started.set()
            assert let_go.wait(PATIENCE_S)
        return request.names["function"]

    robot.answer(ROBOT_CALL, hold, serve=Serve.POOL, at_once=("urgent",), robot="r1")
    operator = team.join()
    outcomes = {}

    def call(function):
        try:
            outcomes[function] = ask(operator, ROBOT_CALL, robot="r1", plugin="p", function=function)
        except CallError as error:
            outcomes[function] = error.code

    first = OwnedThread("first", call, "first")
    assert started.wait(PATIENCE_S)
    yield robot, call, outcomes, let_go
    let_go.set()
    robot.close()
    first.close(PATIENCE_S)


def test_when_all_threads_are_stuck_calls_are_refused_and_not_kept_waiting(one_at_a_time):
    _, call, outcomes, let_go = one_at_a_time
    call("second")
    call("urgent")
    assert outcomes == {"second": ErrorCode.BUSY, "urgent": b'"urgent"'}
    let_go.set()
    until(lambda: outcomes.get("first") == b'"first"')
    until(lambda: call("third") or outcomes["third"] == b'"third"')


def test_the_end_waits_for_an_answer_that_is_being_made(one_at_a_time):
    robot, _, outcomes, let_go = one_at_a_time
    closing = OwnedThread("closing", robot.close)
    until(lambda: robot.is_closed)
    let_go.set()
    closing.close(PATIENCE_S)
    until(lambda: outcomes.get("first") == b'"first"')


@pytest.mark.slow
def test_the_end_does_not_wait_for_ever_for_an_answer_that_is_stuck(one_at_a_time, caplog):
    robot, _, outcomes, _ = one_at_a_time
    robot.close()
    (warning,) = caplog.messages
    assert re.fullmatch(r"the thread answer-robot_call-[12] does not end, and is abandoned", warning)
    assert outcomes == {}


def test_a_key_that_a_sample_brings_while_the_session_closes_is_used_undeclared():
    session = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    keys = zenoh_link.DeclaredKeys(session)
    session.close()
    assert keys.declared("robrain/default/robot/r1/state") == "robrain/default/robot/r1/state"
    assert keys.keys == {}


class KeysAsked:
    """A session that notes with what keys it is asked."""

    def __init__(self, session):
        self._session = session
        self.keys = []

    def __getattr__(self, name):
        return getattr(self._session, name)

    def get(self, key, *arguments, **options):
        self.keys.append(key)
        return self._session.get(key, *arguments, **options)


def test_what_is_asked_without_waiting_is_asked_by_keys_that_were_declared_once(team):
    answered = []
    for name in ("r1", "r2"):
        team.join().answer(ROBOT_PLUGINS, lambda _: answered.append(1) or [], robot=name)
    asker, inbox = team.join(), Inbox()
    asker.session = session = KeysAsked(asker.session)

    def ask():
        asker.ask_into(inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot="r1")
        inbox.drain()
        return len(answered) > 2

    until(ask)
    assert all(isinstance(key, zenoh.KeyExpr) for key in session.keys)
    assert len({id(key) for key in session.keys}) == 1
    later = asker.ask_later(ROBOT_PLUGINS, robot="r2")
    until(lambda: later.poll() is not None)
    assert isinstance(session.keys[-1], zenoh.KeyExpr)
    assert str(session.keys[-1]).endswith("/r2/plugins")
