"""Robots' hosts in lockstep that may have bodies in an arena: the bench of the tests of plugins."""

from collections.abc import Callable
from typing import Any

import zenoh

from robrain.agent.authoring.testing import TICK_S, HostBench
from robrain.agent.host.agent_host import AgentHost
from robrain.protocol.clock import to_ns
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE, TeamState
from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.topic import Topic
from robrain.sim.maps.floor_plan import FloorPlan
from robrain.sim.world.arena import Arena
from robrain.sim.world.referee import team_geometry

TICK_NS = to_ns(TICK_S)
COORDINATOR_PERIOD_TICKS = 25


def start_parameters(plan: FloorPlan, pose: Pose2D) -> dict[str, dict[str, Any]]:
    """Parameters of a robot that knows where it starts and how large the arena is."""
    grid = team_geometry(plan)
    return {
        "localisation": {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_rad": pose.yaw_rad},
        "mapper": {
            "resolution_m": grid.resolution_m,
            "origin_x_m": grid.origin_x_m,
            "origin_y_m": grid.origin_y_m,
            "width_m": grid.width * grid.resolution_m,
            "height_m": grid.height * grid.resolution_m,
        },
    }


class ArenaBench(HostBench):
    """Moves the arena, if there is one, and the hosts; a coordinator may say that it is there, and nothing more."""

    arena: Arena

    def __init__(self, session: zenoh.Session, team: str, *, coordinator_speaks: bool = False) -> None:
        super().__init__(session, team)
        self.coordinator_speaks = coordinator_speaks
        self._ticks = 0
        self._publishers: dict[str, Any] = {}

    def robot(self, name: str = "r1") -> AgentHost:
        """The host of a robot."""
        return next(host for host in self.hosts if host.name == name)

    def plugin(self, name: str, robot: str = "r1") -> Any:
        """A plugin, whatever its state."""
        return self.robot(robot).manager.get(name).plugin

    def run(self, duration_s: float, each: Callable[[], None] | None = None) -> None:
        """Ticks; `each` is called in every one, after the arena's step and before the robots'."""
        for _ in range(round(to_ns(duration_s) / TICK_NS)):
            self._ticks += 1
            self.clock.advance_to(self._ticks * TICK_NS)
            if hasattr(self, "arena"):
                self.arena.step()
            if self.coordinator_speaks and self._ticks % COORDINATOR_PERIOD_TICKS == 1:
                self.publisher(COORDINATOR_STATE).put(TeamState(robots=[]))
            if each is not None:
                each()
            for host in self.hosts:
                host.step()

    def run_until(self, is_so: Callable[[], bool], limit_s: float, step_s: float = TICK_S) -> float:
        """Run until it is so; returns how long that took."""
        for step in range(round(limit_s / step_s)):
            if is_so():
                return step * step_s
            self.run(step_s)
        assert is_so(), f"not so after {limit_s} s"
        return limit_s

    def inbox(self, topic: Topic, **names: str) -> Inbox:
        """Every message on a topic from now on."""
        inbox = Inbox(100_000, every=True)
        self.wire.subscribe(inbox, topic, **names)
        return inbox

    def publisher(self, topic: Topic, **names: str) -> Any:
        """The publisher of a topic, made once."""
        key = topic.key("bench", **names)
        if key not in self._publishers:
            self._publishers[key] = self.wire.publisher(topic, **names)
        return self._publishers[key]

    def truth(self, robot: str = "r1") -> Any:
        """What the arena knows of a robot."""
        return next(truth for truth in self.arena.truth.robots if truth.robot == robot)

    def pose(self, robot: str = "r1") -> Pose2D:
        """Where a robot really is."""
        return self.truth(robot).pose

    def close(self) -> None:
        """End it."""
        for host in self.hosts:
            host.close()
        if hasattr(self, "arena"):
            self.arena.close()
        self.wire.close()
