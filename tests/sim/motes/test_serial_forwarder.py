"""Forwarders of the arena, against clients that are written from the protocol alone."""

import contextlib
import socket
from collections.abc import Iterator

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_RADIO_RX, ARENA_RADIO_TX
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import open_lockstep_session
from robrain.sim.motes.serial_forwarder import MAX_CLIENTS, SerialForwarder
from tests.waiting import PATIENCE_S, until

PACKET = bytes.fromhex("00 FF FF 00 00 08 00 09 19 77 02 07 00 13 00 00")


class Desk:
    """A forwarder, and the air on its other side."""

    def __init__(self) -> None:
        self._session = open_lockstep_session()
        self.endpoint = Endpoint(self._session, "test", LiveClock(), Drive.LOCKSTEP)
        self.forwarder = SerialForwarder(self.endpoint, "r1")
        self._air = self.endpoint.publisher(ARENA_RADIO_RX, robot="r1")
        self.sent = Inbox()
        self.endpoint.subscribe(self.sent, ARENA_RADIO_TX, robot="r1")
        self._clients: list[socket.socket] = []

    def client(self, greeting: bytes = b"U ") -> socket.socket:
        client = socket.create_connection(self.forwarder.address, timeout=PATIENCE_S)
        self._clients.append(client)
        client.sendall(greeting)
        self.forwarder.step()
        return client

    def wait_for_greetings(self) -> None:
        """Until the forwarder has read what the clients greeted with."""
        clients = self.forwarder._clients
        self.until(lambda: len(clients) == len(self._clients) and all(one._decoder.has_greeted for one in clients))

    def hear(self, packet: bytes = PACKET) -> None:
        self._air.put_bytes(packet)

    def until(self, is_so) -> None:
        until(is_so, step=self.forwarder.step, pause_s=0.001)

    def read(self, client: socket.socket, count: int) -> bytes:
        client.setblocking(False)
        got = b""

        def enough() -> bool:
            nonlocal got
            with contextlib.suppress(BlockingIOError):
                got += client.recv(count - len(got))
            return len(got) == count

        self.until(enough)
        return got

    def close(self) -> None:
        for client in self._clients:
            client.close()
        self.forwarder.close()
        self.endpoint.close()
        self._session.close()


@pytest.fixture
def desk() -> Iterator[Desk]:
    opened = Desk()
    yield opened
    opened.close()


def test_what_the_radio_hears_goes_to_every_client_after_the_greeting(desk):
    clients = [desk.client(), desk.client()]
    assert [desk.read(client, 2) for client in clients] == [b"U ", b"U "]
    desk.wait_for_greetings()
    desk.hear()
    for client in clients:
        assert desk.read(client, 17) == b"\x10" + PACKET


def test_what_a_client_sends_goes_on_the_air_in_whatever_pieces_it_comes(desk):
    client = desk.client()
    client.sendall(b"\x10" + PACKET[:7])
    for _ in range(5):
        desk.forwarder.step()
    client.sendall(PACKET[7:])
    desk.until(lambda: len(desk.sent))
    assert [received.message for received in desk.sent.drain()] == [PACKET]


def test_who_greets_otherwise_is_hung_up_on_and_the_others_stay(desk):
    good = desk.client()
    desk.wait_for_greetings()
    desk.client(greeting=b"GET / HTTP/1.1\r\n")
    desk.until(lambda: desk.forwarder.counters.refused == 1)
    assert desk.forwarder.clients == 1
    desk.read(good, 2)
    desk.hear()
    assert desk.read(good, 17) == b"\x10" + PACKET


def test_more_clients_than_a_base_station_serves_are_refused(desk):
    for _ in range(MAX_CLIENTS + 3):
        desk.client()
    desk.until(lambda: desk.forwarder.counters.refused == 3)
    assert desk.forwarder.clients == MAX_CLIENTS


@pytest.mark.slow
def test_a_client_that_does_not_read_misses_packets_and_holds_up_nobody(desk):
    desk.client()
    desk.until(lambda: desk.forwarder.clients == 1)

    def hear_many() -> None:
        for _ in range(1000):
            desk.hear()
        desk.forwarder.step()

    until(lambda: desk.forwarder.counters.missed, step=hear_many, pause_s=0.0)
