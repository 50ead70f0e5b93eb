"""Who may open the page: the browser's own tab of it, and no other site that is open in the same browser.

viser checks neither Origin nor Host. Without this, any web page that the operator has open could reach the halt control
on loopback (cross-site WebSocket hijacking, OWASP), by a name that resolves to 127.0.0.1 as well (DNS rebinding).
"""

import contextlib
import gzip
import http
import secrets
import threading
from collections.abc import Callable, Iterator
from importlib import resources
from typing import Any

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

ProcessRequest = Callable[[ServerConnection, Request], Response | None]

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "[::1]")
FORBIDDEN_TEXT = b"This page is for those who open it at its own address.\n"
_swapping = threading.Lock()


class PageGuard:
    """Stands before viser's own handler of requests: refuses strangers, and serves the page with what we add to it.

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
        # Only scripts with the nonce run: what slips through as markup is then still no program.
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
        """While this lasts, a server that viser starts has the guard before it; viser has no way to hand it in."""
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
