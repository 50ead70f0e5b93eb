"""A lockstep run that nobody else can join puts nothing on the network; one that others may join puts everything."""

import pytest

from robrain import Scenario
from robrain.protocol.wire.clock import VirtualClock
from robrain.protocol.wire.exchange import Exchange
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robot_messages import RobotState
from robrain.protocol.wire.publisher import Publisher
from robrain.protocol.wire.topics import ROBOT_STATE
from robrain.sim.lockstep.lockstep import LockstepRun

KEY = ROBOT_STATE.key("t", robot="r1")


class Network:
    """Keeps what is put on it."""

    def __init__(self) -> None:
        self.put_there: list[bytes] = []

    def put(self, payload: bytes) -> None:
        self.put_there.append(payload)


@pytest.mark.parametrize("is_alone", [True, False])
def test_what_is_put_reaches_the_run_itself_and_the_network_only_if_somebody_may_be_there(*, is_alone: bool) -> None:
    exchange, network, inbox = Exchange(), Network(), Inbox()
    exchange.is_alone = is_alone
    exchange.subscribe(ROBOT_STATE.selector("t"), ROBOT_STATE, inbox)
    publisher = Publisher(lambda: network, ROBOT_STATE, KEY, VirtualClock(), lambda _: None, exchange)
    publisher.put(RobotState(robot="r1"))
    assert [received.message.robot for received in inbox.drain()] == ["r1"]
    assert len(network.put_there) == (0 if is_alone else 1)


@pytest.mark.parametrize(("listen", "is_alone"), [(None, True), ("tcp/127.0.0.1:0", False)])
def test_a_run_is_alone_unless_it_listens(listen: str | None, *, is_alone: bool) -> None:
    run = LockstepRun(Scenario.builtin("arena_small").world(), listen=listen)
    try:
        assert Exchange.of(run.session).is_alone is is_alone
    finally:
        run.close()
