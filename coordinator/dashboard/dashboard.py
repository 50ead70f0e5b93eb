"""The dashboard: hears what the team says, and draws it for browsers."""

import time

from robrain.coordinator.dashboard.map_fetcher import MapFetcher
from robrain.coordinator.dashboard.panel import Panel
from robrain.coordinator.dashboard.scene import Scene
from robrain.coordinator.dashboard.server import close_server, open_server
from robrain.coordinator.dashboard.team_view import TeamView
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, ROBOT_ALIVE

LINK_PERIOD_S = 1.0
UNWATCHED_PERIOD_S = 1.0
"""With no browser looking on, the picture is only kept fit for one that comes."""
INBOX = 8192


class Dashboard:
    """A Zenoh client like any other, with a web page.

    Its owner calls `step()` about ten times a second, and `close()` at the end; the endpoint stays the owner's.

    Args:
        endpoint: where the team is heard, and halted.
        host: address to serve the page on. There is no log-in: anyone who reaches it can halt and resume the team.
        port: 0 takes a free one.

    Raises:
        PortTaken: another process listens on `port`.
        WireError: `host` is not an address of this computer.
    """

    def __init__(self, endpoint: Endpoint, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.view = TeamView()
        self._endpoint = endpoint
        self._host = host
        self._server = open_server(host, port)
        self._scene = Scene(self._server)
        self._panel = Panel(self._server, endpoint, self._scene)
        self._inbox = Inbox(INBOX)
        self._fetcher = MapFetcher(endpoint, self._inbox)
        self._dropped = 0
        self._had_router = False
        self._linked_s: float | None = None
        self._drawn_s: float | None = None
        for topic in self.view.topics:
            endpoint.subscribe(self._inbox, topic)
        self._robots = endpoint.watch(ROBOT_ALIVE)
        self._coordinator = endpoint.watch(COORDINATOR_ALIVE)

    @property
    def url(self) -> str:
        """Where the page is to be found."""
        host = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(self._host, self._host)
        return f"http://{host}:{self._server.get_port()}"

    def step(self) -> None:
        """Take in what arrived and draw what changed; never waits for the team."""
        now_s = time.monotonic()
        self._hear(now_s)
        watched = bool(self._server.get_clients())
        if watched or self._drawn_s is None or now_s - self._drawn_s >= UNWATCHED_PERIOD_S:
            self._drawn_s = now_s
            with self._server.atomic():
                self._scene.draw(self.view, now_s)
                self._panel.draw(self.view, now_s)

    def close(self) -> None:
        """Stop serving the page."""
        self._fetcher.close()
        close_server(self._server)

    def _hear(self, now_s: float) -> None:
        self._check_link(now_s)
        come = [change.names["robot"] for change in self._robots.changes() if self.view.apply_presence(change)]
        for robot in come:
            self._fetcher.fetch(robot)
        self._coordinator.changes()
        self.view.coordinator_up = bool(self._coordinator.present)
        runs = self.view.runs
        for received in self._inbox.drain():
            self.view.apply(received, now_s)
        self.view.count_messages(self._inbox.received, now_s)
        if self._inbox.dropped > self._dropped or self.view.runs > runs:
            # Patches may have been among those dropped, or have belonged to the run before.
            self._dropped = self._inbox.dropped
            for name in [robot.name for robot in self.view.robots.values() if robot.present]:
                self._fetcher.fetch(name)

    def _check_link(self, now_s: float) -> None:
        """A client that loses its router is told that everybody has gone; it is the link that has."""
        if self._linked_s is not None and now_s - self._linked_s < LINK_PERIOD_S:
            return
        self._linked_s = now_s
        routed = bool(self._endpoint.session.info.routers_zid())
        self._had_router |= routed
        self.view.connected = self._panel.halt.connected = routed or not self._had_router
