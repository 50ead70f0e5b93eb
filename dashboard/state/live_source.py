"""A live team: its messages come over the wire, and the maps known before are queried."""

import contextlib
import sys
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

from robrain.dashboard.state.shown_team import ShownTeam
from robrain.protocol.border.border import Received
from robrain.protocol.border.record_guard import RecordGuard
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.maps.map_messages import ROBOT_MAP, ROBOT_MAP_WHOLE, MapPatch
from robrain.protocol.messages.robots.robot_messages import ROBOT_ALIVE
from robrain.protocol.messages.team.team_messages import COORDINATOR_ALIVE
from robrain.protocol.topic import Topic
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.workers import OwnedThread
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
        self._thread: OwnedThread | None = None

    def let_through(self, received: Iterable[Received]) -> Iterable[Received]:
        """The messages that can be processed now: no patches while it loads, then first those that were held."""
        if self._is_over:
            return received
        if self._thread is not None and not self._thread.is_alive:
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
            self._thread.close(JOIN_S)

    def _hold(self, received: Received) -> bool:
        if received.topic is not ROBOT_MAP:
            return False
        if self._thread is None:
            self._thread = OwnedThread("loading", load, received.message)
        self.dropped += len(self._held) == HELD_PATCHES
        self._held.append(received)
        return True


def load(patch: MapPatch) -> None:
    """Load the merge of patches."""
    with contextlib.suppress(ValueError):  # its view refuses it as well, and reports it
        ComposedMap().merge(patch)


LINK_PERIOD_S = 1.0
INBOX = 8192


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
        self._unasked: set[str] = set()
        """Robots that have appeared; they are asked for their maps with their first states."""
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
        self._unasked |= {
            change.names["robot"] for change in self._robots.changes() if self.view.apply_presence(change)
        }
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
            self._unasked |= {robot.name for robot in self.view.robots.values() if robot.present}
        # A robot's token can be back before its queryables are: it answers once it publishes states.
        for robot in [name for name in self._unasked if self._has_state(name, now_s)]:
            self._unasked.discard(robot)
            self._endpoint.ask_into(self._inbox, ROBOT_MAP_WHOLE, ROBOT_MAP, robot=robot)

    def close(self) -> None:
        """Wait until nothing is loaded any more."""
        self._loading.close()

    def _has_state(self, name: str, now_s: float) -> bool:
        robot = self.view.robots.get(name)
        return robot is not None and robot.last_seen_s == now_s

    def _check_link(self, now_s: float) -> None:
        """Distinguish a lost link from absent robots: a client that loses its router sees all tokens vanish."""
        if self._linked_s is not None and now_s - self._linked_s < LINK_PERIOD_S:
            return
        self._linked_s = now_s
        routed = bool(self._endpoint.session.info.routers_zid())
        self._had_router |= routed
        self.view.connected = routed or not self._had_router
