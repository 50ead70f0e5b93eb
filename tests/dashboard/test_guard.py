"""The page is for those who open it at its own address, and not for other sites in the operator's browser."""

import gzip
import http.client
import re
from collections.abc import Iterator

import pytest
import viser
import websockets.exceptions
import websockets.sync.client

from robrain.dashboard.server.server import LocalServer, PageGuard, close_server, open_server
from robrain.protocol.errors import WireError
from tests.waiting import PATIENCE_S

PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def server() -> Iterator[LocalServer]:
    server = open_server("127.0.0.1", 0)
    yield server
    close_server(server)


def shake_hands(server: LocalServer, origin: str | None, host: str | None = None) -> int:
    """Status of a websocket's handshake: 101 is accepted."""
    port = server.get_port()
    headers = {} if host is None else {"Host": host.format(port=port)}
    try:
        with websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}",
            origin=None if origin is None else origin.format(port=port),
            subprotocols=[PROTOCOL],
            additional_headers=headers,
            proxy=None,
            open_timeout=PATIENCE_S,
        ) as connection:
            assert connection.response is not None
            return connection.response.status_code
    except websockets.exceptions.InvalidStatus as refused:
        return refused.response.status_code


@pytest.mark.parametrize("origin", [None, "http://127.0.0.1:{port}"])
def test_own_page_and_programs_are_let_in(server: LocalServer, origin: str | None) -> None:
    assert shake_hands(server, origin) == 101


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://127.0.0.1:{port}",
        "http://127.0.0.1:{port}.evil.example",
        "http://127.0.0.1",
        "http://localhost:{port}",  # another site to a browser, as this page was not opened by that name
        "null",  # a sandboxed frame
    ],
)
def test_page_of_another_site_is_refused_before_it_can_say_anything(server: LocalServer, origin: str) -> None:
    assert shake_hands(server, origin) == 403
    assert server.get_clients() == {}


def ask(server: LocalServer, host: str) -> tuple[int, http.client.HTTPMessage, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=PATIENCE_S)
    try:
        connection.putrequest("GET", "/", skip_host=True)
        connection.putheader("Host", host.format(port=server.get_port()))
        connection.endheaders()
        response = connection.getresponse()
        return response.status, response.headers, response.read()
    finally:
        connection.close()


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "localhost:{port}", "[::1]:{port}"])
def test_page_is_served_at_the_names_of_this_computer(server: LocalServer, host: str) -> None:
    status, headers, body = ask(server, host)
    assert status == 200
    page = gzip.decompress(body).decode()
    assert "<title>robrain</title>" in page
    # Only scripts with the page's nonce run, and nobody may frame the page to have its buttons clicked unseen.
    policy = headers["Content-Security-Policy"]
    (nonce,) = re.findall(r"script-src 'nonce-([^']+)'", policy)
    assert "'unsafe-inline'" not in policy.partition("script-src")[2].partition(";")[0]
    assert page.count(f'nonce="{nonce}"') == 3
    assert "frame-ancestors 'none'" in policy
    assert headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize("host", ["evil.example:{port}", "127.0.0.1", "127.0.0.1:1", ""])
def test_name_that_was_bent_to_this_computer_is_refused(server: LocalServer, host: str) -> None:
    assert ask(server, host)[0] == 403


def test_server_does_not_start_where_the_guard_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    class Untaken(PageGuard):
        def installed(self):  # type: ignore[no-untyped-def]
            import contextlib

            return contextlib.nullcontext()

    monkeypatch.setattr("robrain.dashboard.server.server.PageGuard", Untaken)
    with pytest.raises(WireError, match="cannot guard its page"):
        open_server("127.0.0.1", 0)
