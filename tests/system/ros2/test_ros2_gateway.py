"""An rclpy node sees a team, gives it a task and halts it."""

import json
import math
from pathlib import Path as FilePath

import numpy as np
import pytest

from tests.ros2_interfaces.build import is_built, variables
from tests.system.conftest import Commands
from tests.waiting import PATIENCE_S

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger

from robrain.client.team import Team

pytestmark = pytest.mark.system

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope="module")
def hub(tmp_path_factory):
    """Of a simulated robot with a coordinator."""
    commands = Commands(tmp_path_factory.mktemp("team"))
    process = commands.start("up", "arena_small", "--robots", "1", "--no-dashboard")
    yield commands.line_with(process, "hub: ").split()[1]
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


def test_an_rclpy_node_sees_map_poses_paths_and_scans_gives_a_task_and_halts(gateway, domain, listener):
    start, team = gateway
    events, answers = heard(listener, String, "/robrain/task_events"), heard(listener, String, "/robrain/task_answers")
    poses = heard(listener, PoseStamped, "/robrain/r1/pose")
    scans = heard(listener, LaserScan, "/robrain/r1/scan", qos_profile_sensor_data)
    paths = heard(listener, Path, "/robrain/r1/path", LATCHED)
    start()
    submit = listener.node.create_publisher(String, "/robrain/submit_task", 10)
    assert listener.spin(PATIENCE_S, lambda: submit.get_subscription_count() and poses and scans)
    # The pose is the team's, in the frame that ROS calls map.
    assert poses[-1].header.frame_id == "map"
    state = team.state("r1")
    listener.spin(0.5)
    place = poses[-1].pose.position
    assert math.hypot(place.x - state.pose.x_m, place.y - state.pose.y_m) < 1.0
    assert scans[-1].header.frame_id == "r1/base_link"
    assert len(scans[-1].ranges) == 180
    # A task goes in by a topic, and its events come out.
    submit.publish(String(data=json.dumps({"kind": "visit", "place": [2.0, 2.0], "id": "look"})))
    assert listener.spin(PATIENCE_S, lambda: answers)
    answer = json.loads(answers[0].data)
    assert answer["accepted"]
    assert json.loads(answer["answer"])["task"]["id"] == "look"

    def told():
        return [
            each["state"] for each in map(json.loads, (event.data for event in events)) if each["task"]["id"] == "look"
        ]

    assert listener.spin(PATIENCE_S, lambda: "done" in told())
    assert paths
    # The map comes to late subscribers as well, with the cells that the team knows.
    maps = heard(listener, OccupancyGrid, "/robrain/map", LATCHED)
    assert listener.spin(PATIENCE_S, lambda: maps)
    grid = maps[-1]
    cells = np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width)
    assert set(np.unique(cells)) == {-1, 0, 100}
    known_m2 = float((cells >= 0).sum()) * grid.info.resolution**2
    assert known_m2 == pytest.approx(team.state().known_area_m2, rel=0.3)
    # A halt is a service.
    halt = listener.node.create_client(Trigger, "/robrain/halt")
    assert listener.spin(PATIENCE_S, halt.service_is_ready)
    done = halt.call_async(Trigger.Request())
    assert listener.spin(PATIENCE_S, done.done)
    assert done.result().success, done.result().message
    assert done.result().message == "r1: halted"
    assert team.state("r1").has_stopped
    assert team.resume("r1").confirmed == ("r1",)


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
