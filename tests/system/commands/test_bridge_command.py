"""`robrain bridge` as a process between two routers."""

import signal

import pytest

from robrain.protocol.model.geometry import Pose2D
from robrain.protocol.wire.clock import WallClock
from robrain.protocol.wire.endpoint import Drive, Endpoint
from robrain.protocol.wire.inbox import Inbox
from robrain.protocol.wire.messages.robots.robot_messages import RobotState
from robrain.protocol.wire.session import listening_at, open_session
from robrain.protocol.wire.topics import ROBOT_STATE
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system

RULES = """
[sides.hall]
team = "default"
network = "hall"
connect = ["{hall}"]
[sides.yard]
team = "default"
network = "yard"
connect = ["{yard}"]
[[rules]]
from = "hall"
to = "yard"
topics = ["robot_state"]
"""


def test_bridge_joins_two_routers_and_counts(commands, hub, wire) -> None:
    other = open_session(mode="router", listen=["tcp/127.0.0.1:0"])
    yard = Endpoint(other, "default", WallClock(), Drive.LIVE)
    inbox = Inbox(every=True)
    yard.subscribe(inbox, ROBOT_STATE)
    places = {name: listening_at(session)[0] for name, session in (("hall", hub), ("yard", other))}
    (commands.folder / "bridge.toml").write_text(RULES.format(**places))
    process = commands.start("bridge", "bridge.toml")
    assert "hall (team default) and yard (team default)" in commands.line_with(process, "bridge: ")
    publisher = wire.publisher(ROBOT_STATE, robot="r1")

    def comes() -> bool:
        publisher.put(RobotState(robot="r1", pose=Pose2D(1.0, 2.0, 0.0)))
        return bool(inbox.drain())

    until(comes, "nothing came over the bridge")
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=PATIENCE_S)
    yard.close()
    other.close()
    assert process.returncode == 0
    assert 'bridge: hall to yard: {"carried":' in said


def test_bridge_with_rules_that_make_no_sense_ends_in_words(commands) -> None:
    rules = RULES.format(hall="tcp/127.0.0.1:1", yard="tcp/127.0.0.1:1")
    (commands.folder / "bridge.toml").write_text(rules.replace("robot_state", "coordinator_state"))
    refused = commands.run("bridge", "bridge.toml")
    assert refused.returncode == 2
    assert "coordinator_state: expected one of" in refused.stderr
