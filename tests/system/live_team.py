"""A team of real processes that a module's tests share: its page, the truth about its robots, their processes."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from robrain.protocol.errors import CallError, ErrorCode, NobodyThere
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_CALL
from robrain.protocol.messages.robots.robot_messages import ROBOT_STATE
from robrain.protocol.messages.tasks.task_messages import TASK_LIST
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, ArenaTruth, RobotTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.wire.endpoint import Endpoint
from tests.system.conftest import Commands, member_at
from tests.waiting import until

ASK_S = 0.1
WANDER_S = 3.0


class LiveTeam:
    """What tests know of the team.

    Args:
        url: the dashboard's page.
        endpoint: a client of the team's hub.
        process: of `robrain up`, whose children the robots are.
    """

    def __init__(self, url: str, endpoint: Endpoint, process: int) -> None:
        self.url = url
        self._endpoint = endpoint
        self._process = process
        self._truths = Inbox()
        self._truth: ArenaTruth | None = None
        self._heard_messages = Inbox(every=True)
        endpoint.subscribe(self._truths, ARENA_TRUTH)
        for topic in (ROBOT_STATE, COORDINATOR_STATE):
            endpoint.subscribe(self._heard_messages, topic)

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

    def stir(self) -> None:
        """Drive idle robots around for a while: robots stand still on an explored map."""
        for robot in self.robots():
            until(lambda robot=robot: self._wanders(robot), f"{robot} does not wander", pause_s=ASK_S)

    def _wanders(self, robot: str) -> bool:
        """Start driving a robot around; False if it or its devices are missing, as may happen on a busy machine."""
        try:
            self._endpoint.ask(ROBOT_CALL, [WANDER_S], robot=robot, plugin="wander", function="start")
        except NobodyThere:
            return False
        except CallError as error:
            if error.code in (ErrorCode.INACTIVE, ErrorCode.TIMEOUT):
                return False
            raise
        return True

    def process_of(self, robot: str) -> int:
        """The process of a robot's agent."""
        children = psutil.Process(self._process).children()
        agents = [child for child in children if any(word.endswith(f"/{robot}.toml") for word in child.cmdline())]
        return int(agents[0].pid)

    def pulse(self, duration_s: float) -> tuple[dict[str, int], float]:
        """Messages of each robot and of the coordinator in so long, and the coordinator's slowest answer, seconds."""
        self._heard_messages.drain()
        ends_s, slowest_s = time.monotonic() + duration_s, 0.0
        while (asked_s := time.monotonic()) < ends_s:
            with suppress(CallError, NobodyThere):  # no answer in time is a slow one
                self._endpoint.ask(TASK_LIST)
            slowest_s = max(slowest_s, time.monotonic() - asked_s)
            time.sleep(ASK_S)
        counts: dict[str, int] = {}
        for received in self._heard_messages.drain():
            speaker = received.names.get("robot", "coordinator")
            counts[speaker] = counts.get(speaker, 0) + 1
        return counts, slowest_s


@contextmanager
def live_team(folder: Path, *words: str) -> Iterator[LiveTeam]:
    """`robrain up` with a dashboard, gone at the end."""
    commands = Commands(folder)
    try:
        process = commands.start("up", *words, "--port", "0")
        hub = commands.line_with(process, "hub: ").split()[1]
        url = commands.line_with(process, "dashboard: ").split()[1]
        with member_at(hub) as endpoint:
            yield LiveTeam(url, endpoint, process.pid)
    finally:
        commands.stop_all()
