"""Live: replies and samples wait for the inbox's owner, without a thread for each, and wake who waits for them."""

import threading
import time

import pytest

from robrain.protocol.errors import CallError, ErrorCode
from robrain.protocol.links.inbox import ASKED_MAX, Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import ROBOT_OFFER
from robrain.protocol.wire.endpoint import Serve
from tests.waiting import until


@pytest.fixture
def pair(team):
    return team.join(), team.join()


def ask_until_there(team, inbox):
    """The first queries may come before the queryable is known."""

    def asked():
        team.ask_into(inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot="r1")
        time.sleep(0.02)
        return inbox.drain()

    return until(asked)


def test_a_query_that_is_refused_is_sent_again_until_it_is_answered(pair):
    robot, team = pair
    refusals = []

    def busy_at_first(_request):
        if refusals:
            raise refusals.pop()
        return []

    robot.answer(ROBOT_PLUGINS, busy_at_first, robot="r1")
    inbox = Inbox()
    ask_until_there(team, inbox)
    refusals += [CallError(ErrorCode.BUSY, "not now")] * 3
    team.ask_into(inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot="r1")
    assert [one.message for one in until(inbox.drain)] == [[]]


def test_a_query_that_is_always_refused_leaves_the_inbox_as_it_is_and_ends(pair):
    robot, team = pair
    asked = []

    def refuse(_request):
        asked.append(None)
        raise CallError(ErrorCode.BUSY, "not now")

    robot.answer(ROBOT_PLUGINS, refuse, robot="r1")
    inbox = Inbox()
    for name in ("r1", "nobody"):
        team.ask_into(inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot=name, timeout_s=0.5)
    until(lambda: inbox.drain() or not inbox.has_some)
    assert len(asked) <= ASKED_MAX
    assert inbox.drain() == []


def test_who_sleeps_is_woken_by_a_query_and_by_a_sample(pair):
    robot, team = pair
    woken, heard = threading.Event(), threading.Event()
    robot.on_waiting = woken.set
    team.on_receive = heard.set
    robot.answer(ROBOT_OFFER, lambda _request: None, serve=Serve.IN_STEP, robot="r1")
    team.subscribe(Inbox(), ROBOT_STATE)
    states = robot.publisher(ROBOT_STATE, robot="r1")
    until(lambda: states.put(RobotState(robot="r1")) or heard.wait(0.05))

    def asked():
        team.ask_into(Inbox(), ROBOT_OFFER, ROBOT_OFFER, robot="r1", timeout_s=0.5)
        return woken.wait(0.05)

    until(asked)
    robot.serve()
