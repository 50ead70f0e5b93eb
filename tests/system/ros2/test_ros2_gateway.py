"""An rclpy node sees a team, gives it a task and halts it."""

import json
import math
from pathlib import Path as FilePath

import pytest

from tests.ros2_interfaces.build import is_built, variables
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from geometry_msgs.msg import PoseStamped

from robrain.client.team import Team

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def hub(tmp_path_factory):
    """Of a simulated robot with a coordinator."""
    commands = Commands(tmp_path_factory.mktemp("team"))
    yield commands.team(1)
    commands.stop_all()


@pytest.fixture
def gateway(commands, hub):
    """Starts a gateway of the team."""

    def start(*words, **variables):
        gateway = commands.start("ros2", "gateway", "--connect", hub, *words, **variables)
        line = commands.line_with(gateway, "ros2 gateway: ")
        assert "team default in ROS domain" in line
        return line

    with Team.connect(hub) as team:
        yield start, team


def heard(listener, kind, topic, qos=10):
    """What comes on a topic from now on."""
    messages = []
    listener.node.create_subscription(kind, topic, messages.append, qos)
    return messages


@pytest.mark.skipif(not is_built(), reason="interfaces are not built here: make ros2-interfaces")
def test_transforms_are_published_and_a_task_is_submitted_by_a_service(gateway, domain, commands):
    start, team = gateway
    start(**variables())
    script = str(FilePath(__file__).parent / "interface_client.py")
    environment = {**variables(), **domain.variables}
    done = commands.run_python(script, '{"kind": "visit", "place": [2.0, 2.0]}', "visit", timeout_s=100, **environment)
    assert done.returncode == 0, done.stderr
    transform, taken, refused = map(json.loads, done.stdout.splitlines())
    assert transform["frames"] == ["map", "r1/base_link"]
    pose = team.state("r1").pose
    assert math.dist(transform["place"], (pose.x_m, pose.y_m)) < 8.0
    assert taken["accepted"]
    assert team.get(json.loads(taken["answer"])["task"]["id"]).task.kind == "visit"
    assert not refused["accepted"]
    assert "expected a task as JSON" in refused["answer"]


def test_a_gateway_that_is_read_only_takes_no_orders(gateway, domain, listener):
    start, _ = gateway
    poses = heard(listener, PoseStamped, "/robrain/r1/pose")
    assert "no orders are taken" in start("--read-only")
    assert listener.spin(PATIENCE_S, lambda: poses)
    assert [name for name, _ in listener.node.get_service_names_and_types() if name.startswith("/robrain/")] == []
    assert listener.node.count_subscribers("/robrain/submit_task") == 0
