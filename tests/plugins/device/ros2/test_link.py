"""The node that a process's plugins share, with ROS 2 itself."""

import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile

from robrain.agent.errors import HardwareAbsent
from robrain.plugins.device.ros2 import link as link_module
from robrain.plugins.device.ros2.link import Ros2Parameters, close_links, environment_domain, open_link
from robrain.protocol.wire.endpoint import Drive
from tests.ros_domain import Domain
from tests.waiting import until

pytestmark = pytest.mark.slow

QOS = QoSProfile(depth=10)


@pytest.fixture
def domain(monkeypatch):
    domain = Domain()
    for name, value in domain.variables.items():
        monkeypatch.setenv(name, value)
    yield domain
    close_links()
    domain.close()


def opened(robot="r1", **parameters):
    env = SimpleNamespace(plugin="scan", robot=robot, wire=SimpleNamespace(drive=Drive.LIVE))
    return open_link(env, Ros2Parameters(**parameters))


def threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("ros2-")]


def test_plugins_of_a_robot_share_a_node_hear_what_is_published_and_fail_alone(domain):
    assert opened() is opened() is opened()
    assert len(threads()) == 1
    link, came = opened(), threading.Event()
    inbox = link.subscribe(Twist, "/r1/cmd_vel", QOS, came.set)
    publisher = link.publisher(Twist, "/r1/cmd_vel", QOS)
    until(publisher.listeners)
    before_ns = time.time_ns()
    for _ in range(3):
        publisher.publish(Twist())
    until(lambda: len(inbox) == 3)
    assert came.is_set()
    arrived = inbox.drain()
    assert [each.number for each in arrived] == [1, 2, 3]
    assert all(before_ns <= each.arrived_ns <= time.time_ns() for each in arrived)
    with pytest.raises(ZeroDivisionError):
        link.do(lambda: 1 / 0)
    assert link.do(lambda: 7) == 7
    assert opened("r-2.b").node.get_name() == "robrain_r_2_b"
    assert len(threads()) == 2


def test_topics_come_and_go_from_other_threads_while_messages_flow(domain):
    link = opened()
    publisher = link.publisher(Twist, "/r1/cmd_vel", QOS)
    stopping = threading.Event()

    def flood():
        while not stopping.wait(0.001):
            publisher.publish(Twist())

    def come_and_go():
        for _ in range(12):
            inbox = link.subscribe(Twist, "/r1/cmd_vel", QOS, lambda: None)
            end = link.every(0.001, lambda: None)
            time.sleep(0.002)
            end()
            inbox.close()

    flooding = threading.Thread(target=flood)
    others = [threading.Thread(target=come_and_go) for _ in range(3)]
    for thread in (flooding, *others):
        thread.start()
    for thread in others:
        thread.join()
    stopping.set()
    flooding.join()
    assert link.failure == ""
    inbox = link.subscribe(Twist, "/r1/cmd_vel", QOS, lambda: None)
    until(lambda: len(inbox), step=lambda: publisher.publish(Twist()), pause_s=0.02)


def test_a_plugin_that_is_restarted_finds_the_node_again_and_a_node_that_nobody_uses_ends(domain, monkeypatch):
    monkeypatch.setattr(link_module, "LINGER_S", 0.3)
    link = opened()
    link.release()
    assert opened() is link
    time.sleep(0.6)
    assert link.failure == ""
    link.release()
    until(lambda: not threads())
    again = opened()
    assert again is not link
    assert again.failure == ""


def test_a_callback_that_raises_is_the_failure_of_the_node_and_the_next_plugin_gets_another(domain):
    link = opened()
    link.every(0.01, lambda: 1 / 0)
    until(lambda: link.failure)
    assert "the ROS 2 node has failed: division by zero" in link.failure
    with pytest.raises(RuntimeError, match="division by zero"):
        link.publisher(Twist, "/r1/cmd_vel", QOS)
    assert link.publishers("/r1/odom") == 0
    assert opened().failure == ""


def test_a_topic_whose_publisher_has_gone_is_told(domain, monkeypatch):
    monkeypatch.setattr(link_module, "DISCOVERY_S", 0.0)
    link, robot = opened(), opened("robot")
    assert link.is_gone("/r1/odom")
    publisher = robot.publisher(Twist, "/r1/odom", QOS)
    until(lambda: not link.is_gone("/r1/odom"))
    publisher.close()
    until(lambda: link.is_gone("/r1/odom"))


def test_close_ends_the_thread_and_what_comes_later_does_nothing(domain):
    link = opened()
    inbox = link.subscribe(Twist, "/r1/cmd_vel", QOS, lambda: None)
    publisher = link.publisher(Twist, "/r1/cmd_vel", QOS)
    close_links()
    assert not threads()
    inbox.close()
    publisher.close()
    link.close()


def test_the_domain_is_that_of_the_parameter_else_of_the_environment(domain, monkeypatch):
    assert opened().domain_id == domain.id
    monkeypatch.setenv("ROS_DOMAIN_ID", "900")
    with pytest.raises(HardwareAbsent, match=r"expected \$ROS_DOMAIN_ID from 0 to 232, got '900'"):
        opened()
    assert opened("r2", domain_id=domain.id).domain_id == domain.id
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert environment_domain() == 0
