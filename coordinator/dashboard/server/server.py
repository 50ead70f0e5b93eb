"""The web server of the dashboard: viser without its console output, public tunnel and access from other pages."""

import contextlib
import errno
import socket
import warnings
from collections.abc import Iterator
from importlib import resources

import rich
import viser

from robrain.coordinator.dashboard.server.loop_event import wake_on_own_thread
from robrain.coordinator.dashboard.server.page_guard import PageGuard
from robrain.protocol.wire.errors import PortTaken, WireError

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
        PortTaken: another process listens on that port.
        WireError: `host` is not an address of this computer, or this viser takes no guard.
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
    # viser moves on to the next port when it finds one taken, which may happen after the check.
    if port not in (0, server.get_port()):
        close_server(server)
        raise _port_taken(host, port)
    wake_on_own_thread(server)
    server.scene.configure_environment_map(hdri=None)
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.add_light_ambient("/ambient", intensity=AMBIENT)
    return server


def page_head(*, has_halt: bool) -> str:
    """What is added to the head of viser's page: a style, and a script that makes keys and rows of tables work.

    viser's own elements report neither a click on a row nor a held key; `page.js` turns both into what they report.

    Args:
        has_halt: add the halt button; a recording has none.

    Returns:
        HTML with `{nonce}` as placeholder for the script's nonce.

    """
    folder = resources.files("robrain.coordinator.dashboard.server")
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
    """Suppress what viser prints when it starts and stops; it has no option for that."""
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
            raise _port_taken(host, port) from error
        raise WireError(f"the dashboard cannot listen on {host}:{port}: {error.strerror}") from error
    except OverflowError as error:
        raise WireError(f"the dashboard cannot listen on port {port}: expected one from 0 to 65535") from error


def _port_taken(host: str, port: int) -> PortTaken:
    return PortTaken(f"port taken: another process listens on {host}:{port}; give another, or port 0 for a free one")
