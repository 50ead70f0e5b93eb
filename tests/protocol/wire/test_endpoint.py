import threading
import time

import msgspec
import pytest
import zenoh

from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.access.signing import Signing
from robrain.protocol.answers.answering import WaitingQueries
from robrain.protocol.errors import CallError, ErrorCode, ErrorReply
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP_WHOLE
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE, RobotState
from robrain.protocol.messages.tasks.offer_messages import TaskAnswer
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.topic import Urgency
from robrain.protocol.wire.endpoint import Deferred
from robrain.protocol.wire.session import listening_at, open_lockstep_session, open_session
from tests.protocol.lockstep_wire import Wire
from tests.waiting import PATIENCE_S, until

SLOW_S = 0.2
FOO = {"robot": "r1", "plugin": "p", "function": "foo"}


@pytest.fixture
def foreign_queryable(session):
    """Has r9's plugins answered by something that is not ours."""
    declared = []
    yield lambda handler: declared.append(session.declare_queryable(ROBOT_PLUGINS.key("t", robot="r9"), handler))
    for queryable in declared:
        queryable.undeclare()


class Asker(threading.Thread):
    """Asks from a thread that is not the runner's, as another process would."""

    def __init__(self, wire, key, payload=None):
        super().__init__()
        self._ask = lambda: list(wire.other._link.ask(key, payload, Urgency.DATA, PATIENCE_S).answers)
        self.replies = []
        self.start()

    def run(self):
        self.replies = self._ask()

    def reply(self):
        self.join(PATIENCE_S)
        (reply,) = self.replies
        return reply

    def error(self):
        return read_error(self.reply())


def read_error(answer):
    assert answer.is_error
    return msgspec.json.decode(answer.payload, type=ErrorReply)


def wait_for_queries(endpoint, count=1):
    until(lambda: len(endpoint._pending) >= count, "the query has not arrived")


# -- saying and hearing -----------------------------------------------------------------------------------------


def test_what_is_said_bears_the_clocks_time_and_a_number(wire):
    inbox = Inbox(every=True)
    wire.other.subscribe(inbox, ROBOT_STATE)
    publisher = wire.robot.publisher(ROBOT_STATE, robot="r1")
    for stamp_ns in (5, 5, 9):
        wire.clock.advance_to(stamp_ns)
        publisher.put(RobotState(robot="r1", stamp_ns=777, seq=777))
    assert [(item.message.stamp_ns, item.message.seq) for item in inbox.drain()] == [(5, 0), (5, 1), (9, 2)]


def test_samples_from_another_thread_count_as_outside(wire):
    inbox = Inbox()
    wire.other.subscribe(inbox, HALT)
    publisher = wire.robot.publisher(HALT)
    publisher.put(Halt(halted=True, by="runner"))
    sender = threading.Thread(target=publisher.put, args=(Halt(halted=False, by="outside"),))
    sender.start()
    sender.join()
    assert (inbox.received, inbox.outside) == (2, 1)


# -- asking and answering ---------------------------------------------------------------------------------------


def test_a_query_from_the_runners_own_thread_is_answered_at_once(wire):
    asked = []

    def answer(request):
        asked.append((request.names, request.asked))
        return TaskAnswer(accepted=True, why="so be it")

    wire.robot.answer(ROBOT_CALL, answer, robot="r1")
    reply = wire.other.ask(ROBOT_CALL, [1, "two"], **FOO)
    assert msgspec.json.decode(reply, type=TaskAnswer) == TaskAnswer(accepted=True, why="so be it")
    assert asked == [({"team": "t", **FOO}, b'[1,"two"]')]
    assert wire.outside == []


def test_a_query_from_another_thread_waits_for_serve_and_is_told(wire):
    served_on = []

    def answer(request):
        served_on.append(threading.get_ident())
        return request.names["function"]

    wire.robot.answer(ROBOT_CALL, answer, robot="r1")
    key = ROBOT_CALL.key("t", **FOO)
    asker = Asker(wire, key, b"[1]")
    wait_for_queries(wire.robot)
    assert served_on == []
    assert wire.outside == []
    wire.robot.serve()
    assert asker.reply().payload == b'"foo"'
    assert served_on == [threading.get_ident()]
    assert wire.outside == [(key, b"[1]")]


@pytest.mark.parametrize("error", [[], CallError(ErrorCode.REFUSED, "no", "because")])
def test_a_deferred_reply_is_sent_when_its_handler_says_so_from_any_thread(wire, error):
    held = []
    wire.robot.answer(ROBOT_PLUGINS, lambda _: Deferred(held.append), robot="r1")
    replies = []

    def ask():
        try:
            replies.append(wire.other.ask(ROBOT_PLUGINS, robot="r1", timeout_s=PATIENCE_S))
        except CallError as refused:
            replies.append((refused.code, refused.message, refused.detail))

    asker = threading.Thread(target=ask)
    asker.start()
    until(lambda: held, "the handler was not called", step=wire.robot.serve)
    wire.robot.serve()  # the endpoint goes on meanwhile
    asker.join(0.1)
    assert replies == []
    threading.Thread(target=held[0], args=(error,)).start()
    asker.join(PATIENCE_S)
    assert replies == [[] if error == [] else (error.code, error.message, error.detail)]


def test_when_too_many_wait_the_next_is_told_so(wire):
    wire.robot._pending = WaitingQueries(1)
    wire.robot.answer(ROBOT_PLUGINS, lambda _: [], robot="r1")
    key = ROBOT_PLUGINS.key("t", robot="r1")
    first = Asker(wire, key)
    wait_for_queries(wire.robot)
    assert Asker(wire, key).error().code is ErrorCode.BUSY
    wire.robot.serve()
    assert not first.reply().is_error


def test_in_a_secured_team_a_flood_of_one_member_keeps_no_other_out(wire):
    wire.robot._pending = WaitingQueries(2)
    wire.robot._signing = Signing(Member(MemberRole.ROBOT, "t", "r1"))
    answered = []

    def answer(request):
        answered.append(str(request.asker))
        return b"1"

    wire.robot.answer(ROBOT_CALL, answer, robot="r1")

    def ask(member, count):
        key = ROBOT_CALL.key("t", **FOO).replace("robrain/t/", f"robrain/t/as/{member.replace(':', '/')}/")
        asker = Asker(wire, key)
        wait_for_queries(wire.robot, count)
        return asker

    flood = [ask("coordinator:hq", 1), ask("coordinator:hq", 2)]
    assert ask("coordinator:hq", 2).error().code is ErrorCode.BUSY
    ann = ask("operator:ann", 2)
    assert flood[1].error().code is ErrorCode.BUSY
    wire.robot.serve()
    assert not ann.reply().is_error
    assert answered == ["coordinator:hq", "operator:ann"]


@pytest.mark.parametrize(
    ("handler", "sentence"),
    [
        (lambda _: 1 / 0, "ZeroDivisionError: division by zero"),  # raises
        (lambda _: object(), "TypeError: Encoding objects of type object is unsupported"),  # returns what JSON is not
        (lambda request: request.names["mood"], "KeyError: 'mood'"),  # is wrong about its own request
    ],
)
def test_a_handler_that_fails_is_answered_failed_and_logged(wire, caplog, handler, sentence):
    wire.robot.answer(ROBOT_PLUGINS, handler, robot="r1")
    with pytest.raises(CallError, match=sentence) as failed:
        wire.other.ask(ROBOT_PLUGINS, robot="r1")
    assert failed.value.code is ErrorCode.FAILED
    assert "a handler of robot_plugins failed" in caplog.text


@pytest.mark.parametrize(
    "payload",
    [b"", b"nonsense", b"\xff\xfe", b'{"code": "no_such_code", "message": "from a newer peer"}', b"[" * 100_000],
    ids=["empty", "no JSON", "no UTF-8", "a newer code", "nested too deep"],
)
def test_an_error_of_another_make_is_not_taken_for_a_timeout(joined, foreign_queryable, payload):
    foreign_queryable(zenoh.handlers.Callback(lambda query: query.reply_err(payload), indirect=False))
    with pytest.raises(CallError, match="none of ours") as refused:
        joined.other.ask(ROBOT_PLUGINS, robot="r9")
    assert refused.value.code is ErrorCode.FAILED


def test_an_unanswered_query_ends_as_a_timeout(wire):
    kept = []
    wire.robot._link.queryable(ROBOT_PLUGINS.key("t", robot="r9"), kept.append, waits=False)
    with pytest.raises(CallError, match="no reply in time") as late:
        wire.other.ask(ROBOT_PLUGINS, robot="r9", timeout_s=0.1)
    kept.pop().end()
    assert late.value.code is ErrorCode.TIMEOUT


@pytest.mark.slow
def test_a_handler_that_takes_longer_than_the_time_limit_is_waited_for_in_lockstep(wire):
    def slow(request):
        time.sleep(SLOW_S)
        return {"accepted": True, "why": ""}

    wire.robot.answer(ROBOT_CALL, slow, robot="r1")
    wire.robot.answer(ROBOT_MAP_WHOLE, slow, robot="r1")
    assert b"true" in wire.other.ask(ROBOT_CALL, **FOO, timeout_s=SLOW_S / 10)
    assert b"true" in wire.other.ask_later(ROBOT_CALL, **FOO, timeout_s=SLOW_S / 10).poll()
    inbox = Inbox()
    wire.other.ask_into(inbox, ROBOT_MAP_WHOLE, ROBOT_MAP_WHOLE, robot="r1", timeout_s=SLOW_S / 10)
    assert len(inbox) == 1
    wire.other.serve()
    assert wire.outside == []


def test_a_run_that_another_process_answers_cannot_be_repeated():
    run = open_lockstep_session("tcp/127.0.0.1:0")
    elsewhere = open_session(connect=listening_at(run))
    wire = Wire(run)
    key = ROBOT_PLUGINS.key("t", robot="r9")
    queryable = elsewhere.declare_queryable(key, lambda query: query.reply(key, b"[]"))
    try:
        while not list(run.get(key)):  # discovery takes a moment
            time.sleep(0.01)
        assert wire.robot.ask(ROBOT_PLUGINS, robot="r9", timeout_s=PATIENCE_S) == []
        inbox = Inbox()
        wire.robot.ask_into(inbox, ROBOT_PLUGINS, ROBOT_PLUGINS, robot="r9")
        while not len(inbox):
            time.sleep(0.001)
        wire.robot.serve()
        assert wire.outside == [(key, b""), (key, b"[]")]
    finally:
        queryable.undeclare()
        wire.close()
        elsewhere.close()
        run.close()


def test_a_wildcard_query_for_one_key_of_many_is_answered_with_an_error(wire):
    wire.robot.answer(ROBOT_CALL, lambda _: "never", robot="r1")
    (reply,) = wire.other._link.ask("robrain/t/robot/r1/call/**", None, Urgency.DATA, 1.0).answers
    error = read_error(reply)
    assert error.code is ErrorCode.BAD_ARGUMENTS
    assert "ask one concrete key" in error.message


# -- the end ----------------------------------------------------------------------------------------------------


def test_queries_that_wait_at_the_end_are_answered_unloaded(wire):
    asked = []
    wire.robot.answer(ROBOT_MAP_WHOLE, asked.append, robot="r1")
    asker = Asker(wire, ROBOT_MAP_WHOLE.key("t", robot="r1"))
    wait_for_queries(wire.robot)
    wire.robot.close()
    assert asker.error().code is ErrorCode.UNLOADED
    assert asked == []
