"""500 sockets, silent, half-said or unread, on the page and on a robot's text port: bounded, and let go."""

import contextlib
import http.client
import os
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
import viser
import websockets.sync.client

from robrain.dashboard.server.server import LocalServer, close_server, open_server
from robrain.plugins.unit.tcp_socket import TcpSocket
from robrain.protocol.wire.endpoint import Drive
from tests.waiting import PATIENCE_S, until

SOCKETS = 500
SOON_S = 5.0
"""An operator waits no longer for his page."""


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@contextlib.contextmanager
def many(port: int, *said: bytes) -> Iterator[list[socket.socket]]:
    """Sockets that have each said one of these, in turn, and read nothing."""
    with contextlib.ExitStack() as closing:
        found = []
        for number in range(SOCKETS):
            client = closing.enter_context(socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S))
            client.sendall(said[number % len(said)])
            found.append(client)
        yield found


def is_closed(client: socket.socket) -> bool:
    """Whether the other side has ended, whatever it said before."""
    client.setblocking(False)
    try:
        while client.recv(65536):
            pass
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@pytest.fixture
def page() -> Iterator[LocalServer]:
    server = open_server("127.0.0.1", 0)
    yield server
    close_server(server)


def get_page(port: int) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=SOON_S)
    try:
        connection.request("GET", "/")
        response = connection.getresponse()
        response.read()
        return response.status
    finally:
        connection.close()


@pytest.mark.slow
def test_page_is_served_beside_500_sockets_that_want_nothing_and_they_are_let_go(page: LocalServer) -> None:
    port = page.get_port()
    host = f"Host: 127.0.0.1:{port}\r\n".encode()
    assert get_page(port) == 200
    before = descriptors()
    threads = threading.active_count()
    with many(port, b"", b"GET / HTTP/1.1\r\n" + host, b"GET / HTTP/1.1\r\n" + host + b"\r\n") as clients:
        assert get_page(port) == 200
        assert threading.active_count() < threads + 50
        with websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}", subprotocols=[f"viser-v{viser.__version__}"], proxy=None, open_timeout=SOON_S
        ) as browser:
            assert browser.recv(timeout=PATIENCE_S)
        until(lambda: all(is_closed(client) for client in clients), "a socket that says nothing is kept for ever")
    until(lambda: descriptors() <= before + 5)


@pytest.fixture
def text_port() -> Iterator[TcpSocket]:
    command = SimpleNamespace(execute=lambda text: f"ok {text}")
    env = SimpleNamespace(
        robot="r1", plugin="tcp_socket", wire=SimpleNamespace(drive=Drive.LIVE), use=lambda name, interface: command
    )
    plugin = TcpSocket(env, TcpSocket.Parameters(enabled=True))  # type: ignore[arg-type]
    plugin.init()
    plugin.activate()
    yield plugin
    plugin.deactivate()


def asks(client: socket.socket, text: bytes = b"hello") -> bytes:
    """The answer; empty if the other side has ended."""
    try:
        client.sendall(text + b"\n")
        with client.makefile("rb") as answers:
            return answers.readline()
    except OSError:
        return b""


@pytest.mark.slow
def test_500_sockets_on_a_robots_text_port_are_bounded_and_leave_nothing_behind(
    text_port: TcpSocket, caplog: pytest.LogCaptureFixture
) -> None:
    port = text_port.port()
    before = descriptors()
    with socket.create_connection(("127.0.0.1", port), timeout=SOON_S) as client:
        assert asks(client) == b"ok hello\n"
        with many(port, b"", b"half a li") as clients:
            until(lambda: sum(map(is_closed, clients)) >= SOCKETS - 32, "more are connected than may be")
            assert text_port.clients() <= 32
            assert asks(client) == b"ok hello\n"  # who has given a command keeps its place
            until(lambda: _is_let_in(port), "those that say nothing keep everybody out")
        assert text_port.refused() >= SOCKETS - 32
        until(lambda: text_port.clients() == 1)
    told = [record.getMessage() for record in caplog.records if "another came from" in record.getMessage()]
    assert 1 <= len(told) < 5
    assert "32 clients are connected, which are all that may be; another came from 127.0.0.1" in told[0]
    until(lambda: descriptors() <= before + 5)


def _is_let_in(port: int) -> bool:
    with socket.create_connection(("127.0.0.1", port), timeout=SOON_S) as client:
        return asks(client) == b"ok hello\n"
