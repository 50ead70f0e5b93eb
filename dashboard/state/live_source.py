"""A live team: its messages come over the wire, and the maps known before are queried."""

import contextlib
import sys
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import zenoh

from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.errors import CallError, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import MapPatch
from robrain.protocol.table.topic import Topic
from robrain.protocol.table.topics import COORDINATOR_ALIVE, ROBOT_ALIVE, ROBOT_MAP, ROBOT_MAP_WHOLE
from robrain.protocol.wire.endpoint import Endpoint
from robrain.recording.drawing.drawn_map import ComposedMap

MERGER = "robrain.algorithms.slam.map_patch"
HELD_PATCHES = 8192
JOIN_S = 3.0


class MapLoading:
    """Holds map patches back while the kernels that merge them are loaded, which begins with the first patch."""

    def __init__(self) -> None:
        self.dropped = 0
        """Patches that were too many to be held."""
        self._held: deque[Received] = deque(maxlen=HELD_PATCHES)
        self._is_over = MERGER in sys.modules
        self._thread: threading.Thread | None = None

    def let_through(self, received: Iterable[Received]) -> Iterable[Received]:
        """The messages that can be processed now: no patches while it loads, then first those that were held."""
        if self._is_over:
            return received
        if self._thread is not None and not self._thread.is_alive():
            self._is_over = True
            held, self._held = self._held, deque()
            return [*held, *received]
        return [one for one in received if not self._hold(one)]

    def forget(self) -> None:
        """Drop the held patches: their run is over."""
        self._held.clear()

    def close(self) -> None:
        """Wait for the thread: native code that it runs must not be cut off when the interpreter ends."""
        if self._thread is not None:
            self._thread.join(JOIN_S)

    def _hold(self, received: Received) -> bool:
        if received.topic is not ROBOT_MAP:
            return False
        if self._thread is None:
            self._thread = threading.Thread(target=load, args=(received.message,), name="loading", daemon=True)
            self._thread.start()
        self.dropped += len(self._held) == HELD_PATCHES
        self._held.append(received)
        return True


def load(patch: MapPatch) -> None:
    """Load the merge of patches."""
    with contextlib.suppress(ValueError):  # its view refuses it as well, and reports it
        ComposedMap().merge(patch)


LINK_PERIOD_S = 1.0
INBOX = 8192
MAP_TIMEOUT_S = 1.0
MAP_ATTEMPTS = 3
MAP_PAUSE_S = 1.0
"""Pause between two attempts: a robot's token can be back before its queryables are."""


class LiveSource:
    """Updates a ShownTeam from the wire.

    Args:
        endpoint: of the team; its owner closes it.
        topics: topics to subscribe to beside those of the view.

    """

    def __init__(self, endpoint: Endpoint, topics: Sequence[Topic[Any]] = ()) -> None:
        self.view = ShownTeam()
        self._endpoint = endpoint
        self._inbox = Inbox(INBOX)
        self._guard = RecordGuard(endpoint.refusals)
        self._fetcher = MapFetcher(endpoint, self._inbox)
        self._loading = MapLoading()
        self._dropped = 0
        self._had_router = False
        self._linked_s: float | None = None
        for topic in dict.fromkeys([*self.view.topics, *topics]):
            endpoint.subscribe(self._inbox, topic)
        self._robots = endpoint.watch(ROBOT_ALIVE)
        self._coordinator = endpoint.watch(COORDINATOR_ALIVE)

    def receive(self, now_s: float) -> None:
        """Process arrived messages; never waits for the team."""
        self._check_link(now_s)
        come = [change.names["robot"] for change in self._robots.changes() if self.view.apply_presence(change)]
        for robot in come:
            self._fetcher.fetch(robot)
        self._coordinator.changes()
        self.view.coordinator_up = bool(self._coordinator.present)
        runs = self.view.runs
        arrived = self._loading.let_through(self._inbox.drain())
        self._guard.messages(arrived, lambda received: self.view.apply(received, now_s))
        self.view.refused = self._endpoint.refusals.counts()
        self.view.count_messages(self._inbox.received, now_s)
        if self.view.runs > runs:
            self._loading.forget()
        dropped = self._inbox.dropped + self._loading.dropped
        if dropped > self._dropped or self.view.runs > runs:
            # Patches may have been among those dropped, or have belonged to the run before.
            self._dropped = dropped
            for name in [robot.name for robot in self.view.robots.values() if robot.present]:
                self._fetcher.fetch(name)

    def close(self) -> None:
        """Ask no more."""
        self._fetcher.close()
        self._loading.close()

    def _check_link(self, now_s: float) -> None:
        """Distinguish a lost link from absent robots: a client that loses its router sees all tokens vanish."""
        if self._linked_s is not None and now_s - self._linked_s < LINK_PERIOD_S:
            return
        self._linked_s = now_s
        routed = bool(self._endpoint.session.info.routers_zid())
        self._had_router |= routed
        self.view.connected = routed or not self._had_router


class MapFetcher:
    """Asks robots for their whole maps on its own thread; the answers enter `inbox` like published patches."""

    def __init__(self, endpoint: Endpoint, inbox: Inbox) -> None:
        self._endpoint = endpoint
        self._inbox = inbox
        self._wanted: set[str] = set()
        self._stopping = threading.Event()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="robrain-whole-map")

    def fetch(self, robot: str) -> None:
        """Ask a robot soon, unless it is queued already."""
        if robot not in self._wanted and not self._stopping.is_set():
            self._wanted.add(robot)
            self._pool.submit(self._fetch, robot)

    def close(self) -> None:
        """Send no more queries; returns within about a second if a query is under way."""
        self._stopping.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _fetch(self, robot: str) -> None:
        self._wanted.discard(robot)
        for _ in range(MAP_ATTEMPTS):
            if self._stopping.is_set():
                return
            try:
                answer = self._endpoint.ask(ROBOT_MAP_WHOLE, timeout_s=MAP_TIMEOUT_S, robot=robot)
            except (CallError, NobodyThere, zenoh.ZError):
                self._stopping.wait(MAP_PAUSE_S)
                continue
            if answer is not None:
                whole = ROBOT_MAP.payloads.write(answer)
                self._inbox.append(ROBOT_MAP, ROBOT_MAP.key(self._endpoint.team, robot=robot), whole)
            return
