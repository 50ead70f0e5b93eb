"""Halts on a flooded network: all arrive, and oversized ones are rejected."""

import threading

import msgspec

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import ROBOT_PATH
from robrain.protocol.messages.team.team_messages import HALT, Halt
from tests.waiting import until

ROBOTS = 4
HALTS = 200
LARGE = b" " * 1_000_000


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


def test_every_halt_reaches_every_robot_while_others_flood_the_network(team):
    inboxes = []
    robots = [team.join() for _ in range(ROBOTS)]
    for robot in robots:
        inboxes.append(Inbox(10_000))
        robot.subscribe(inboxes[-1], HALT)
        robot.subscribe(Inbox(4), ROBOT_PATH)
    publisher = team.join().publisher(HALT)
    heard = [[] for _ in robots]

    def hear():
        for reasons, inbox in zip(heard, inboxes, strict=True):
            reasons += [received.message.reason for received in inbox.drain()]

    def greeted():
        publisher.put(Halt(halted=True, by="ann", reason="hello"))
        hear()
        return all(heard)

    until(greeted)
    forger = team.join()
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
