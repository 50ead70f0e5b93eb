"""A base station's serial line that is pulled out and plugged in again."""

import pytest

from robrain.plugins.device.mote_base import mote_base
from robrain.plugins.device.mote_base.mote_base import MoteBase, SerialLineLink
from robrain.protocol.backoff import Backoff
from robrain.protocol.clock import NS_PER_S
from robrain.protocol.tinyos.serial_line import frame

SHORT = bytes.fromhex("00 FF FF 00 00 04 22 06 00 02 00 01")
ARRIVING = frame(b"\x45" + SHORT)


class Socket:
    """Where the base station is plugged in, and what goes over the line."""

    def __init__(self):
        self.is_plugged = True
        self.takes = 1000
        """So many bytes are taken by each write."""
        self.attempts = self.opened = self.closed = 0
        self.arriving = self.written = b""

    def open(self, device, baud, **options):
        assert (device, baud) == ("/dev/ttyUSB0", 57_600)
        assert options == {"timeout": 0, "write_timeout": 0}
        self.attempts += 1
        self._check()
        self.opened += 1
        return self

    def read(self, most):
        self._check()
        data, self.arriving = self.arriving[:most], self.arriving[most:]
        return data

    def write(self, data):
        self._check()
        self.written += data[: self.takes]
        return min(self.takes, len(data))

    def close(self):
        self.closed += 1

    def _check(self):
        if not self.is_plugged:
            raise OSError("unplugged")


@pytest.fixture
def socket(monkeypatch):
    plug = Socket()
    monkeypatch.setattr(mote_base.serial, "Serial", plug.open)
    return plug


def line():
    return SerialLineLink(MoteBase.Parameters(ack_timeout_s=1.0), Backoff(1.0, 4.0))


def test_line_that_was_pulled_out_is_opened_again_when_it_is_due(socket):
    link = line()
    socket.is_plugged = False
    assert link.receive(0) == []
    assert (link.down_reason, socket.closed) == ("/dev/ttyUSB0: unplugged", 1)
    socket.is_plugged, socket.arriving = True, ARRIVING
    assert link.receive(NS_PER_S - 1) == []
    assert socket.opened == 1
    assert link.receive(NS_PER_S) == []  # opened, and read from the next step on
    assert (link.down_reason, socket.opened, link.counters()["reopened"]) == ("", 2, 1)
    assert link.receive(NS_PER_S + 1) == [SHORT]


def test_line_that_stays_away_is_tried_less_and_less_often(socket):
    link = line()
    socket.is_plugged = False
    attempts = []
    for second in range(18):
        link.receive(second * NS_PER_S)
        attempts.append(socket.attempts)
    tries = [second for second in range(1, 18) if attempts[second] > attempts[second - 1]]
    assert tries == [1, 3, 7, 11, 15]
    assert link.counters()["reopened"] == 0
    assert link.down_reason


def test_line_that_is_lost_while_sending_is_told_and_sends_after_it_is_back(socket):
    link = line()
    socket.is_plugged = False
    link.send(SHORT, 0)
    assert link.down_reason == "/dev/ttyUSB0: unplugged"
    link.send(SHORT, 0)  # waits; there is nothing to write to
    socket.is_plugged = True
    link.receive(NS_PER_S)
    assert socket.written == b""
    link.receive(2 * NS_PER_S)
    assert SHORT in socket.written


def test_what_a_line_does_not_take_at_once_is_written_later_in_order(socket):
    link, whole = line(), line()
    whole.send(SHORT, 0)
    expected, socket.written, socket.takes = socket.written, b"", 5
    link.send(SHORT, 0)
    assert socket.written == expected[:5]
    for _ in range(5):
        link.receive(1)
    assert socket.written == expected
