"""Base stations of a live arena over TCP: TinyOS' own tools could be the client, and so could a robot's plugin."""

import json
import socket
import time
from functools import partial

import pytest

from robrain.protocol.errors import CallError
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from tests.asking import until_answered
from tests.system.conftest import member_at
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

MOTES = """
[scenario]
name = "near"
[floor]
size_m = [4.0, 4.0]
[team]
robots = 1
[motes]
count = 3
period_s = 0.5
jitter_s = 0.05
"""


def start_arena(commands):
    """A live arena with a robot among three motes: its hub's endpoint, and where the base station listens."""
    (commands.folder / "near.toml").write_text(MOTES)
    arena = commands.start("arena", "near.toml", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    address = commands.line_with(arena, "serial forwarder of r1: ").split(": ")[1].strip()
    endpoint = commands.line_with(arena, "arena: near at ").split(" at ")[1].split(",")[0]
    host, _, port = address.partition(":")
    return endpoint, host, int(port)


class Client:
    """As few lines as the protocol takes: `U ` from both sides, then a length byte and the packet."""

    def __init__(self, host, port):
        self._socket = socket.create_connection((host, port), timeout=PATIENCE_S)
        self._socket.sendall(b"U ")
        assert self._read(2) == b"U "

    def read_packet(self):
        return self._read(self._read(1)[0])

    def send_packet(self, packet):
        self._socket.sendall(bytes([len(packet)]) + packet)

    def close(self):
        self._socket.close()

    def _read(self, count):
        data = b""
        while len(data) < count:
            data += self._socket.recv(count - len(data))
        return data


def test_an_independent_client_hears_the_motes_and_commands_one(commands) -> None:
    _, host, port = start_arena(commands)
    client = Client(host, port)
    packet = client.read_packet()
    # dispatch, destination, source, length, group, type, then mote, sequence, oldest, age, period, …
    assert (packet[0], packet[1:3], packet[5], packet[6], packet[7]) == (0, b"\xff\xff", 24, 0x22, 0x52)
    mote = packet[3:5]
    assert packet[8:10] == mote
    assert packet[18:20] == b"\x00\x05"  # every 0.5 s
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:  # it listens for a moment after each packet of its own
        packet = client.read_packet()
        if packet[3:5] == mote:
            if packet[18:20] == b"\x00\x14":
                break
            client.send_packet(b"\x00" + mote + b"\x00\x00\x02\x22\x56\x00\x14")  # duty: every 2 s
    assert packet[18:20] == b"\x00\x14"
    client.close()


def test_a_robot_goes_by_its_base_station_s_forwarder(commands) -> None:
    endpoint, host, port = start_arena(commands)
    robot_file = commands.folder / "r1.toml"
    text = robot_file.read_text()
    assert f"# port = {port}" in text
    robot_file.write_text(text + f'\n[parameters.mote_base]\ninterface = "sf"\nhost = "{host}"\nport = {port}\n')
    commands.agents("r1")
    with member_at(endpoint) as wire:

        def told(plugin, function):
            ask = partial(wire.ask, ROBOT_CALL, [], robot="r1", plugin=plugin, function=function)
            return json.loads(until_answered(ask))

        def motes():
            try:
                return [row["mote"] for row in told("snw_exploration", "motes")]
            except CallError:  # its device may not be there yet
                return []

        until(lambda: motes() == ["m1", "m2", "m3"], "not all motes were heard", pause_s=0.2)
        counters = told("mote_base", "counters")
        assert counters["line"] == {"unsent": 0, "reconnects": 0}
