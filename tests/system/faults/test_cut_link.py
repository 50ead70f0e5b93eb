"""A robot on a network of its own, whose cable to the coordinator is cut for a while."""

import subprocess
import sys
import time

import pytest

from robrain.protocol.clock import LiveClock
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.table.topics import COORDINATOR_STATE, ROBOT_PLUGINS
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.session import listening_at, open_session
from tests.asking import until_answered
from tests.system.cut_network import NEAR, CutNetwork, cut_network
from tests.waiting import until

pytestmark = pytest.mark.system

CUT_S = 5.0
ROBOT = '[robot]\nname = "r1"\nload = ["counter"]\n'


@pytest.fixture
def network():
    with cut_network() as network:
        yield network


@pytest.fixture
def hub(network: CutNetwork):
    session = open_session(mode="router", listen=[f"tcp/{NEAR}:0", "tcp/127.0.0.1:0"])
    yield session
    session.close()


@pytest.fixture
def team(hub):
    wire = Endpoint(hub, "default", LiveClock(), Drive.LIVE)
    yield wire
    wire.close()


def test_robot_whose_cable_is_cut_is_lost_and_is_back_after_it(commands, network, hub, team):
    summaries = Inbox(every=True)
    team.subscribe(summaries, COORDINATOR_STATE)
    at = {NEAR in endpoint: endpoint for endpoint in listening_at(hub) if endpoint.startswith("tcp/")}
    (commands.folder / "r1.toml").write_text(ROBOT)
    coordinator = commands.start("coordinator", "--connect", at[False])
    commands.line_with(coordinator, "coordinator: of team default")
    words = [sys.executable, "-m", "robrain.cli", "agent", "r1.toml", "--connect", at[True]]
    agent = subprocess.Popen(
        network.words(words), cwd=commands.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    commands.adopt(agent)
    commands.line_with(agent, "agent: r1 is up")

    def is_up(wanted: bool):
        found = [robot for one in summaries.drain() for robot in one.message.robots if robot.name == "r1"]
        return bool(found) and found[-1].up is wanted

    until(lambda: is_up(True), "the robot was never up")
    began_s = time.monotonic()
    network.cut()
    until(lambda: is_up(False), "the cut was never noticed")
    noticed_s = time.monotonic() - began_s
    time.sleep(max(0.0, CUT_S - noticed_s))
    assert not is_up(True)
    network.join()
    until(lambda: is_up(True), "the robot never came back")
    assert agent.poll() is None
    assert until_answered(lambda: team.ask(ROBOT_PLUGINS, robot="r1"))
