"""In a secured team a message or request counts as that of the member whose certificate sends it."""

from datetime import UTC, datetime
from pathlib import Path

import pytest

from robrain.protocol.access.identity import Connection, Identity, remember
from robrain.protocol.access.member import Member, MemberRole
from robrain.protocol.access.signing import signed, vouch_message, vouch_request
from robrain.protocol.clock import VirtualClock
from robrain.protocol.errors import CallError
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.host_messages import HOST_HALT, HaltAnswer, HaltRequest
from robrain.protocol.messages.team.team_messages import HALT, Halt
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from tests.waiting import until

ANN, R1 = Member(MemberRole.OPERATOR, "blue", "ann"), Member(MemberRole.ROBOT, "blue", "r1")
KEY = "robrain/blue/halt"
HQ = Member(MemberRole.COORDINATOR, "blue", "hq")


@pytest.fixture
def endpoint():
    now, opened = datetime.now(UTC), []
    with open_lockstep_session() as session:

        def endpoint_of(member, drive=Drive.LOCKSTEP):
            remember(session, Connection(Identity(Path(), member, now, now), ()))
            opened.append(Endpoint(session, "blue", VirtualClock(), drive))
            return opened[-1]

        yield endpoint_of
        for one in opened:
            one.close()


def test_a_halt_counts_as_that_of_its_sender_whatever_it_claims_and_of_a_robot_not_at_all(endpoint):
    robot = endpoint(R1)
    with pytest.raises(CallError, match="robot:r1 may not publish halt"):
        robot.publisher(HALT).put(Halt(halted=False, by="operator"))

    def vouched(key, by):
        return vouch_message(HALT, key, HALT.payloads.write(Halt(halted=False, by=by)), robot.refusals)

    for by in ("", "ann", "operator:ann"):
        key, payload = vouched(signed(KEY, ANN), by)
        assert (key, HALT.payloads.read(payload).by) == (KEY, "operator:ann")
    for key, by in ((signed(KEY, ANN), "operator:bob"), (signed(KEY, R1), ""), (KEY, "")):
        assert vouched(key, by) is None
    assert robot.refusals.total == 3


def test_a_halt_of_a_secured_team_is_received_in_the_name_of_its_sender(endpoint):
    inbox = Inbox()
    endpoint(R1, Drive.LIVE).subscribe(inbox, HALT)
    endpoint(ANN, Drive.LIVE).publisher(HALT).put(Halt(halted=True, by="ann"))
    until(lambda: inbox.received)
    assert [received.message.by for received in inbox.drain()] == ["operator:ann"]


def test_a_request_counts_as_that_of_its_sender_whatever_it_claims_and_of_a_coordinator_not_at_all(endpoint):
    robot = endpoint(R1)
    robot.answer(HOST_HALT, lambda request: HaltAnswer(robot="r1", halted=True, by=[request.asked.by]), robot="r1")
    assert endpoint(ANN).ask(HOST_HALT, HaltRequest(by="operator:bob"), robot="r1").by == ["operator:ann"]
    with pytest.raises(CallError, match="coordinator:hq may not ask host_halt"):
        endpoint(HQ).ask(HOST_HALT, HaltRequest(), robot="r1")
    for sender, claimed in ((ANN, "operator:bob"), (HQ, "")):  # as by another program
        with pytest.raises(CallError):
            vouch_request(HOST_HALT, "key", HaltRequest(by=claimed), sender, robot.refusals)
    assert robot.refusals.total == 2
