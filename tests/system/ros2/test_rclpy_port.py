"""The port over rclpy: what is not installed is left out, requests are bounded, and ends do not hang."""

import threading

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not installed here: pip install 'robrain[ros2]'")

from std_msgs.msg import String as RosString
from std_srvs.srv import Trigger

from robrain.deploy.ros2 import rclpy_port
from robrain.deploy.ros2.rclpy_port import RclpyPort
from robrain.protocol.ros2 import message_types as ros
from robrain.protocol.ros2.message_types import String, TriggerResponse
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.system


@pytest.fixture
def port(domain):
    one = RclpyPort(domain.id, "/robrain")
    yield one
    one.close()


def test_texts_pass_in_both_directions(port, listener):
    reader, writer = port.subscribe("asked", ros.STRING), port.advertise("answers", ros.STRING)
    answers = []
    listener.node.create_subscription(RosString, "/robrain/answers", answers.append, 10)
    asking = listener.node.create_publisher(RosString, "/robrain/asked", 10)
    heard = []
    assert listener.spin(PATIENCE_S, asking.get_subscription_count)
    asking.publish(RosString(data="hé"))
    until(lambda: heard.extend(reader.read()) or heard)
    assert heard[0].message.data == "hé"
    assert listener.spin(PATIENCE_S, lambda: writer.publish(String("yes")) or answers)
    assert answers[0].data == "yes"


def test_requests_wait_for_their_answers_and_end_with_the_port(port, listener, monkeypatch):
    server = port.serve("halt", ros.TRIGGER)
    client = listener.node.create_client(Trigger, "/robrain/halt")
    assert listener.spin(PATIENCE_S, client.service_is_ready)
    asked, taken = client.call_async(Trigger.Request()), []
    assert listener.spin(PATIENCE_S, lambda: taken.extend(server.requests()) or taken)
    assert not asked.done()
    taken[0].reply(TriggerResponse(True, "all halted"))
    assert listener.spin(PATIENCE_S, asked.done)
    assert (asked.result().success, asked.result().message) == (True, "all halted")
    client.call_async(Trigger.Request())
    assert listener.spin(PATIENCE_S, lambda: server._waiting)
    ending = threading.Thread(target=port.close)
    ending.start()
    ending.join(PATIENCE_S)
    assert not ending.is_alive()


def test_a_request_that_nobody_answers_ends_as_not_done(port, listener, monkeypatch):
    monkeypatch.setattr(rclpy_port, "ANSWER_S", 0.2)
    port.serve("halt", ros.TRIGGER)
    client = listener.node.create_client(Trigger, "/robrain/halt")
    assert listener.spin(PATIENCE_S, client.service_is_ready)
    asked = client.call_async(Trigger.Request())
    assert listener.spin(PATIENCE_S, asked.done)
    assert not asked.result().success
