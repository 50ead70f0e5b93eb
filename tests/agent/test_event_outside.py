"""Marked events leave the robot."""

import socket
import threading
import time
from contextlib import suppress

import msgspec
import pytest

from robrain.agent.event import Event, EventPublisher
from robrain.agent.lifecycle.transitions import Trigger
from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.waiting import until

CUT_S = 1.2

BELL = """
    import typing
    class Bell(Device):
        rung = Event[object](outside=True)
        touched = Event[int]()
        def activate(self): self.rung.notify("activated")
        def deactivate(self): self.rung.notify("deactivated")
        @external
        def ring(self, value: "typing.Any" = None) -> None:
            self.rung.notify(value)
            self.touched.notify(1)
"""


@pytest.fixture
def bell(bench):
    bench.code("bell", BELL)
    bench.manifest("bell", "bell:Bell")
    bench.inbox = Inbox()
    bench.wire.subscribe(bench.inbox, ROBOT_EVENT)
    bench.start("bell")
    return bench


def heard(bench):
    return [received.message.value for received in bench.inbox.drain()]


def test_a_marked_event_leaves_the_robot_with_stamp_and_number_and_others_stay(bell):
    bell.tick(5)
    for value in (1, "two", {"three": [3.0]}, None):
        bell.call("bell", "ring", [value])
    received = bell.inbox.drain()
    assert {item.key for item in received} == {"robrain/default/robot/r1/event/bell/rung"}
    assert [item.message.value for item in received] == ["activated", 1, "two", {"three": [3.0]}, None]
    assert [item.message.seq for item in received] == [0, 1, 2, 3, 4]
    assert [item.message.stamp_ns for item in received] == [0, *[100_000_000] * 4]
    assert {(item.message.robot, item.message.plugin, item.message.event) for item in received} == {
        ("r1", "bell", "rung")
    }


@pytest.mark.parametrize(
    "value",
    [
        object(),  # no word for it
        "\ud800",  # half a character
        {(1, 2): 3},  # a key that is no text
        None,  # filled in below: nested without end
    ],
    ids=["object", "surrogate", "key", "nested"],
)
def test_what_json_has_no_word_for_stays_counted_and_is_logged_once(bell, caplog, value):
    if value is None:
        value = []
        value.append(value)
    plugin = bell.plugin("bell")
    heard(bell)
    for _ in range(3):
        plugin.rung.notify(value)
    plugin.rung.notify("fine")
    received = bell.inbox.drain()
    assert [(item.message.value, item.message.seq) for item in received] == [("fine", 1)]
    assert plugin.rung.unsent == 3
    (record,) = caplog.records
    assert record.message.startswith("r1: event rung of plugin bell stays in the robot: ")
    assert bell.infos()["bell"].state == "active"


def test_what_is_notified_after_the_end_stays_in_the_robot(bell):
    plugin = bell.plugin("bell")
    tag = bell.hosts[-1].manager.get("bell")
    heard(bell)
    leave = plugin.rung.leave
    tag.apply(Trigger.DEACTIVATE)
    assert heard(bell) == ["deactivated"]
    plugin.rung.notify("late")
    leave("later")  # a notifier's thread was on its way
    assert heard(bell) == []
    tag.activate()
    plugin.rung.notify("again")
    assert heard(bell) == ["activated", "again"]


def test_a_reloaded_plugin_says_each_event_once_and_its_publishers_do_not_pile_up(bell):
    manager = bell.hosts[-1].manager
    heard(bell)
    for _ in range(5):
        manager.reload("bell")
        assert heard(bell) == ["deactivated", "activated"]
        bell.call("bell", "ring", [1])
        assert heard(bell) == [1]
    manager.unload("bell")
    assert heard(bell) == ["deactivated"]


def test_a_reload_that_fails_leaves_the_old_ones_events_on_the_wire(bell):
    (bell.place / "bell.py").write_text(
        (bell.place / "bell.py").read_text().replace('self.rung.notify("activated")', "raise RuntimeError('no')")
    )
    heard(bell)
    with pytest.raises(Exception, match="keeps running"):
        bell.hosts[-1].manager.reload("bell")
    assert heard(bell) == ["deactivated", "activated"]
    bell.call("bell", "ring", [1])
    assert heard(bell) == [1]


def test_a_mark_that_comes_or_goes_with_a_reload_counts(bell):
    path = bell.place / "bell.py"
    source = path.read_text()
    heard(bell)
    path.write_text(source.replace("outside=True", "outside=False"))
    bell.hosts[-1].manager.reload("bell")
    bell.call("bell", "ring", [1])
    assert heard(bell) == ["deactivated"]
    path.write_text(source)
    bell.hosts[-1].manager.reload("bell")
    bell.call("bell", "ring", [2])
    assert heard(bell) == ["activated", 2]


# -- live ---------------------------------------------------------------------------------------------------------


class Cable:
    """A TCP connection to a port that can be cut."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._whole = True
        self._ends: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        self._whole = False
        for end in self._ends:
            with suppress(OSError):  # the other direction was first
                end.shutdown(socket.SHUT_RDWR)
        self._ends.clear()

    def mend(self) -> None:
        self._whole = True

    def close(self) -> None:
        self.cut()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            if not self._whole:
                near.close()
                continue
            far = socket.create_connection(("127.0.0.1", self._port))
            self._ends += [near, far]
            for source, target in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(source, target), daemon=True).start()

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        with source, target, suppress(OSError):
            while chunk := source.recv(65536):
                target.sendall(chunk)


class Clapper:
    rung = Event[int](outside=True)


@pytest.mark.slow
def test_events_notified_while_the_link_is_cut_arrive_afterwards_all_and_in_order():
    router = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    (endpoint,) = listening_at(router)
    cable = Cable(int(endpoint.rpartition(":")[2]))
    robot_session = open_session(connect=[f"tcp/127.0.0.1:{cable.port}"])
    team_session = open_session(connect=[endpoint])
    robot, team = (Endpoint(session, "t", LiveClock(), Drive.LIVE) for session in (robot_session, team_session))
    try:
        inbox, plain, got = Inbox(), [], []
        team.subscribe(inbox, ROBOT_EVENT)
        clapper = Clapper()
        outside = EventPublisher(clapper.rung, robot, robot="r1", plugin="bell", event="rung")
        watcher = team_session.declare_subscriber("robrain/t/robot/r1/state", lambda sample: plain.append(sample))
        beside = robot_session.declare_publisher("robrain/t/robot/r1/state")

        def ring(number):
            clapper.rung.notify(number)
            beside.put(msgspec.json.encode(number))
            time.sleep(0.02)

        clapper.rung.notify(-1)
        until(lambda: len(inbox) == 1)
        until(lambda: beside.put(b"-1") or plain)
        inbox.drain()
        plain.clear()
        for number in range(10):
            ring(number)
        cable.cut()
        began_s, count = time.monotonic(), 10
        while time.monotonic() - began_s < CUT_S:
            ring(count)
            count += 1
        cable.mend()
        for number in range(count, count + 10):
            ring(number)
        count += 10
        until(lambda: got.extend(received.message for received in inbox.drain()) or len(got) >= count)
        assert [message.value for message in got] == list(range(count))
        assert [message.seq for message in got] == list(range(1, count + 1))
        assert len(plain) < count  # the cut was one: what is not lossless has been lost
        watcher.undeclare()
        outside.close()
    finally:
        for each in (robot, team, robot_session, team_session):
            each.close()
        cable.close()
        router.close()
