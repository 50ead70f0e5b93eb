"""`robrain metrics`: a team's metrics for Prometheus, on a port of this machine alone."""

import time
from collections.abc import Callable
from contextlib import closing

from prometheus_client import CollectorRegistry, start_http_server

from robrain.deploy.observability.team_metrics import TeamMetrics
from robrain.deploy.processes.live_process import LiveStop, live_endpoint, open_when_there, tell
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.errors import PortTaken
from robrain.protocol.wire.hub import team_endpoints

HOST = "127.0.0.1"
HEAR_S = 0.2
FIRST_ASK_S, ASK_PLUGINS_S = 1.0, 10.0


def metrics_command(connect: str | None, team: str, port: int) -> None:
    """Serve a team's metrics until Ctrl-C; wait until the endpoint answers.

    Args:
        connect: endpoint of the team; None uses $ROBRAIN_CONNECT, else this machine's hub.
        team: its name.
        port: 0 takes a free one.

    Raises:
        RobrainError: in one sentence.

    """
    should_stop = LiveStop()
    session = open_when_there("metrics", team_endpoints(connect), should_stop)
    if session is None:
        return
    with closing(session), live_endpoint(session, team) as wire:
        serve_metrics(wire, port, should_stop, lambda url: tell(f"metrics: of team {team} at {url}"))


def serve_metrics(wire: Endpoint, port: int, should_stop: Callable[[], bool], on_ready: Callable[[str], None]) -> None:
    """Serve metrics of the wire's team on loopback until `should_stop`.

    Raises:
        PortTaken: another process listens there.

    """
    metrics, registry = TeamMetrics(wire), CollectorRegistry()
    registry.register(metrics)
    try:
        server, thread = start_http_server(port, addr=HOST, registry=registry)
    except OSError as error:
        raise PortTaken(f"port taken: another process listens on {HOST}:{port}; give another, or 0") from error
    try:
        on_ready(f"http://{HOST}:{server.server_address[1]}/metrics")
        ask_s = time.monotonic() + FIRST_ASK_S
        while not should_stop():
            metrics.hear()
            if time.monotonic() >= ask_s:
                metrics.ask_plugins()
                ask_s = time.monotonic() + ASK_PLUGINS_S
            time.sleep(HEAR_S)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
