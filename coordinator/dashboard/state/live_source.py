"""A team that is there: what it says comes over the wire, and what was said before is asked for."""

from robrain.coordinator.dashboard.state.map_fetcher import MapFetcher
from robrain.coordinator.dashboard.state.team_view import TeamView
from robrain.protocol.wire.border.record_guard import RecordGuard
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import COORDINATOR_ALIVE, ROBOT_ALIVE

LINK_PERIOD_S = 1.0
INBOX = 8192


class LiveSource:
    """Fills a TeamView from the wire; the endpoint stays its owner's."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.view = TeamView()
        self._endpoint = endpoint
        self._inbox = Inbox(INBOX)
        self._guard = RecordGuard(endpoint.refusals)
        self._fetcher = MapFetcher(endpoint, self._inbox)
        self._dropped = 0
        self._had_router = False
        self._linked_s: float | None = None
        for topic in self.view.topics:
            endpoint.subscribe(self._inbox, topic)
        self._robots = endpoint.watch(ROBOT_ALIVE)
        self._coordinator = endpoint.watch(COORDINATOR_ALIVE)

    def hear(self, now_s: float) -> None:
        """Take in what has arrived; never waits for the team."""
        self._check_link(now_s)
        come = [change.names["robot"] for change in self._robots.changes() if self.view.apply_presence(change)]
        for robot in come:
            self._fetcher.fetch(robot)
        self._coordinator.changes()
        self.view.coordinator_up = bool(self._coordinator.present)
        runs = self.view.runs
        self._guard.messages(self._inbox.drain(), lambda received: self.view.apply(received, now_s))
        self.view.refused = self._endpoint.refusals.counts()
        self.view.count_messages(self._inbox.received, now_s)
        if self._inbox.dropped > self._dropped or self.view.runs > runs:
            # Patches may have been among those dropped, or have belonged to the run before.
            self._dropped = self._inbox.dropped
            for name in [robot.name for robot in self.view.robots.values() if robot.present]:
                self._fetcher.fetch(name)

    def close(self) -> None:
        """Ask no more."""
        self._fetcher.close()

    def _check_link(self, now_s: float) -> None:
        """A client that loses its router is told that everybody has gone; it is the link that has."""
        if self._linked_s is not None and now_s - self._linked_s < LINK_PERIOD_S:
            return
        self._linked_s = now_s
        routed = bool(self._endpoint.session.info.routers_zid())
        self._had_router |= routed
        self.view.connected = routed or not self._had_router
