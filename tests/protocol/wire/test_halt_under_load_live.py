"""Halts on a flooded network: all arrive, and oversized ones are rejected."""

import threading

import msgspec
import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.team_messages import Halt
from robrain.protocol.table.topics import HALT, ROBOT_PATH
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import until

ROBOTS = 4
HALTS = 200
LARGE = b" " * 1_000_000


@pytest.fixture
def network():
    """A router, and a function that opens an endpoint with its own session."""
    router = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    opened = []

    def join():
        session = open_session(connect=listening_at(router))
        endpoint = Endpoint(session, "t", LiveClock(), Drive.LIVE)
        opened.append((endpoint, session))
        return endpoint

    yield join
    for endpoint, session in reversed(opened):
        endpoint.close()
        session.close()
    router.close()


class Flood:
    """Flood the network with messages."""

    def __init__(self, wire):
        self._ends = threading.Event()
        chatter = wire.publisher(ROBOT_PATH, robot="r1")

        def run():
            while not self._ends.wait(0.002):
                chatter.put_bytes(LARGE)

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()

    def end(self):
        self._ends.set()
        self._thread.join()


def test_every_halt_reaches_every_robot_while_others_flood_the_network(network):
    inboxes = []
    robots = [network() for _ in range(ROBOTS)]
    for robot in robots:
        inboxes.append(Inbox(10_000))
        robot.subscribe(inboxes[-1], HALT)
        robot.subscribe(Inbox(4), ROBOT_PATH)
    publisher = network().publisher(HALT)
    heard = [[] for _ in robots]

    def hear():
        for reasons, inbox in zip(heard, inboxes, strict=True):
            reasons += [received.message.reason for received in inbox.drain()]

    def greeted():
        publisher.put(Halt(halted=True, by="ann", reason="hello"))
        hear()
        return all(heard)

    until(greeted)
    forger = network()
    large = msgspec.json.encode(Halt(halted=True, by="forger", reason="x" * 2_000_000))

    def refused():
        forger.session.put(HALT.key("t"), large)  # which a busy network may drop
        return all(robot.refusals.total > 0 for robot in robots)

    until(refused, pause_s=0.2)
    flood = Flood(forger)
    for number in range(HALTS):
        publisher.put(Halt(halted=True, by="ann", reason=f"halt {number}"))
    wanted = {f"halt {number}" for number in range(HALTS)}

    def arrived():
        hear()
        return all(wanted <= set(reasons) for reasons in heard)

    until(arrived)
    flood.end()
    assert not any("x" in reason for reasons in heard for reason in reasons)
    for robot in robots:
        assert [(one.topic, one.code) for one in robot.refusals.counts()] == [("halt", "too_large")]
