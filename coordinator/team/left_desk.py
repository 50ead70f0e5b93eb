"""Publishes what exploration has left when it ends, and answers who asks for it before."""

from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.coordinator.team.roster import Robot, Roster
from robrain.coordinator.team.team_map import TeamMap
from robrain.protocol.clock import to_ns
from robrain.protocol.messages.maps.left_messages import ExplorationLeft
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.map_frame import ARENA
from robrain.protocol.table.topics import COORDINATOR_LEFT, COORDINATOR_LEFT_NOW
from robrain.protocol.wire.endpoint import Endpoint, Request, Serve

PERIOD_NS = to_ns(5.0)
"""Least time from one look at the map to the next; each takes some tens of milliseconds."""

CHANGED_M2, CHANGED_SHARE = 0.5, 0.1
"""A region is published again when its area has changed by more than both (chosen)."""


class LeftDesk:
    """Looks at the team's map for what is left to explore.

    Args:
        wire: the coordinator's Zenoh endpoint.
        explorer: knows where robots failed.
        team_map: the map.
        roster: the robots, also those that are lost: the floor around them counts as reached.

    """

    def __init__(self, wire: Endpoint, explorer: Explorer, team_map: TeamMap, roster: Roster) -> None:
        self._explorer = explorer
        self._map = team_map
        self._roster = roster
        self._publisher = wire.publisher(COORDINATOR_LEFT)
        self._published: ExplorationLeft | None = None
        self._version = 0
        """Of the map that was last looked at."""
        self._due_ns = 0
        wire.answer(COORDINATOR_LEFT_NOW, self._answer, serve=Serve.IN_STEP)

    def step(self, now_ns: int) -> None:
        """While exploration has ended: publish what is left, and again whenever that has changed much."""
        if self._map.version != self._version and now_ns >= self._due_ns:
            self._due_ns = now_ns + PERIOD_NS
            self._version = self._map.version
            left = self._look()
            if left is not None and (self._published is None or _differ(left, self._published)):
                self._publish(left)

    def publish(self) -> ExplorationLeft | None:
        """Publish what is left now unless that was published last; returns it, None before anything is known."""
        left = self._look()
        if left is not None and left != self._published:
            self._publish(left)
        return left

    def _publish(self, left: ExplorationLeft) -> None:
        self._published = left
        self._publisher.put(left)

    def _look(self) -> ExplorationLeft | None:
        return self._explorer.left([scout for robot in self._roster.robots.values() if (scout := _scout(robot))])

    def _answer(self, _request: Request[None]) -> ExplorationLeft | None:
        return self._look()


def _differ(one: ExplorationLeft, other: ExplorationLeft) -> bool:
    """Whether regions have come or gone, are left for another reason, or have grown or shrunk much."""
    if [region.kind for region in one.regions] != [region.kind for region in other.regions]:
        return True
    return any(
        abs(now.area_m2 - before.area_m2) > max(CHANGED_M2, CHANGED_SHARE * before.area_m2)
        for now, before in zip(one.regions, other.regions, strict=True)
    )


def _scout(robot: Robot) -> Scout | None:
    """A robot with its last known place; None if it has never published its state."""
    state = robot.state
    if state is None:
        return None
    place = None if state.pose is None or state.frame != ARENA else Point2D(state.pose.x_m, state.pose.y_m)
    return Scout(robot.name, place, state.radius_m)
