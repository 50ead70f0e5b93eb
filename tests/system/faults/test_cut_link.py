"""A robot on a network of its own, whose cable to the coordinator is cut for a while."""

import subprocess
import sys
import time

import pytest

from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.plugin_messages import ROBOT_PLUGINS
from robrain.protocol.messages.team.team_messages import COORDINATOR_STATE
from robrain.protocol.wire.session import listening_at, open_session
from tests.asking import until_answered
from tests.system.relayed_network import NEAR, RelayedNetwork, relayed_network
from tests.waiting import until

pytestmark = pytest.mark.system

CUT_S = 5.0
ROBOT = '[robot]\nname = "r1"\nload = ["counter"]\n'


@pytest.fixture
def network():
    with relayed_network() as network:
        yield network


@pytest.fixture
def hub(network: RelayedNetwork):
    session = open_session(mode="router", listen=[f"tcp/{NEAR}:0", "tcp/127.0.0.1:0"])
    yield session
    session.close()


def test_robot_whose_cable_is_cut_is_lost_and_is_back_after_it(commands, network, hub, wire):
    summaries = Inbox(every=True)
    wire.subscribe(summaries, COORDINATOR_STATE)
    at = {NEAR in endpoint: endpoint for endpoint in listening_at(hub) if endpoint.startswith("tcp/")}
    (commands.folder / "r1.toml").write_text(ROBOT)
    commands.coordinator(at[False])
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
    network.is_cut = True
    until(lambda: is_up(False), "the cut was never noticed")
    noticed_s = time.monotonic() - began_s
    time.sleep(max(0.0, CUT_S - noticed_s))
    assert not is_up(True)
    network.is_cut = False
    until(lambda: is_up(True), "the robot never came back")
    assert agent.poll() is None
    assert until_answered(lambda: wire.ask(ROBOT_PLUGINS, robot="r1"))
