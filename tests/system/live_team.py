"""A team of real processes that a module's tests share: its page, the truth about its robots, their processes."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth, RobotTruth
from robrain.protocol.wire.endpoint import Endpoint
from tests.system.conftest import Commands, member_at
from tests.waiting import until


class LiveTeam:
    """What tests know of the team.

    Args:
        url: the dashboard's page.
        endpoint: a client of the team's hub.
        agents: process ids of the robots' agents, by robot.
    """

    def __init__(self, url: str, endpoint: Endpoint, agents: Mapping[str, int]) -> None:
        self.url = url
        self._agents = agents
        self._truths = Inbox()
        self._truth: ArenaTruth | None = None
        endpoint.subscribe(self._truths, ARENA_TRUTH)

    def robots(self) -> dict[str, RobotTruth]:
        """Where the arena says that the robots are."""
        for received in self._truths.drain():
            self._truth = received.message
        if self._truth is None:
            self._truth = until(self._truths.drain, "the arena is silent")[-1].message
        return {robot.robot: robot for robot in self._truth.robots}

    def driven_m(self) -> float:
        """How far all robots have come together."""
        return sum(robot.distance_m for robot in self.robots().values())

    def come_to_a_stand(self, for_s: float, within_m: float) -> None:
        """Wait until no robot moves for so long: the last commands to the wheels may still be on their way."""

        def stand() -> bool:
            before_m = self.driven_m()
            time.sleep(for_s)
            return self.driven_m() - before_m < within_m

        until(stand, "the robots drive on")

    def process_of(self, robot: str) -> int:
        """The process of a robot's agent."""
        return self._agents[robot]


@contextmanager
def live_team(folder: Path, scenario: str, *words: str, robots: Sequence[str]) -> Iterator[LiveTeam]:
    """Arena, agents, coordinator and dashboard, gone at the end."""
    commands = Commands(folder)
    try:
        hub = commands.arena(scenario, "--robots", str(len(robots)), *words)
        agents = commands.agents(*robots)
        commands.coordinator(hub)
        dashboard = commands.start("dashboard", "--connect", hub, "--port", "0")
        url = commands.line_with(dashboard, "dashboard: ").split()[1]
        with member_at(hub) as endpoint:
            yield LiveTeam(url, endpoint, {name: agent.pid for name, agent in agents.items()})
    finally:
        commands.stop_all()
