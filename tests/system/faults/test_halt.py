"""`robrain halt` and `robrain resume` on a team of processes: the true robots stop, and go on."""

import json
import time

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.team.arena_messages import ARENA_TRUTH, RobotTruth
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.wire.endpoint import Endpoint
from tests.system.conftest import member_at
from tests.system.soak import put
from tests.waiting import until

pytestmark = pytest.mark.system

STANDS_M = 0.001


class Watcher:
    """Sees where the robots really are."""

    def __init__(self, wire: Endpoint) -> None:
        self._truth = Inbox()
        wire.subscribe(self._truth, ARENA_TRUTH)
        self._summaries = Inbox()
        wire.subscribe(self._summaries, COORDINATOR_STATE)
        self._conditions: dict[str, str] = {}

    def driven_m(self, duration_s: float) -> dict[str, float]:
        """How far each robot drives in so long."""
        before = self._distances_m()
        time.sleep(duration_s)
        return {name: distance_m - before[name] for name, distance_m in self._distances_m().items()}

    def wait_until_all_drive(self) -> None:
        until(lambda: all(driven_m > 0.05 for driven_m in self.driven_m(0.5).values()), "they do not drive")

    def truth(self) -> dict[str, RobotTruth]:
        """Where the robots are now."""
        self._truth.drain()
        heard = until(self._truth.drain, "the arena is silent")
        return {robot.robot: robot for robot in heard[-1].message.robots}

    def told_of(self, robot: str) -> str:
        """What the coordinator says of a robot: `up`, or why it is not."""
        for received in self._summaries.drain():
            self._conditions = {one.name: "up" if one.up else one.why for one in received.message.robots}
        return self._conditions.get(robot, "")

    def _distances_m(self) -> dict[str, float]:
        return {name: robot.distance_m for name, robot in self.truth().items()}


@pytest.fixture
def arena(commands):
    endpoint = commands.arena("depot", "--robots", "2")
    with member_at(endpoint) as wire:
        yield endpoint, Watcher(wire)


def succeeds(done):
    return done.returncode == 0


def test_a_halt_holds_robots_until_it_is_resumed_names_those_that_are_lost_and_holds_late_ones(commands, arena) -> None:
    endpoint, watcher = arena

    def run_until(is_good, *words):
        return commands.run_until(is_good, *words, ROBRAIN_CONNECT=endpoint)

    lost = commands.agents("r1", "r2")["r2"]
    watcher.wait_until_all_drive()
    # One robot alone, without a coordinator.
    assert run_until(succeeds, "halt", "r1", "--by", "operator:ann").stdout == "r1: halted\n"
    robots = json.loads(run_until(succeeds, "status", "--json").stdout)["statuses"]
    assert [robot["condition"] for robot in robots] == ["halted", "up"]
    assert "operator:ann" in robots[0]["why"]
    until(lambda: watcher.driven_m(0.5)["r1"] < STANDS_M, "r1 does not come to a stand")

    def r2_drives() -> bool:
        driven_m = watcher.driven_m(2.0)
        assert driven_m["r1"] < STANDS_M
        return driven_m["r2"] > 0.0

    until(r2_drives, "r2 stands as well")
    run_until(succeeds, "resume", "r1")
    watcher.wait_until_all_drive()
    # All, of which one is lost.
    commands.coordinator(endpoint)
    until(lambda: watcher.told_of("r2") == "up", "the coordinator never heard of r2")
    lost.kill()
    lost.wait()
    until(lambda: watcher.told_of("r2") == "gone", "the coordinator never missed r2")
    words = ("halt", "--by", "ann", "--reason", "a test")
    halted = run_until(lambda done: "r1: halted" in done.stdout and "of 2 robots" in done.stdout, *words)
    assert halted.returncode == 1
    assert "r2: NOT halted: gone" in halted.stdout
    assert "team default: 1 of 2 robots halted" in halted.stdout
    until(lambda: watcher.driven_m(0.5)["r1"] < STANDS_M, "r1 does not come to a stand")
    # It comes back while the team is halted.
    put(commands.folder / "r2.toml", watcher.truth()["r2"].pose)
    commands.agents("r2")
    driven_m = watcher.driven_m(5.0)  # explore takes a frontier by itself after 3 s without a coordinator
    assert driven_m["r1"] < STANDS_M
    assert driven_m["r2"] < STANDS_M
    said = "r2: NOT resumed: r2 stays halted: bob may not end the halt of ann"
    refused = run_until(lambda done: said in done.stdout, "resume", "--by", "bob")
    assert refused.returncode == 1
    assert watcher.driven_m(1.0)["r1"] < STANDS_M
    run_until(succeeds, "resume", "--by", "ann")
    watcher.wait_until_all_drive()
