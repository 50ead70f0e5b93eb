"""The dashboard's loop in a live process."""

import time
from collections.abc import Callable

from robrain.coordinator.dashboard.dashboard import Dashboard
from robrain.coordinator.dashboard.replay.replay_source import ReplaySource
from robrain.protocol.wire.endpoint import Endpoint

PERIOD_S = 0.1


def run_dashboard(
    team: Endpoint | ReplaySource,
    host: str,
    port: int,
    on_ready: Callable[[str], None],
    should_stop: Callable[[], bool],
) -> None:
    """Serve the dashboard until `should_stop`, stepping it ten times a second.

    Args:
        team: where the team is heard, of the live drive and not closed here; or a recording, which is.
        host: address to serve on.
        port: 0 takes a free one.
        on_ready: told the page's address once it is served.
        should_stop: asked before each step.

    Raises:
        PortTaken: another process listens on `port`.
        WireError: `host` is not an address of this computer.
    """
    dashboard = Dashboard(team, host=host, port=port)
    try:
        on_ready(dashboard.url)
        while not should_stop():
            started_s = time.monotonic()
            dashboard.step(started_s)
            time.sleep(max(0.0, PERIOD_S - (time.monotonic() - started_s)))
    finally:
        dashboard.close()
