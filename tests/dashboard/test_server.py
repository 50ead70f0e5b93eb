import socket
import time

import pytest
import viser

from robrain.dashboard import Dashboard
from robrain.dashboard.server.server import close_server, open_server
from robrain.protocol.errors import PortInUse, WireError
from robrain.protocol.wire.endpoint import Endpoint


def test_port_that_is_taken_is_refused_and_not_moved_from(endpoint: Endpoint) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(PortInUse, match=f"127.0.0.1:{port}"):
            Dashboard(endpoint, port=port)


@pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid"])
def test_host_that_cannot_be_bound_is_refused_at_once(endpoint: Endpoint, host: str) -> None:
    with pytest.raises(WireError, match=host):
        Dashboard(endpoint, host=host, port=0)


def test_two_dashboards_on_free_ports_stand_side_by_side_and_print_nothing(
    endpoint: Endpoint, capfd: pytest.CaptureFixture[str]
) -> None:
    dashboards = [Dashboard(endpoint, port=0) for _ in range(2)]
    for dashboard in dashboards:
        dashboard.step(time.monotonic())
    urls = {dashboard.url for dashboard in dashboards}
    for dashboard in dashboards:
        dashboard.close()
    assert len(urls) == 2
    assert all(url.startswith("http://127.0.0.1:") and not url.endswith(":0") for url in urls)
    out, err = capfd.readouterr()
    assert out == ""
    assert "viser" not in err


def test_no_public_tunnel_is_opened_when_a_client_asks_for_one() -> None:
    server = open_server("127.0.0.1", 0)
    try:
        request = viser._messages.ShareUrlRequest()
        for handle in server._websock_server._incoming_handlers[type(request)]:
            handle(viser.infra.ClientId(1), request)
        server._thread_executor.shutdown(wait=True)
        assert server._share_tunnel is None
    finally:
        close_server(server)
