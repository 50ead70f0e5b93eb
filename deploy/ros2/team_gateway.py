"""Hears a team on its wire, and has it shown to ROS 2."""

import time
from collections.abc import Callable

import msgspec

from robrain.coordinator.dashboard.state.live_source import MapFetcher
from robrain.coordinator.dashboard.state.map_loading import MapLoading
from robrain.coordinator.drawing.map_view import MapView
from robrain.deploy.ros2.team_publisher import ShownMap, TeamPublisher
from robrain.protocol.model.mapping.map_frame import ARENA
from robrain.protocol.wire.border.border import Received
from robrain.protocol.wire.border.record_guard import RecordGuard
from robrain.protocol.wire.endpoint import Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.topics import ARENA_SCAN, ROBOT_ALIVE, ROBOT_MAP, ROBOT_PATH, ROBOT_STATE, TASK_EVENT

MAP_S = 1.0
"""Least time between two maps; one is shown only if it has changed."""
INBOX = 8192


class TeamGateway:
    """Passes on a team's map, poses, paths, scans and task events.

    Args:
        wire: the team's; not closed by the gateway.
        publisher: speaks to ROS 2.
        now_s: seconds of a clock that is never set.

    """

    def __init__(self, wire: Endpoint, publisher: TeamPublisher, now_s: Callable[[], float] = time.monotonic) -> None:
        self._wire, self._publisher, self._now_s = wire, publisher, now_s
        self._inbox = Inbox(INBOX)
        self._guard = RecordGuard(wire.refusals)
        self._fetcher = MapFetcher(wire, self._inbox)
        self._loading = MapLoading()
        self._map = MapView()
        self._map_version = self._dropped = 0
        self._map_due_s = 0.0
        for topic in (ROBOT_STATE, ROBOT_PATH, ROBOT_MAP, ARENA_SCAN, TASK_EVENT):
            wire.subscribe(self._inbox, topic)
        self._robots = wire.watch(ROBOT_ALIVE)

    @property
    def robots(self) -> list[str]:
        """Robots that are there; sorted."""
        return sorted(names["robot"] for names in self._robots.present.values())

    def step(self) -> None:
        """Pass on what has arrived; never waits for the team."""
        for change in self._robots.changes():
            if change.present:
                self._fetcher.fetch(change.names["robot"])
        self._guard.messages(self._loading.let_through(self._inbox.drain()), self._pass_on)
        dropped = self._inbox.dropped + self._loading.dropped
        if dropped > self._dropped:  # patches may have been among them
            self._dropped = dropped
            for robot in self.robots:
                self._fetcher.fetch(robot)
        if self._map.version != self._map_version and self._now_s() >= self._map_due_s:
            self._map_due_s = self._now_s() + MAP_S
            self._show_map()

    def close(self) -> None:
        """Ask no more."""
        self._fetcher.close()
        self._loading.close()

    def _pass_on(self, received: Received) -> None:
        message, publisher = received.message, self._publisher
        if received.topic is ROBOT_MAP:
            self._map.merge(message)
        elif received.topic is ROBOT_STATE:
            if message.pose is not None and message.frame == ARENA and not message.lost:
                publisher.show_pose(message.robot, message.pose, message.stamp_ns)
        elif received.topic is ROBOT_PATH:
            publisher.show_path(message.robot, message.points, message.stamp_ns)
        elif received.topic is ARENA_SCAN:
            publisher.show_scan(message)
        elif received.topic is TASK_EVENT:
            publisher.tell_event(msgspec.json.encode(message).decode())

    def _show_map(self) -> None:
        grid, self._map_version = self._map.grid, self._map.version
        if grid is not None:
            lies = grid.geometry
            cells = grid.classes()
            stamp_ns = self._wire.clock.now_ns()
            shown = ShownMap(cells, lies.resolution_m, lies.origin_x_m, lies.origin_y_m, stamp_ns)
            self._publisher.show_map(shown)
