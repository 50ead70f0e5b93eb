"""`robrain halt` and `robrain resume` on a team of processes: the true robots stop, and go on."""

import json
import time

import pytest

from robrain.protocol.wire.clock import LiveClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import ARENA_TRUTH, COORDINATOR_STATE
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

STANDS_M = 0.001


class Watcher:
    """Sees where the robots really are."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(connect=[endpoint], wait_s=PATIENCE_S)
        self.wire = Endpoint(self.session, "default", LiveClock(), Drive.LIVE)
        self._truth = Inbox()
        self.wire.subscribe(self._truth, ARENA_TRUTH)
        self._summaries = Inbox()
        self.wire.subscribe(self._summaries, COORDINATOR_STATE)
        self._conditions: dict[str, str] = {}

    def driven_m(self, duration_s: float) -> dict[str, float]:
        """How far each robot drives in so long."""
        before = self._distances_m()
        time.sleep(duration_s)
        return {name: distance_m - before[name] for name, distance_m in self._distances_m().items()}

    def wait_until_all_drive(self) -> None:
        until(lambda: all(driven_m > 0.05 for driven_m in self.driven_m(0.5).values()), "they do not drive")

    def told_of(self, robot: str) -> str:
        """What the coordinator says of a robot: `up`, or why it is not."""
        for received in self._summaries.drain():
            self._conditions = {one.name: "up" if one.up else one.why for one in received.message.robots}
        return self._conditions.get(robot, "")

    def _distances_m(self) -> dict[str, float]:
        self._truth.drain()
        heard = until(self._truth.drain, "the arena is silent")
        return {robot.robot: robot.distance_m for robot in heard[-1].message.robots}

    def close(self) -> None:
        self.wire.close()
        self.session.close()


@pytest.fixture
def arena(commands):
    words = ("arena", "arena_small", "--robots", "2", "--listen", "tcp/127.0.0.1:0", "--robot-files", ".")
    process = commands.start(*words)
    endpoint = commands.line_with(process, "arena: arena_small at ").split(" at ")[1].split(",")[0]
    watcher = Watcher(endpoint)
    yield endpoint, watcher
    watcher.close()


def succeeds(done):
    return done.returncode == 0


def start_agents(commands, *robots):
    for robot in robots:
        agent = commands.start("agent", f"{robot}.toml")
        commands.line_with(agent, f"agent: {robot} is up")


def test_a_halted_team_stands_until_it_is_resumed_and_a_late_robot_stands_with_it(commands, arena) -> None:
    endpoint, watcher = arena
    coordinator = commands.start("coordinator", ROBRAIN_CONNECT=endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    start_agents(commands, "r1")
    until(lambda: watcher.driven_m(0.5)["r1"] >= 0.05, "r1 does not drive")

    words = ("halt", "--by", "ann", "--reason", "a test")
    halted = commands.run_until(succeeds, *words, ROBRAIN_CONNECT=endpoint)
    assert halted.stderr == ""
    assert halted.stdout.splitlines() == ["r1: halted", "team default: 1 of 1 robots halted"]
    until(lambda: watcher.driven_m(0.5)["r1"] < STANDS_M, "r1 does not come to a stand")
    assert watcher.driven_m(1.0)["r1"] < STANDS_M

    start_agents(commands, "r2")
    driven_m = watcher.driven_m(5.0)  # explore takes a frontier by itself after 3 s without a coordinator
    assert driven_m["r1"] < STANDS_M
    assert driven_m["r2"] < STANDS_M

    refused = commands.run_until(
        lambda done: "r2: NOT resumed: r2 stays halted: bob may not end the halt of ann" in done.stdout,
        "resume", "--by", "bob", ROBRAIN_CONNECT=endpoint,
    )  # fmt: skip
    assert refused.returncode == 1
    assert watcher.driven_m(1.0)["r1"] < STANDS_M

    commands.run_until(succeeds, "resume", "--by", "ann", ROBRAIN_CONNECT=endpoint)
    watcher.wait_until_all_drive()


def test_one_robot_is_halted_alone_and_without_a_coordinator(commands, arena) -> None:
    endpoint, watcher = arena
    start_agents(commands, "r1", "r2")
    watcher.wait_until_all_drive()
    halted = commands.run_until(succeeds, "halt", "r1", "--by", "operator:ann", ROBRAIN_CONNECT=endpoint)
    assert halted.stdout == "r1: halted\n"
    shown = commands.run_until(succeeds, "status", "--json", ROBRAIN_CONNECT=endpoint)
    robots = json.loads(shown.stdout)["standing"]
    assert [robot["condition"] for robot in robots] == ["halted", "up"]
    assert "operator:ann" in robots[0]["why"]
    until(lambda: watcher.driven_m(0.5)["r1"] < STANDS_M, "r1 does not come to a stand")

    def r2_drives() -> bool:
        driven_m = watcher.driven_m(2.0)
        assert driven_m["r1"] < STANDS_M
        return driven_m["r2"] > 0.0

    until(r2_drives, "r2 stands as well")
    commands.run_until(succeeds, "resume", "r1", ROBRAIN_CONNECT=endpoint)
    watcher.wait_until_all_drive()


def test_a_robot_that_is_lost_is_named_and_the_exit_status_says_so(commands, arena) -> None:
    endpoint, watcher = arena
    coordinator = commands.start("coordinator", ROBRAIN_CONNECT=endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    start_agents(commands, "r1")
    lost = commands.start("agent", "r2.toml")
    commands.line_with(lost, "agent: r2 is up")
    until(lambda: watcher.told_of("r2") == "up", "the coordinator never heard of r2")
    lost.kill()
    lost.wait()
    until(lambda: watcher.told_of("r2") == "gone", "the coordinator never missed r2")
    halted = commands.run_until(
        lambda done: "r1: halted" in done.stdout and "of 2 robots" in done.stdout, "halt", ROBRAIN_CONNECT=endpoint
    )
    assert halted.returncode == 1
    assert "r2: NOT halted: gone" in halted.stdout
    assert "team default: 1 of 2 robots halted" in halted.stdout


def test_nobody_to_halt_is_told_in_words(commands, arena) -> None:
    endpoint, _ = arena
    halted = commands.run("halt", "--team", "other", ROBRAIN_CONNECT=endpoint)
    assert halted.returncode == 2
    assert "no robot of team other is there" in halted.stderr
