"""The base station as a device: counting, flooding, and lines that are not there."""

import os
import socket
import tty
from concurrent.futures import ThreadPoolExecutor

import pytest

from robrain.plugins.device.mote_base.mote_base import MAX_UNSENT_BYTES, MoteBase, SfLink
from robrain.protocol.backoff import Backoff
from robrain.protocol.messages.robots.plugin_messages import ROBOT_EVENT
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_TX
from robrain.protocol.tinyos.serial_line import Deframer, frame
from tests.waiting import PATIENCE_S, until

PACKET = bytes.fromhex("00 ffff 0003 02 22 0a  0001")


def counters(one):
    return one.call("mote_base", "counters")


def troubles(inbox):
    return [received.message.value for received in inbox.drain() if received.message.event == "trouble"]


def flood(one, packets_a_second):
    """To be called in each tick of 20 ms."""
    for _ in range(packets_a_second // 50):
        one.radio(PACKET)


def test_what_the_robot_sends_goes_on_the_air_in_tinyos_own_format(stage):
    one = stage()
    host = one.host("snw_exploration", mote_base={"address": 7})
    sent = one.inbox(ARENA_RADIO_TX, robot="r1")
    host.manager.get("mote_base").live_plugin().send(3, 0x54, b"\x00\x01\x00\x02")
    assert [received.message for received in sent.drain()] == [bytes.fromhex("00 0003 0007 04 22 54 00010002")]
    assert counters(one)["sent"] == 1


def test_a_base_that_floods_is_named_and_the_robot_goes_on_listening_to_some(stage):
    one = stage()
    one.host("snw_exploration", mote_base={"flood_packets_s": 100, "flood_fault_s": 0.0})
    events, states = one.inbox(ROBOT_EVENT), one.inbox(ROBOT_STATE)
    one.run(5.0, each=lambda: flood(one, 5000))
    (trouble,) = troubles(events)
    assert trouble["kind"] == "flood"
    assert "mote_base floods: more than 100 packets in a second" in trouble["why"]
    found = counters(one)
    assert found["flooding"]
    assert found["floods"] == 1
    assert 400 <= found["packets"] <= 600
    assert found["packets"] + found["muted"] + found["dropped"] >= 24_000
    assert one.infos()["mote_base"].state == "active"
    assert one.infos()["snw_exploration"].state == "active"
    assert len(states.drain()) >= 49  # the state goes out at 10 Hz all the same


def test_a_flood_is_a_fault_once_it_has_lasted_for_the_time(stage):
    one = stage()
    one.host("mote_base", mote_base={"flood_packets_s": 100, "flood_fault_s": 1.0})
    events = one.inbox(ROBOT_EVENT)
    while not troubles(events):
        one.run(0.02, each=lambda: flood(one, 1000))
    for seconds, state in ((0.98, "active"), (0.02, "faulted")):
        one.run(seconds, each=lambda: flood(one, 1000))
        assert one.infos()["mote_base"].state == state


@pytest.mark.slow
def test_a_flood_that_does_not_end_is_a_fault_that_the_state_names_until_it_is_over(stage):
    one = stage()
    one.host("snw_exploration", "driver")
    states = one.inbox(ROBOT_STATE)
    one.run(5.4, each=lambda: flood(one, 1000))
    infos = one.infos()
    assert infos["mote_base"].state == "faulted"
    assert "mote_base has flooded for 5 s: more than 200 packets in a second" in infos["mote_base"].why
    assert "requires mote_base" in infos["snw_exploration"].why
    assert infos["driver"].state == "active"
    assert "mote_base" in [fault.plugin for fault in states.drain()[-1].message.faulted]
    one.run(60.0, each=lambda: flood(one, 1000))
    one.run(40.0)  # it is started again, and those that require it
    assert states.drain()[-1].message.faulted == []
    assert [one.infos()[name].state for name in ("mote_base", "snw_exploration")] == ["active", "active"]


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"interface": "sf", "port": 1}, "no Serial Forwarder at 127.0.0.1:1"),
        ({"interface": "serial", "device": "/dev/nothing"}, "no base station at /dev/nothing"),
    ],
)
def test_a_base_station_that_is_not_there_is_told_and_the_robot_starts_without(stage, parameters, sentence):
    one = stage()
    one.host("snw_exploration", "driver", mote_base=parameters)
    infos = one.infos()
    assert infos["mote_base"].state != "active"
    assert sentence in infos["mote_base"].why
    assert infos["driver"].state == "active"


READING = bytes.fromhex("00 FF FF 00 00 08 00 09 19 77 02 07 00 13 00 00")
SENT = bytes.fromhex("00 0003 0000 04 22 54 00010002")


PATIENT = {"connect_timeout_s": PATIENCE_S}


def pass_until(one, is_so):
    """Let the robot's time pass, and as little of ours as it takes."""
    until(is_so, step=lambda: one.run(0.02), pause_s=0.001)


def send(host):
    host.manager.get("mote_base").live_plugin().send(3, 0x54, b"\x00\x01\x00\x02")


# -- TCP ------------------------------------------------------------------------------------------------------


class Forwarder:
    """A Serial Forwarder for one client."""

    def __init__(self, greeting=b"U ", port=0):
        self._greeting = greeting
        self._server = socket.create_server(("127.0.0.1", port))
        self.port = self._server.getsockname()[1]
        self._client = None

    def accept(self):
        self._server.settimeout(PATIENCE_S)
        self._client, _ = self._server.accept()
        self._client.settimeout(PATIENCE_S)
        self._client.sendall(self._greeting)

    def say(self, stream):
        self._client.sendall(stream)

    def read(self, count):
        data = b""
        while len(data) < count:
            data += self._client.recv(count - len(data))
        return data

    def hang_up(self):
        self._client.close()

    def close(self):
        if self._client is not None:
            self._client.close()
        self._server.close()


@pytest.fixture
def forwarders():
    opened = []

    def build(**options):
        opened.append(Forwarder(**options))
        return opened[-1]

    yield build
    for each in opened:
        each.close()


def start_with(stage, forwarder):
    """A robot that finds the forwarder: it greets from another thread while the robot starts."""
    one = stage()
    with ThreadPoolExecutor(1) as pool:
        accepted = pool.submit(forwarder.accept)
        host = one.host(
            "snw_exploration",
            mote_base={"interface": "sf", "port": forwarder.port, "reconnect_first_s": 0.2, **PATIENT},
        )
        accepted.result(PATIENCE_S)
    return one, host


def test_over_tcp_packets_go_both_ways(stage, forwarders):
    forwarder = forwarders()
    one, host = start_with(stage, forwarder)
    assert forwarder.read(2) == b"U "
    forwarder.say(b"\x10" + READING[:5])
    one.run(0.2)
    forwarder.say(READING[5:] + b"\x10" + READING)
    pass_until(one, lambda: counters(one)["packets"] == 2)
    send(host)
    assert forwarder.read(1 + len(SENT)) == bytes([len(SENT)]) + SENT


class Clogged:
    """A connection to a forwarder that greets and then takes nothing any more."""

    family = socket.AF_INET

    def __init__(self, *_address, **_options):
        self.is_closed = False

    def getpeername(self):
        return "127.0.0.1", 9002

    def sendall(self, data):
        pass

    def setblocking(self, blocks):
        pass

    def recv(self, most):
        return b"U "

    def send(self, data):
        raise BlockingIOError

    def close(self):
        self.is_closed = True


def test_while_a_forwarder_takes_nothing_so_many_bytes_wait_and_packets_beyond_are_counted_as_unsent(monkeypatch):
    monkeypatch.setattr(socket, "create_connection", Clogged)
    wanted = MoteBase.Parameters(port=9002, inbox_packets=10, connect_timeout_s=1.0)
    link = SfLink(wanted, Backoff(1.0, 10.0))
    for _ in range(MAX_UNSENT_BYTES // 256):
        link.send(bytes(255), 0)  # 256 bytes with its length
    link.send(SENT, 0)
    assert link.counters()["unsent"] == 0
    link.send(SENT, 0)
    assert link.counters()["unsent"] == 1
    assert not link.down_reason


def test_a_forwarder_that_hangs_up_is_told_and_found_again(stage, forwarders):
    forwarder = forwarders()
    one, host = start_with(stage, forwarder)
    events = one.inbox(ROBOT_EVENT)
    forwarder.hang_up()
    pass_until(one, lambda: counters(one)["down_reason"])
    assert "hung up" in counters(one)["down_reason"] or "reset" in counters(one)["down_reason"]
    send(host)
    assert counters(one)["line"]["unsent"] == 1
    one.run(0.5)
    forwarder.accept()
    pass_until(one, lambda: not counters(one)["down_reason"])
    assert [received.message.value["kind"] for received in events.drain()] == ["lost", "back"]
    forwarder.say(b"\x10" + READING)
    pass_until(one, lambda: counters(one)["packets"] == 1)
    assert counters(one)["line"]["reconnects"] == 1
    assert one.infos()["mote_base"].state == "active"


def test_while_a_forwarder_is_lost_health_tells_since_when_and_when_it_is_sought(stage, forwarders):
    forwarder = forwarders()
    one, _ = start_with(stage, forwarder)
    assert one.call("mote_base", "health") == {
        "is_up": True, "down_reason": "", "down_s": 0.0, "tries": 0, "next_try_s": 0.0,
    }  # fmt: skip
    forwarder.close()
    pass_until(one, lambda: counters(one)["down_reason"])
    one.run(20.0)
    health = one.call("mote_base", "health")
    assert (health["is_up"], health["down_reason"]) == (False, counters(one)["down_reason"])
    assert 19.0 <= health["down_s"] <= 20.1
    assert health["tries"] in (5, 6, 7)  # after 0.2, 0.4, 0.8, 1.6, 3.2, 6.4 and 10 s, and the loss itself
    assert 0.0 < health["next_try_s"] <= 10.0


def is_up(one):
    return one.infos()["mote_base"].state == "active"


def test_a_server_that_is_no_forwarder_is_told_at_the_start(stage, forwarders):
    one, _ = start_with(stage, forwarders(greeting=b"SSH-2.0-x\r\n"))
    assert "expected a Serial Forwarder's greeting b'U '" in one.infos()["mote_base"].why


# -- a serial line --------------------------------------------------------------------------------------------


class SerialMote:
    """The mote's end of a pseudo-terminal: it acknowledges as tos/lib/serial/SerialP.nc does."""

    def __init__(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.device = os.ttyname(self._slave)
        os.set_blocking(self._master, False)
        self._deframer = Deframer()
        self.taken = []
        self.deaf_for = 0
        """So many frames are not acknowledged."""

    def write(self, data):
        os.write(self._master, data)

    def read(self):
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return
        for body in self._deframer.feed(data):
            if self.deaf_for:
                self.deaf_for -= 1
            else:
                self.taken.append(body)
                self.write(frame(bytes([67, body[1]])))

    def close(self):
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)


@pytest.fixture
def mote():
    opened = SerialMote()
    yield opened
    opened.close()


def start_on(stage, mote):
    one = stage()
    host = one.host(
        "snw_exploration",
        mote_base={"interface": "serial", "device": mote.device, "ack_timeout_s": 0.2, "reconnect_first_s": 0.2},
    )
    assert one.infos()["mote_base"].state == "active", one.infos()["mote_base"].why
    return one, host


def test_over_a_serial_line_packets_of_motes_are_heard_between_noise(stage, mote):
    one, _ = start_on(stage, mote)
    good = frame(b"\x45" + READING)
    mote.write(b"\x00noise" + good + good[:9] + good + good[:7] + b"\xff" + good[8:] + good)
    pass_until(one, lambda: counters(one)["packets"] == 3)
    line = counters(one)["line"]
    assert line["stray_bytes"] == 6
    assert line["bad_crc"] + line["bad_length"] + line["bad_escape"] == 2
