"""What is asked, replied and refused is checked in the same way whether queries travel by Zenoh or not."""

import pytest

from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.answers.later import call_error
from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.messages.robots import host_messages
from robrain.protocol.messages.robots.host_messages import HaltAnswer, HaltRequest, ResumeRequest
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL, ROBOT_PLUGINS
from robrain.protocol.messages.tasks.task_messages import TASK_SUBMIT
from robrain.protocol.topic import Urgency
from robrain.protocol.wire.endpoint import Deferred, Drive, Endpoint
from tests.protocol.lockstep_wire import Wire
from tests.waiting import PATIENCE_S

FOO = {"robot": "r1", "plugin": "p", "function": "foo"}


def test_a_query_that_reaches_an_endpoint_while_it_closes_is_answered_unloaded(wire):
    """The one asked first closes the second, which has been found by then."""

    def close_other(_):
        wire.other.close()
        return []

    third, codes = Endpoint(wire.session, "t", wire.clock, Drive.LOCKSTEP), set()
    for robot in ("r1", "r2", "r3", "r4", "r5", "r6", "r7", "r8"):  # Zenoh asks in any order
        wire.other = Endpoint(wire.session, "t", wire.clock, Drive.LOCKSTEP)
        wire.robot.answer(ROBOT_PLUGINS, close_other, robot=robot)
        wire.other.answer(ROBOT_PLUGINS, lambda _: [], robot=robot)
        known = third.ask_later(ROBOT_PLUGINS, robot=robot)._known
        codes.add(known.code if isinstance(known, CallError) else None)
    third.close()
    assert ErrorCode.UNLOADED in codes
    assert codes <= {None, ErrorCode.UNLOADED}


def test_a_reply_on_behalf_of_another_robot_is_refused(wire):
    wire.robot.answer(host_messages.HOST_HALT, lambda _: HaltAnswer(robot="r2", halted=True), robot="r1")
    with pytest.raises(CallError, match="a bad reply: its key says robot r1, its payload r2") as refused:
        wire.other.ask(host_messages.HOST_HALT, HaltRequest(by="ann"), robot="r1")
    assert refused.value.code is ErrorCode.FAILED


def test_reply_in_a_secured_team_is_compared_with_the_robot_that_was_asked(session, monkeypatch):
    monkeypatch.setattr("robrain.protocol.wire.endpoint.member_on", lambda _: Member(MemberRole.OPERATOR, "t", "ann"))
    wire = Wire(session)
    for robot in ("r1", "r2"):
        wire.robot.answer(host_messages.HOST_RESUME, lambda _: HaltAnswer(robot="r1", halted=False), robot=robot)
    assert not wire.other.ask(host_messages.HOST_RESUME, ResumeRequest(by="ann"), robot="r1").halted
    assert not wire.other.ask_later(host_messages.HOST_RESUME, ResumeRequest(by="ann"), robot="r1").poll().halted
    with pytest.raises(CallError, match="its key says robot r2, its payload r1"):
        wire.other.ask(host_messages.HOST_RESUME, ResumeRequest(by="ann"), robot="r2")
    wire.close()


def test_a_request_that_does_not_decode_is_counted_and_no_handler_sees_it(wire):
    seen = []
    wire.robot.answer(TASK_SUBMIT, seen.append)
    for payload, code in ((b"[", "malformed"), (b" " * (TASK_SUBMIT.max_request_bytes + 1), "too_large")):
        (reply,) = wire.other._link.ask(TASK_SUBMIT.key("t"), payload, Urgency.DATA, 1.0).answers
        assert call_error(reply.payload).code is ErrorCode.BAD_ARGUMENTS
        assert code in [refusal.code for refusal in wire.robot.refusals.counts()]
    assert wire.robot.refusals.total == 2
    assert seen == []


def test_a_reply_that_is_too_large_is_refused(wire, monkeypatch):
    monkeypatch.setattr(ROBOT_PLUGINS.payloads, "max_bytes", 8)
    wire.robot.answer(ROBOT_PLUGINS, lambda _: b"[" + b" " * 8 + b"]", robot="r1")
    with pytest.raises(CallError, match="a bad reply"):
        wire.other.ask(ROBOT_PLUGINS, robot="r1")


def test_who_asks_is_told(wire):
    asked = []
    wire.robot.answer(ROBOT_CALL, lambda request: asked.append(request.by), robot="r1")
    wire.other.ask(ROBOT_CALL, **FOO, by="ann")
    wire.other.ask(ROBOT_CALL, **FOO)
    assert asked == ["ann", ""]


def test_a_deferred_reply_whose_sender_forgets_it_is_nobodys(wire):
    wire.robot.answer(ROBOT_PLUGINS, lambda _: Deferred(lambda reply: None), robot="r1")
    with pytest.raises(NobodyThere):
        wire.other.ask(ROBOT_PLUGINS, robot="r1", timeout_s=PATIENCE_S)
