"""The web server of the dashboard: viser without its console output, public tunnel and access from other pages."""

import asyncio
import contextlib
import errno
import gzip
import http
import secrets
import socket
import threading
import warnings
from collections.abc import Callable, Iterator
from importlib import resources
from typing import Any

import rich
import viser
import websockets.asyncio.server
from viser.infra._async_message_buffer import AsyncMessageBuffer
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from robrain.protocol.errors import PortInUse, WireError

ProcessRequest = Callable[[ServerConnection, Request], Response | None]

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")
FORBIDDEN_TEXT = b"This page is for those who open it at its own address.\n"
_swapping = threading.Lock()


class PageGuard:
    """Runs before viser's own handler of requests: refuses strangers, and serves the page with our additions.

    Args:
        host: the address that is listened at; it may be asked for by this name, too.
        head: HTML put into the page's head; `{nonce}` in it becomes the nonce of its scripts.

    """

    def __init__(self, host: str, head: str) -> None:
        self.refused = 0
        """Requests that came from elsewhere."""
        self.is_installed = False
        bare = f"[{host}]" if ":" in host else host
        self._names = {*LOOPBACK_NAMES, bare.lower()}
        # Only scripts with the nonce run: injected markup is then still no program.
        nonce = secrets.token_urlsafe(16)
        page = resources.files("viser").joinpath("client/build/index.html").read_text(encoding="utf-8")
        page = page.replace('e.type="module";', f'e.type="module";e.nonce="{nonce}";')
        page = page.replace("<script", f'<script nonce="{nonce}"')
        page = page.replace("<title>Viser</title>", "<title>robrain</title>")
        page = page.replace("</head>", head.replace("{nonce}", nonce) + "</head>", 1)
        self._page = gzip.compress(page.encode())
        self._headers = {
            "Content-Type": "text/html; charset=utf-8",
            "Content-Encoding": "gzip",
            "Content-Length": str(len(self._page)),
            "Cache-Control": "no-store",
            "X-Frame-Options": "DENY",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Content-Security-Policy": (
                f"default-src 'self' data: blob:; script-src 'nonce-{nonce}' 'unsafe-eval' blob:; "
                "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self' data: blob:; "
                "worker-src blob:; frame-ancestors 'none'; form-action 'none'; base-uri 'none'"
            ),
        }

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Within the block, a server that viser starts has the guard before it; viser has no parameter for it."""
        serve = websockets.asyncio.server.serve

        def guarded(*arguments: Any, process_request: ProcessRequest, **options: Any) -> Any:
            self.is_installed = True
            return serve(*arguments, process_request=self._before(process_request), **options)

        with _swapping:
            websockets.asyncio.server.serve = guarded  # type: ignore[assignment,misc]  # viser offers no hook
            try:
                yield
            finally:
                websockets.asyncio.server.serve = serve  # type: ignore[misc]  # put back

    def _before(self, theirs: ProcessRequest) -> ProcessRequest:
        def process(connection: ServerConnection, request: Request) -> Response | None:
            if not self._is_own(connection, request.headers):
                self.refused += 1
                headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(FORBIDDEN_TEXT))})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, FORBIDDEN_TEXT)
            is_page = request.path.partition("?")[0] in ("/", "/index.html")
            if is_page and request.headers.get("Upgrade", "").lower() != "websocket":
                return Response(http.HTTPStatus.OK, "OK", Headers(self._headers), self._page)
            return theirs(connection, request)

        return process

    def _is_own(self, connection: ServerConnection, headers: Headers) -> bool:
        """Whether a request names this server, and comes from a page of it or from no page at all."""
        port = connection.local_address[1]
        own = {f"{name}:{port}" for name in self._names} | (self._names if port == 80 else set())
        try:
            host, origin = headers.get("Host", "").lower(), headers.get("Origin")
        except MultipleValuesError:
            return False
        return host in own and (origin is None or origin.lower() == f"http://{host}")


class LoopEvent(asyncio.Event):
    """An event that ignores `set` on any thread other than its loop's."""

    def __init__(self, thread: int) -> None:
        super().__init__()
        self._thread = thread

    def set(self) -> None:
        """Wake all waiters if called on the loop's thread."""
        if threading.get_ident() == self._thread:
            super().set()


def wake_on_own_thread(server: viser.ViserServer) -> None:
    """Replace the events of the server's buffer and of each client's buffer, now and when a client connects."""
    connections = server._websock_server

    async def exchange() -> None:
        # viser calls this on the server's thread before it starts the client's producers.
        connections.on_client_connect(lambda connection: _exchange(connection.get_message_buffer()))
        _exchange(connections.get_message_buffer())
        for client in list(connections._client_state_from_id.values()):
            _exchange(client.message_buffer)

    asyncio.run_coroutine_threadsafe(exchange(), server.get_event_loop()).result()


def _exchange(buffer: AsyncMessageBuffer) -> None:
    old = buffer.message_event
    buffer.message_event = LoopEvent(threading.get_ident())
    old.set()  # moves its waiters to the new event


AMBIENT = 1.0
"""Light from everywhere, without which faces turned from the lamps are black."""


class LocalServer(viser.ViserServer):
    """A viser server that never opens a public tunnel: any client may send that request, hidden button or not."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """None, always."""
        return None


def open_server(host: str, port: int, *, has_halt: bool = True) -> LocalServer:
    """Start a server that listens at `host`; port 0 picks a free one, which `get_port()` returns.

    The page has an emergency halt button if `has_halt`.

    Raises:
        PortInUse: another process listens on that port.
        WireError: `host` is not an address of this computer, or this viser accepts no guard.
    """
    _check_free(host, port)
    # A browser may disconnect at any moment; a message to it then is no mistake.
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")
    guard = PageGuard(host, page_head(has_halt=has_halt))
    with quiet(), guard.installed():
        server = LocalServer(host=host, port=port, label="robrain", verbose=False)
    if not guard.is_installed:
        close_server(server)
        raise WireError("the dashboard cannot guard its page against other sites: this version of viser is not known")
    # viser tries the next port when one is in use, which may happen after the check.
    if port not in (0, server.get_port()):
        close_server(server)
        raise _port_in_use(host, port)
    wake_on_own_thread(server)
    server.scene.configure_environment_map(hdri=None)
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.add_light_ambient("/ambient", intensity=AMBIENT)
    return server


def page_head(*, has_halt: bool) -> str:
    """HTML for the head of viser's page: a style, and a script that makes keys and rows of tables work.

    viser's own elements report neither a click on a row nor a held key; `page.js` turns both into events that they
    report.

    Args:
        has_halt: add the halt button; a recording has none.

    Returns:
        HTML with `{nonce}` as placeholder for the script's nonce.

    """
    folder = resources.files("robrain.dashboard.server")
    style = folder.joinpath("page.css").read_text(encoding="utf-8")
    script = folder.joinpath("page.js").read_text(encoding="utf-8")
    mark = '<meta name="rb-halt" content="yes">' if has_halt else ""
    return f'{mark}<style>{style}</style><script nonce="{{nonce}}">{script}</script>'


def close_server(server: viser.ViserServer) -> None:
    """Stop serving; open pages then show that the connection is lost."""
    with quiet():
        server.stop()


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Suppress viser's output when it starts and stops; it has no option for that."""
    console = rich.get_console()
    before = console.quiet
    console.quiet = True
    try:
        yield
    finally:
        console.quiet = before


def _check_free(host: str, port: int) -> None:
    """Try the bind first: viser would hang on a host that cannot be bound, and move on from a port that is taken."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise _port_in_use(host, port) from error
        raise WireError(f"the dashboard cannot listen on {host}:{port}: {error.strerror}") from error
    except OverflowError as error:
        raise WireError(f"the dashboard cannot listen on port {port}: expected one from 0 to 65535") from error


def _port_in_use(host: str, port: int) -> PortInUse:
    return PortInUse(f"port taken: another process listens on {host}:{port}; give another, or port 0 for a free one")
