"""`robrain halt` and `robrain resume` on a team of processes: the true robots stop, and go on."""

import time

import pytest

from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.session import open_session
from robrain.protocol.wire.topics import ARENA_TRUTH
from tests.waiting import PATIENCE_S

pytestmark = pytest.mark.system


class Watcher:
    """Sees where the robots really are."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(connect=[endpoint])
        self.wire = Endpoint(self.session, "default", WallClock(), Drive.LIVE)
        self._truth = Inbox()
        self.wire.subscribe(self._truth, ARENA_TRUTH)

    def driven_m(self, duration_s: float) -> dict[str, float]:
        """How far each robot drives in so long."""
        before = self._distances_m()
        time.sleep(duration_s)
        return {name: distance_m - before[name] for name, distance_m in self._distances_m().items()}

    def wait_until_all_drive(self) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not all(driven_m > 0.05 for driven_m in self.driven_m(0.5).values()):
            assert time.monotonic() < deadline_s, "they do not drive"

    def _distances_m(self) -> dict[str, float]:
        self._truth.drain()
        deadline_s = time.monotonic() + PATIENCE_S
        while not (heard := self._truth.drain()):
            assert time.monotonic() < deadline_s, "the arena is silent"
            time.sleep(0.01)
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


def start_agents(commands, *robots):
    for robot in robots:
        agent = commands.start("agent", f"{robot}.toml")
        commands.line_with(agent, f"agent: {robot} is up")


def test_a_halted_team_stands_until_it_is_resumed_and_a_late_robot_stands_with_it(commands, arena) -> None:
    endpoint, watcher = arena
    coordinator = commands.start("coordinator", ROBRAIN_CONNECT=endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    start_agents(commands, "r1")
    deadline_s = time.monotonic() + PATIENCE_S
    while watcher.driven_m(0.5)["r1"] < 0.05:
        assert time.monotonic() < deadline_s, "r1 does not drive"

    halted = commands.run("halt", "--by", "ann", "--reason", "a test", ROBRAIN_CONNECT=endpoint)
    assert (halted.returncode, halted.stderr) == (0, "")
    assert halted.stdout.splitlines() == ["r1: halted", "team default: 1 of 1 robots halted"]
    time.sleep(0.5)
    assert watcher.driven_m(1.0)["r1"] < 0.001

    start_agents(commands, "r2")
    driven_m = watcher.driven_m(5.0)  # explore takes a frontier by itself after 3 s without a coordinator
    assert driven_m["r1"] < 0.001
    assert driven_m["r2"] < 0.001

    refused = commands.run("resume", "--by", "bob", ROBRAIN_CONNECT=endpoint)
    assert refused.returncode == 1
    assert "r2: NOT resumed: r2 stays halted: bob may not end the halt of ann" in refused.stdout
    assert watcher.driven_m(1.0)["r1"] < 0.001

    resumed = commands.run("resume", "--by", "ann", ROBRAIN_CONNECT=endpoint)
    assert resumed.returncode == 0, resumed.stdout
    watcher.wait_until_all_drive()


def test_one_robot_is_halted_alone_and_without_a_coordinator(commands, arena) -> None:
    endpoint, watcher = arena
    start_agents(commands, "r1", "r2")
    watcher.wait_until_all_drive()
    halted = commands.run("halt", "--robot", "r1", ROBRAIN_CONNECT=endpoint)
    assert (halted.returncode, halted.stdout) == (0, "r1: halted\n")
    time.sleep(0.5)
    driven_m = watcher.driven_m(2.0)
    assert driven_m["r1"] < 0.001
    assert driven_m["r2"] > 0.0
    assert commands.run("resume", "--robot", "r1", ROBRAIN_CONNECT=endpoint).returncode == 0
    watcher.wait_until_all_drive()


def test_a_robot_that_is_lost_is_named_and_the_exit_status_says_so(commands, arena) -> None:
    endpoint, _ = arena
    coordinator = commands.start("coordinator", ROBRAIN_CONNECT=endpoint)
    commands.line_with(coordinator, "coordinator: of team default")
    start_agents(commands, "r1")
    lost = commands.start("agent", "r2.toml")
    commands.line_with(lost, "agent: r2 is up")
    time.sleep(1.0)  # the coordinator hears of it
    lost.kill()
    lost.wait()
    halted = commands.run("halt", ROBRAIN_CONNECT=endpoint)
    assert halted.returncode == 1
    assert "r1: halted" in halted.stdout
    assert "r2: NOT halted: gone" in halted.stdout
    assert "team default: 1 of 2 robots halted" in halted.stdout


def test_nobody_to_halt_is_told_in_words(commands, arena) -> None:
    endpoint, _ = arena
    halted = commands.run("halt", "--team", "other", ROBRAIN_CONNECT=endpoint)
    assert halted.returncode == 2
    assert "no robot of team other is there" in halted.stderr
